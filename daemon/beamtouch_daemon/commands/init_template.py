"""The configuration that belongs to a model, from which `init` writes one for this machine."""

from pathlib import Path

from beamtouch_common.errors import InputError
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config


def load_template(path: Path) -> Config:
    """Return the configuration of one surface in a file; InputError if it is something else."""
    if path.suffix == ".onnx":
        message = f"{path}: the daemon reads no models; give what design-sensors build --daemon-config FILE wrote"
        raise InputError(message)
    known = load_config(path)
    if len(known.surfaces) > 1 or known.include:
        message = f"{path}: has several surfaces; give a configuration with the surface of one model"
        raise InputError(message)
    return known
