"""`beamtouch-service check MODEL`: describes a model file, or the reason to refuse it."""

from pathlib import Path

from beamtouch_models.modelfile import ModelFileError
from beamtouch_service.api.models import describe
from beamtouch_service.config import ConfigError
from beamtouch_service.host import model_watch


def report(path: Path, *, as_json: bool) -> str:
    """Return the description of a model; raises ConfigError if a service would refuse it."""
    try:
        model, _ = model_watch.load(path)
    except ModelFileError as error:
        message = f"model {error}"
        raise ConfigError(message) from None
    return describe(model).model_dump_json() if as_json else model.summary()
