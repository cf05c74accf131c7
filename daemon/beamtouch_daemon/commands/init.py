"""`init`: writes a configuration from the one that belongs to a model, for the sensors and the service of this machine.

The daemon reads no models: a gateway needs no onnxruntime. `design-sensors build --daemon-config` writes what it needs
to know of one: channels, characteristics, rate, noise and filter. The service does not know the characteristics.
"""

import argparse
import json
import os
import re
import shlex
from collections.abc import Iterator, Mapping
from itertools import accumulate
from pathlib import Path

from beamtouch_common.commands import DONE
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.files import parse_toml, read_text, require_writable, write_atomically
from beamtouch_daemon.argument_types import address_of
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.config.value_types import ValueType, has_fractions, words_of

MODE = 0o644
"""Permissions: a configuration holds no secret, and the user of the service reads what root wrote."""
SOURCES = "rtu:/dev/ttyUSB0, serial:/dev/ttyACM0 or tcp://HOST[:PORT]"
OPTIONS = {
    "rtu": ("baud", "parity", "unit", "function", "byte_order", "timeout_ms"),
    "serial": ("baud",),
    "tcp": ("unit", "function", "byte_order", "timeout_ms"),
}
"""Options of a source, by the kind that its address begins with."""
OF_CHANNELS = ("type", "register")
"""Options of the channels of a Modbus source."""

