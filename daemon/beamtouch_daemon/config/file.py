"""Reads the configuration file; any error becomes one line that names the key."""

from pathlib import Path

from beamtouch_common.errors import InputError
from beamtouch_common.files import load_toml
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.config.sources import ModbusTcp

RENAMED = {"most_mm": "max_mm", "most_force_n": "max_force_n"}
"""Keys of older versions, with their present names."""


def load_config(path: Path) -> Config:
    """Read and check a configuration file; InputError if it cannot be used."""
    return load_toml(Config, path, renamed=RENAMED, context={"directory": path.resolve().parent})


def require_ports(config: Config) -> None:
    """Raise InputError if a serial port in the configuration does not exist."""
    for name, surface in config.surfaces.items():
        if isinstance(surface.source, ModbusTcp):
            continue
        path = Path(surface.source.port)
        if not path.exists():
            message = f"surfaces.{name}.source.port: {path} does not exist; plug the device in or correct the path"
            raise InputError(message)
        if not path.is_char_device():
            message = f"surfaces.{name}.source.port: {path} is not a serial port; correct the path"
            raise InputError(message)
