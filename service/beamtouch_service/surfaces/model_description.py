"""The description of a model: `GET /surfaces/NAME/model`, and `beamtouch-service check`. Pure."""

from pydantic import BaseModel

from beamtouch_models.runtime import Accuracy, Calibration, ModelFile, Noise, Ranges


class ModelDescription(BaseModel):
    """Metadata of a model."""

    identity: str
    """Name and the first digits of the file's SHA-256."""
    beam: str
    """Identity of the beam with its layout, which a batch may state."""
    estimator: str
    length_mm: float
    """Of a plate, along `x`."""
    width_mm: float | None
    """Of a plate, along `y`; null on a beam."""
    channels: list[str]
    """Names of the channels, in input order."""
    positions_mm: list[float]
    """Positions of the channels, from the left end of the beam; on a plate along `x`."""
    across_mm: list[float] | None
    """Their places along `y` on a plate; null on a beam."""
    unit: str
    """Unit of what the channels show: figures of deflections and of noise, in `_mm` by their names, are in it."""
    min_channels: int
    outputs: list[str]
    ranges: Ranges
    max_deflection_mm: float
    noise: Noise
    accuracy: Accuracy
    calibration: Calibration | None


def describe_model(model: ModelFile) -> ModelDescription:
    """Return the description of a model."""
    metadata = model.metadata
    return ModelDescription(
        identity=model.identity,
        beam=metadata.beam,
        estimator=metadata.estimator,
        length_mm=metadata.length_mm,
        width_mm=metadata.width_mm,
        channels=model.channels,
        positions_mm=[channel.position_mm for channel in metadata.layout],
        across_mm=[one.across_mm for one in metadata.layout if one.across_mm is not None] or None,
        unit=metadata.unit,
        min_channels=metadata.min_channels,
        outputs=list(model.outputs),
        ranges=metadata.ranges,
        max_deflection_mm=metadata.max_deflection_mm,
        noise=metadata.noise,
        accuracy=metadata.accuracy,
        calibration=metadata.calibration,
    )
