"""Reads the configuration file; any error becomes one line that names the key."""

import tomllib
from pathlib import Path

from pydantic import ValidationError

from beamtouch_daemon.config.settings import Config, reason_of
from beamtouch_daemon.config.sources import ModbusTcp
from beamtouch_daemon.exits import ConfigError

RENAMED = {"most_mm": "max_mm", "most_force_n": "max_force_n"}
"""Keys of older versions, with their present names."""
_KINDS = {"modbus-tcp", "modbus-rtu", "serial", "none", "moving-average", "low-pass", "adaptive"}


def load(path: Path) -> Config:
    """Read and check a configuration file; ConfigError if it cannot be used."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
        return Config.model_validate(data, context={"directory": path.resolve().parent})
    except ValidationError as error:
        message = f"{path}: {_describe(error)}"
        raise ConfigError(message) from error
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: cannot be read ({reason_of(error)})"
        raise ConfigError(message) from error
    except tomllib.TOMLDecodeError as error:
        message = f"{path}: not valid TOML: {error}"
        raise ConfigError(message) from error


def require_ports(config: Config) -> None:
    """Raise ConfigError if a serial port in the configuration does not exist."""
    for name, surface in config.surfaces.items():
        if isinstance(surface.source, ModbusTcp):
            continue
        path = Path(surface.source.port)
        if not path.exists():
            message = f"surfaces.{name}.source.port: {path} does not exist; plug the device in or correct the path"
            raise ConfigError(message)
        if not path.is_char_device():
            message = f"surfaces.{name}.source.port: {path} is not a serial port; correct the path"
            raise ConfigError(message)


def _describe(error: ValidationError) -> str:
    """Return the first complaint in one line: key path, what is wrong, and the number of further complaints."""
    complaints = error.errors(include_url=False, include_context=False)
    # A misspelt key is also a missing one. The user can see the spelling, so it comes first.
    first, *others = sorted(complaints, key=lambda complaint: complaint["type"] != "extra_forbidden")
    where = _key_path(first["loc"])
    match first["type"]:
        case "extra_forbidden":
            key = str(first["loc"][-1])
            remedy = f"{key} is now {RENAMED[key]}" if key in RENAMED else "remove it or correct its spelling"
            text = f"unknown key {where}; {remedy}"
        case "missing":
            text = f"{where} is missing; add it"
        case _:
            text = f"{where}: {first['msg'].removeprefix('Value error, ')}".removeprefix(": ")
    return text + (f" (and {len(others)} more)" if others else "")


def _key_path(location: tuple[int | str, ...]) -> str:
    """Return the path as in the file, without the kind of a source or filter, which pydantic adds."""
    path = ""
    for previous, part in zip(("", *location), location, strict=False):
        if isinstance(part, int):
            path += f"[{part}]"
        elif previous not in {"source", "filter"} or part not in _KINDS:
            path += f".{part}"
    return path.removeprefix(".")
