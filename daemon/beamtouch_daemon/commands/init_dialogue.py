"""The answers that `init` needs: from its options, or asked for on a terminal."""

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from beamtouch_common.errors import InputError
from beamtouch_common.typed import is_terminal, typed_line
from beamtouch_daemon.commands.argument_types import BAUDS, RTU_UNITS, TCP_UNITS, address_of
from beamtouch_daemon.commands.init_template import load_template
from beamtouch_daemon.config.publish import HttpUrl
from beamtouch_daemon.config.sources import ModbusRtu, SerialLine

Answer = TypeVar("Answer")
SOURCES = "rtu:/dev/ttyUSB0, serial:/dev/ttyACM0 or tcp://HOST[:PORT]"
OPTIONS = {
    "rtu": ("baud", "parity", "unit", "function", "timeout_ms"),
    "serial": ("baud",),
    "tcp": ("unit", "function", "timeout_ms"),
}
"""Options of a source, by the kind that its address begins with."""
_KINDS = {"rtu": "modbus-rtu", "serial": "serial"}
_DEFAULT_BAUD = {"rtu": ModbusRtu.model_fields["baud"].default, "serial": SerialLine.model_fields["baud"].default}


@dataclass(frozen=True)
class Stated:
    """The answers; None, or empty, where there is none yet."""

    model_config_: Path | None = None
    source: str = ""
    options: Mapping[str, str | float] = field(default_factory=dict)
    url: str | None = None
    token_file: Path | None = None
    certificate_file: Path | None = None

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> "Stated":
        """Return the answers in the arguments; InputError if they contradict each other."""
        given = {key: getattr(arguments, key) for key in OPTIONS["rtu"]}
        options = {key: value for key, value in given.items() if value is not None}
        source: str = arguments.source or ""
        for key in options if source else ():
            if key not in OPTIONS[_kind_of(source)]:
                message = f"--{key.replace('_', '-')}: a source such as {source} has none; leave it out"
                raise InputError(message)
        url = None if arguments.url is None else url_of(arguments.url)
        return cls(arguments.model_config, source, options, url, arguments.token_file, arguments.certificate_file)

    @property
    def model_config(self) -> Path:
        """The configuration that belongs to the model; InputError without one."""
        if self.model_config_ is None:
            message = "--model-config: give the configuration that design-sensors build --daemon-config wrote"
            raise InputError(message)
        return self.model_config_

    def settings(self) -> dict[str, str | float]:
        """Return the keys of the `[source]` table; InputError without a source."""
        if not self.source:
            message = f"--source: give {SOURCES}; beamtouch-daemon scan finds it"
            raise InputError(message)
        kind = _kind_of(self.source)
        if kind == "tcp":
            host, port = address_of(self.source)
            where: dict[str, str | float] = {"kind": "modbus-tcp", "host": host, "port": port}
        else:
            where = {"kind": _KINDS[kind], "port": self.source.partition(":")[2]}
        return where | {key: self.options[key] for key in OPTIONS[kind] if key in self.options}


def url_of(text: str) -> str:
    """Return the address of a service; InputError if it is none."""
    try:
        url: str = TypeAdapter(HttpUrl).validate_python(text)
    except ValidationError:
        message = f"{text!r} is not the address of a service, such as http://127.0.0.1:8420"
        raise InputError(message) from None
    return url


def complete(stated: Stated, folder: Path) -> Stated:
    """Return all answers. On a terminal, ask for what is missing if the model's configuration or the source is.

    The files that it proposes are in `folder`, that of the new configuration.
    """
    if (stated.model_config_ is not None and stated.source) or not is_terminal():
        return stated
    if stated.model_config_ is None:
        question = "configuration that design-sensors build --daemon-config wrote for the model"
        stated = replace(stated, model_config_=_ask(question, None, _template))
    if not stated.source:
        stated = replace(stated, source=_ask(f"source: {SOURCES}", None, _source))
    kind = _kind_of(stated.source)
    left = [key for key in OPTIONS[kind] if key not in stated.options and key != "timeout_ms"]
    stated = replace(stated, options={**stated.options, **{key: _ask_option(key, kind) for key in left}})
    if stated.url is None:
        stated = replace(stated, url=_ask("service", "http://127.0.0.1:8420", url_of))
    if stated.token_file is None:
        stated = replace(
            stated, token_file=_ask("file with the service's token", str(folder / "beamtouch.token"), Path)
        )
    if stated.certificate_file is None and (stated.url or "").startswith("https:"):
        file = _ask("certificate to trust (PEM; - for those of the system)", str(folder / "certificate.pem"), Path)
        stated = replace(stated, certificate_file=None if file == Path("-") else file)
    return stated


def _ask_option(key: str, kind: str) -> str | int:
    """Ask for an option of a source."""
    match key:
        case "baud":
            return _ask("baud rate", str(_DEFAULT_BAUD[kind]), _between(BAUDS[0], BAUDS[-1]))
        case "parity":
            return _ask("parity: none, even or odd", "none", _parity)
        case "unit":
            units = TCP_UNITS if kind == "tcp" else RTU_UNITS
            return _ask("unit", "1", _between(units[0], units[-1]))
        case _:
            return _ask("function: 4 for input registers, 3 for holding registers", "4", _between(3, 4))


def _ask(question: str, default: str | None, meaning: Callable[[str], Answer]) -> Answer:
    """Return the meaning of the answer; ask again after a wrong one. InputError at the end of the input."""
    while True:
        print(f"{question}{'' if default is None else f' [{default}]'}: ", end="", file=sys.stderr, flush=True)
        line = typed_line()
        if not line:
            message = "the answers ended; nothing was written"
            raise InputError(message)
        try:
            return meaning(line.strip() or default or "")
        except InputError as error:
            print(error, file=sys.stderr)


def _template(text: str) -> Path:
    if not text or not Path(text).is_file():
        message = f"there is no file {text!r}"
        raise InputError(message)
    load_template(Path(text))
    return Path(text)


def _source(text: str) -> str:
    Stated(source=text or "-").settings()
    return text


def _kind_of(source: str) -> str:
    """Return rtu, serial or tcp; InputError if the source begins with none of them."""
    kind, _, where = source.partition(":")
    if kind not in OPTIONS or not where:
        message = f"{source!r} is not a source; give {SOURCES}"
        raise InputError(message)
    return kind


def _parity(text: str) -> str:
    if text not in {"none", "even", "odd"}:
        message = f"{text!r} is none of none, even and odd"
        raise InputError(message)
    return text


def _between(low: int, high: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        if not (text.isascii() and text.isdecimal() and len(text) < 10 and low <= int(text) <= high):
            message = f"{text!r} is not a whole number from {low} to {high}"
            raise InputError(message)
        return int(text)

    return number