Keys = Mapping[str, str | float]


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError for wrong or missing options, FailedError if the file cannot be written."""
    path: Path = arguments.config
    require_writable([path], [arguments.token_file, arguments.certificate_file])
    if path.exists() and not arguments.force:
        raise InputError(f"{path}: already exists; add --force to replace it, or name another file")
    text, config = _configuration(arguments, path)
    try:
        write_atomically(path, text.encode(), mode=MODE)
    except OSError as error:
        raise FailedError(f"{path}: not written: {error.strerror}") from None
    ((name, surface),) = config.surfaces.items()
    channels = ", ".join(surface.channel_names)
    print(f"{path}: {name}, channels {channels}, {surface.rate_hz:g} readings per second from {arguments.source}")
    unit = "; for values in mm they are 1 and 0" if any(surface.has_fractions) else ""
    print(f"next: correct gain_mm_per_count and offset_mm of each channel, which are those of an ideal sensor{unit}")
    token = path.resolve().parent / config.publish.token_file
    if not os.access(token, os.R_OK):
        print(f"next: copy the service's token to {token}, so that this user can read it")
    typed = shlex.quote(str(path))
    print(f"next: beamtouch-daemon check {typed} --wait 30\n      beamtouch-daemon tare {typed}")
    return DONE


def _configuration(arguments: argparse.Namespace, path: Path) -> tuple[str, Config]:
    """Return the text of the file, and the configuration; InputError if the options do not give one."""
    template: Path | None = arguments.model_config
    if template is None:
        raise InputError("--model-config: give the configuration that design-sensors build --daemon-config wrote")
    model_config = _template(template)
    source = _source(arguments)
    token = arguments.token_file or path.parent / model_config.publish.token_file
    publish = {"url": (arguments.url or model_config.publish.url).rstrip("/"), "token_file": _seen_from(path, token)}
    if arguments.certificate_file is not None:
        publish["certificate_file"] = _seen_from(path, arguments.certificate_file)
    (name,) = model_config.surfaces
    try:
        text = read_text(template).replace("\r\n", "\n")
        text = _with_table(text, ("surfaces", name, "source"), source)
        if arguments.type is not None or arguments.register is not None:
            words = [
                words_of(arguments.type or channel.type or "u16") for channel in model_config.surfaces[name].channels
            ]
            text = _with_registers(text, name, arguments.type, accumulate(words, initial=arguments.register or 0))
        text = _with_table(text, ("publish",), publish, keeps_others=True)
        text.encode()
    except LookupError as error:
        message = f"{template}: has no table {error.args[0]}; give what design-sensors build --daemon-config wrote"
        raise InputError(message) from None
    except UnicodeEncodeError:  # names of files may be any bytes
        raise InputError("the source and the files must have names in UTF-8") from None
    return text, parse_toml(Config, text, str(path), context={"directory": path.absolute().parent})


def _template(path: Path) -> Config:
    """Return the configuration of one surface in a file; InputError if it is something else."""
    if path.suffix == ".onnx":
        message = f"{path}: the daemon reads no models; give what design-sensors build --daemon-config FILE wrote"
        raise InputError(message)
    model_config = load_config(path)
    if len(model_config.surfaces) > 1 or model_config.include:
        raise InputError(f"{path}: has several surfaces; give a configuration with the surface of one model")
    return model_config


def _source(arguments: argparse.Namespace) -> Keys:
    """Return the keys of the table of the source; InputError if the options do not give it."""
    address: str | None = arguments.source
    if not address:
        raise InputError(f"--source: give {SOURCES}; beamtouch-daemon scan finds it")
    kind, _, where = address.partition(":")
    if kind not in OPTIONS or not where:
        raise InputError(f"{address!r} is not a source; give {SOURCES}")
    options: dict[str, str | float] = {
        key: value for key in OPTIONS["rtu"] if (value := getattr(arguments, key)) is not None
    }
    given = options.keys() | {key for key in OF_CHANNELS if getattr(arguments, key) is not None}
    for key in given - {*OPTIONS[kind], *(() if kind == "serial" else OF_CHANNELS)}:
        raise InputError(f"--{key.replace('_', '-')}: a source such as {address} has none; leave it out")
    keys: dict[str, str | float] = {"kind": "modbus-rtu" if kind == "rtu" else "serial", "port": where}
    if kind == "tcp":
        host, port = address_of(address)
        keys = {"kind": "modbus-tcp", "host": host, "port": port}
    return keys | options


def _seen_from(path: Path, file: Path) -> str:
    """Return a file as a configuration names it: relative to its folder if the file is in it or below."""
    relative = os.path.relpath(file.absolute(), path.absolute().parent)
    return str(file.absolute()) if relative.startswith("..") else relative


def _with_table(text: str, names: tuple[str, ...], keys: Keys, *, keeps_others: bool = False) -> str:
    """Return a configuration with other keys in a table; comments outside of it stay.

    LookupError with its header if there is no such table.
    """
    lines = text.split("\n")  # not splitlines: other line ends may stand in a comment
    begin = next((place for place, line in enumerate(lines, 1) if _header(names).match(line)), None)
    if begin is None:
        raise LookupError(f"[{'.'.join(names)}]")
    end = next((place for place in range(begin, len(lines)) if lines[place].lstrip().startswith("[")), len(lines))
    table = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in keys.items()]
    if keeps_others:
        table += [line for line in lines[begin:end] if line.strip() and _key_in(line) not in keys]
    return "\n".join([*lines[:begin], *table, "", *lines[end:]]).rstrip("\n") + "\n"


def _with_registers(text: str, name: str, value_type: ValueType | None, registers: Iterator[int]) -> str:
    """Return a configuration whose channels have these registers; their comments stay.

    Without a type (`value_type`), those of the channels stay. Fractional numbers have no bits of an ADC.
    """
    header, lines, is_channel = _header(("surfaces", name, "channels"), of_list=True), list[str](), False
    left_out = set() if value_type is None else {"type", *(["adc_bits"] if has_fractions(value_type) else [])}
    register = 0
    for line in text.split("\n"):
        if line.lstrip().startswith("["):
            is_channel = bool(header.match(line))
            register = next(registers) if is_channel else register
        if is_channel and _key_in(line) == "register":
            lines += [f"register = {register}", *([] if value_type is None else [f'type = "{value_type}"'])]
        elif not (is_channel and _key_in(line) in left_out):
            lines.append(line)
    return "\n".join(lines)


def _header(names: tuple[str, ...], *, of_list: bool = False) -> re.Pattern[str]:
    """Return the pattern of the header of a table, or of an entry of a list of tables."""
    path = r"\s*\.\s*".join(f"[\"']?{re.escape(name)}[\"']?" for name in names)
    return re.compile(rf"\s*\[\[\s*{path}\s*\]\]" if of_list else rf"\s*\[\s*{path}\s*\]")


def _key_in(line: str) -> str:
    """Return the key that a line states."""
    return line.partition("=")[0].strip(" \t\"'")
