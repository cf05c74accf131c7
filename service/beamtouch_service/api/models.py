"""`GET /surfaces/NAME/model`: the model of a surface."""

from pydantic import BaseModel

from beamtouch_models.modelfile import Accuracy, Calibration, ModelFile, Noise, Ranges
from beamtouch_service.access import Role
from beamtouch_service.api import gate, openapi
from beamtouch_service.api.context import ContextParameter, SurfaceInPath
from beamtouch_service.problems import Kind, Problem, ProblemError

router = gate.make_router("model", Role.READ)


class ModelDescription(BaseModel):
    """Metadata of a model."""

    identity: str
    """Name and the first digits of the file's SHA-256."""
    beam: str
    """Identity of the beam with its layout, which a batch may state."""
    estimator: str
    length_mm: float
    channels: list[str]
    """Names of the channels, in input order."""
    positions_mm: list[float]
    """Positions of the channels, from the left end of the beam."""
    min_channels: int
    outputs: list[str]
    ranges: Ranges
    max_deflection_mm: float
    noise: Noise
    accuracy: Accuracy
    calibration: Calibration | None


def describe(model: ModelFile) -> ModelDescription:
    """Return the description of a model."""
    said = model.metadata
    return ModelDescription(
        identity=model.identity,
        beam=said.beam,
        estimator=said.estimator,
        length_mm=said.length_mm,
        channels=model.channels,
        positions_mm=[channel.position_mm for channel in said.layout],
        min_channels=said.min_channels,
        outputs=list(model.outputs),
        ranges=said.ranges,
        max_deflection_mm=said.max_deflection_mm,
        noise=said.noise,
        accuracy=said.accuracy,
        calibration=said.calibration,
    )


@router.get("/surfaces/{name}/model", responses=openapi.problems(Kind.UNKNOWN_SURFACE, Kind.NO_SURFACE, Kind.NO_MODEL))
async def get_model(context: ContextParameter, name: SurfaceInPath) -> ModelDescription:
    """Return the metadata of the model of this surface: layout, ranges, accuracy, calibration."""
    model = context.registry.named(name).model
    if model is None:
        raise ProblemError(Problem(Kind.NO_MODEL, "Give a model with --model or in the config.", name))
    return describe(model)
