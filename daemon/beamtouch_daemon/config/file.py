"""Reads the configuration and the files that it includes; any error becomes one line that names the key."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from beamtouch_common.errors import InputError
from beamtouch_common.files import load_toml, validate
from beamtouch_daemon.config.include import Table, with_included
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.config.sources import ModbusTcp

RENAMED = {"most_mm": "max_mm", "most_force_n": "max_force_n"}
"""Keys of older versions, with their present names."""
_NONE: Mapping[str, Path | None] = MappingProxyType({})


def load_config(path: Path, overrides: Mapping[str, Path | None] = _NONE) -> Config:
    """Read and check a configuration file; InputError if it cannot be used.

    `overrides` are files that win over those of [publish], unless they are None; relative to the working directory.
    """
    content, files = with_included(load_toml(Table, path).root, path, RENAMED)
    context = {"directory": path.resolve().parent, "files": files}
    config = validate(Config, content, str(path), renamed=RENAMED, context=context)
    given = {key: file.absolute() for key, file in overrides.items() if file is not None}
    return config.model_copy(update={"publish": config.publish.model_copy(update=given)})


def require_ports(config: Config) -> None:
    """Raise InputError if a serial port in the configuration does not exist."""
    for name, surface in config.surfaces.items():
        if isinstance(surface.source, ModbusTcp):
            continue
        key = f"surfaces.{name}.source.port"
        require_port(surface.source.port, f"{config.file_of(name)}: {key}: " if config.include else f"{key}: ")


def require_port(port: str, key: str = "") -> None:
    """Raise InputError if a serial port does not exist; `key` is the beginning of the message."""
    path = Path(port)
    if not path.exists():
        message = f"{key}{path} does not exist; plug the device in or correct the path"
        raise InputError(message)
    if not path.is_char_device():
        message = f"{key}{path} is not a serial port; correct the path"
        raise InputError(message)
