"""Reading the configuration: one TOML file in, or one line that says what is wrong with it."""

import tomllib
from pathlib import Path

from pydantic import ValidationError

from beamtouch_daemon.config.settings import Config, ConfigError, reason_of
from beamtouch_daemon.config.sources import ModbusTcp

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
    """Raise ConfigError if a serial port of a surface is not there."""
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
    """Return one complaint in one line: key path, what is wrong, and how many more there are."""
    complaints = error.errors(include_url=False, include_context=False)
    # A misspelt key is also a missing one; its spelling is what the user can see.
    first, *others = sorted(complaints, key=lambda complaint: complaint["type"] != "extra_forbidden")
    where = _key_path(first["loc"])
    match first["type"]:
        case "extra_forbidden":
            text = f"unknown key {where}; remove it or correct its spelling"
        case "missing":
            text = f"{where} is missing; add it"
        case _:
            text = f"{where}: {first['msg'].removeprefix('Value error, ')}".removeprefix(": ")
    return text + (f" (and {len(others)} more)" if others else "")


def _key_path(location: tuple[int | str, ...]) -> str:
    """Return the path as it stands in the file: pydantic adds the kind of a source or filter, which is no key."""
    path = ""
    for previous, part in zip(("", *location), location, strict=False):
        if isinstance(part, int):
            path += f"[{part}]"
        elif previous not in {"source", "filter"} or part not in _KINDS:
            path += f".{part}"
    return path.removeprefix(".")
