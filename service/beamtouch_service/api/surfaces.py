"""The routes `GET /contact` and `GET /surfaces`: contact, summary, model and beam; `surfaces/` has what they answer."""

from fastapi import Response
from pydantic import BaseModel
from starlette.requests import Request

from beamtouch_common.zones import Zone
from beamtouch_models.runtime import Accuracy, BeamDrawing, Calibration, ModelFile, Noise, Ranges
from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import Context, ContextParameter, SurfaceInPath, SurfaceInQuery, context_of
from beamtouch_service.problems import ProblemError
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.problems import no_model
from beamtouch_service.surfaces.state import SurfaceSummary, summary_of

contact_router = gate.make_router("contact", Role.READ)
router = gate.make_router("surfaces", Role.READ)
model_router = gate.make_router("model", Role.READ)


class SurfaceList(BaseModel):
    """All surfaces of the service."""

    surfaces: list[SurfaceSummary]


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


class Beam(BaseModel):
    """The data to draw a beam."""

    model: str
    """Name and fingerprint of the model; a contact that states the same one belongs to this beam."""
    length_mm: float
    drawn: BeamDrawing
    zones: dict[str, Zone]
    """The zones of the configuration by name."""


@contact_router.get("/contact", response_model=Contact)
async def get_contact(request: Request, surface: SurfaceInQuery = None) -> Response:
    """Return the contact on the only surface, or on the one that is named."""
    context = context_of(request.scope)
    context.require_all("Ask for /surfaces/NAME/contact.")
    return _contact(context, surface)


@contact_router.get("/surfaces/{name}/contact", response_model=Contact)
async def get_surface_contact(request: Request, name: SurfaceInPath) -> Response:
    """Return the contact on this surface."""
    return _contact(context_of(request.scope), name)


def _contact(context: Context, name: str | None) -> Response:
    contact = context.registry.chosen(name).contact(context.clock())
    context.counts.contacts.labels(contact.surface, contact.state.value).inc()
    return Response(contact.model_dump_json(), media_type="application/json")


@router.get("/surfaces")
async def get_surfaces(context: ContextParameter) -> SurfaceList:
    """Return all surfaces of this service."""
    context.require_all("Ask for /surfaces/NAME of each.")
    now_s = context.clock()
    return SurfaceList(surfaces=[summary_of(surface, now_s) for surface in context.registry])


@router.get("/surfaces/{name}")
async def get_surface(context: ContextParameter, name: SurfaceInPath) -> SurfaceSummary:
    """Return one surface: its channels, model, age limit, and counts of samples."""
    return summary_of(context.registry.named(name), context.clock())


@model_router.get("/surfaces/{name}/model")
async def get_model(context: ContextParameter, name: SurfaceInPath) -> ModelDescription:
    """Return the metadata of the model of this surface: layout, ranges, accuracy, calibration."""
    return describe(_model(context, name))


@model_router.get("/surfaces/{name}/beam")
async def get_beam(context: ContextParameter, name: SurfaceInPath) -> Beam:
    """Return the supports of the beam, its deflection per newton for positions of the contact along it, and its zones.

    It changes only with the model, so it is not part of the stream.
    """
    model, zones = _model(context, name), context.registry.named(name).section.zones
    return Beam(model=model.identity, length_mm=model.metadata.length_mm, drawn=model.metadata.drawn, zones=zones)


def _model(context: Context, name: str) -> ModelFile:
    surface = context.registry.named(name)
    if surface.model is None:
        raise ProblemError(no_model(name, surface.model_error))
    return surface.model


def describe(model: ModelFile) -> ModelDescription:
    """Return the description of a model."""
    metadata = model.metadata
    return ModelDescription(
        identity=model.identity,
        beam=metadata.beam,
        estimator=metadata.estimator,
        length_mm=metadata.length_mm,
        channels=model.channels,
        positions_mm=[channel.position_mm for channel in metadata.layout],
        min_channels=metadata.min_channels,
        outputs=list(model.outputs),
        ranges=metadata.ranges,
        max_deflection_mm=metadata.max_deflection_mm,
        noise=metadata.noise,
        accuracy=metadata.accuracy,
        calibration=metadata.calibration,
    )
