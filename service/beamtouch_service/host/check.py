"""`beamtouch-service check MODEL`: describes a model file, or says what is wrong with it."""

from pathlib import Path

from beamtouch_models.modelfile import ModelFileError
from beamtouch_service.api.models import ModelDescription, describe
from beamtouch_service.config import ConfigError
from beamtouch_service.host import model_watch


def report(path: Path, *, as_json: bool) -> str:
    """Return the description of a model; raises ConfigError if a service would refuse it."""
    try:
        model, _ = model_watch.load(path)
    except ModelFileError as error:
        message = f"model {error}"
        raise ConfigError(message) from None
    description = describe(model)
    return description.model_dump_json() if as_json else _text(description)


def _text(said: ModelDescription) -> str:
    layout = ", ".join(f"{name} at {at:g}" for name, at in zip(said.channels, said.positions_mm, strict=True))
    low_n, high_n = said.ranges.force_n
    force = f"{low_n:g} N, known" if low_n == high_n else f"{low_n:g} to {high_n:g} N"
    accuracy = said.accuracy
    lines = {
        "model": f"{said.identity}, {said.estimator}",
        "channels": f"{layout} mm of {said.length_mm:g} mm; at least {said.min_channels} must work",
        "answers": ", ".join(said.outputs),
        "made for": f"position {said.ranges.position_mm[0]:g} to {said.ranges.position_mm[1]:g} mm, force {force}",
        "noise": f"{said.noise.sample_mm:g} mm per sample",
        "error": f"{accuracy.error_percent:.3g} % of the length, the accuracy limit is {accuracy.limit_percent:.3g} %",
        "calibration": "none, the model of the scene"
        if said.calibration is None
        else f"{said.calibration.loads} loads",
        "golden answers": "reproduced",
    }
    return "\n".join(f"{name:15} {value}" for name, value in lines.items())
