"""Command line of the daemon: its arguments. Each command is a module in `commands`.

Exit 0: done; 1: failed; 2: wrong input; 130: Ctrl-C. An error is one line that says what to do.
"""

import argparse
import importlib
import sys
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path
from typing import get_args

from beamtouch_common import archive_commands as archives
from beamtouch_common import log_lines
from beamtouch_common.commands import Parser, exit_code, whole_number
from beamtouch_daemon.argument_types import BAUDS, MAX_TIMEOUT_MS, bauds, between, numbers, parities
from beamtouch_daemon.config.value_types import ByteOrder, ValueType

PROGRAM = "beamtouch-daemon"
MAX_WAIT_S = 86_400.0
LOGGED = ("delivery", "running", "sources")
"""Parts that write log lines: folders."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""

    def work() -> int:
        arguments = _parser().parse_args(_join_loads(sys.argv[1:] if argv is None else argv))
        log_lines.set_up(as_json=arguments.log_format == "json", levels=arguments.log_level)
        code: int = importlib.import_module(f"beamtouch_daemon.commands.{arguments.command}").run(arguments)
        return code

    return exit_code(PROGRAM, "daemon", work)


def _join_loads(words: Sequence[str]) -> list[str]:
    """Return a command line on which the numbers of each load are one word behind its `--at`.

    A load has two numbers on a beam and three on a plate. argparse, told of both, would take a CONFIG behind them too.
    """
    joined, left = list[str](), list(words)
    while left:
        joined.append(left.pop(0))
        if joined[-1] == "--at":
            count = 3 if len(left) > 2 and _is_number(left[2]) else 2
            load = list(takewhile(lambda word: _is_number(word) or not word.startswith("-"), left[:count]))
            joined += [" ".join(load)] if load else []
            del left[: len(load)]
    return joined


def _is_number(word: str) -> bool:
    try:
        float(word.replace(",", "."))
    except ValueError:
        return False
    return True


def _parser() -> Parser:
    parser = Parser(PROGRAM, description="Read the sensors and publish samples.")
    parser.set_defaults(log_format="text", log_level=[])
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, text: str, *, reads_config: bool = True) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        if reads_config:
            command.add_argument("config", metavar="CONFIG", type=Path, help="configuration file (TOML)")
        log_lines.add_level_option(command, "beamtouch_daemon", LOGGED)
        return command

    _add_run(add("run", "read all surfaces and publish their samples until stopped"))
    check = add("check", "read every channel once and print counts, gap, deflection and quality")
    check.add_argument("--json", action="store_true", help="print one JSON object on standard output")
    words = "wait up to S seconds until all channels arrive and the service takes samples (default: read once)"
    check.add_argument("--wait", type=between(0, MAX_WAIT_S, "seconds"), metavar="S", help=words)
    tare = add("tare", "measure the rest gaps, with nothing on the beam")
    tare.add_argument("--surface", metavar="NAME", help="tare this surface only (default: all)")
    tare.add_argument(
        "--accept-change",
        action="store_true",
        help="accept rest gaps that contradict the last tare or the configuration, for example after moving sensors",
    )
    backup = add("backup", "write all that makes a gateway into one archive: configuration, tare files, certificate")
    archives.add_backup(backup)
    archives.add_restore(add("restore", "restore an archive of `backup`", reads_config=False))
    _add_record(add("record", "record known loads for design-sensors calibrate"))
    _add_noise(add("noise", "measure the noise of the readings, with nothing on the beam"))
    _add_scan(add("scan", "find what answers on a serial line or behind a Modbus TCP address", reads_config=False))
    init = commands.add_parser("init", help="write a configuration for the sensors of a model")
    _add_init(init)
    return parser


def _add_run(command: argparse.ArgumentParser) -> None:
    words = "file with the service's token; overrides the configuration"
    command.add_argument("--token-file", metavar="FILE", type=Path, help=words)
    words = "file that keeps the samples on disk that the record does not have yet; overrides the configuration"
    command.add_argument("--sample-log-file", metavar="FILE", type=Path, help=words)
    command.add_argument("--summary", metavar="FILE", type=Path, help="write the final counts to FILE (JSON)")
    command.add_argument(
        "--log-format",
        choices=("text", "json"),
        default="text",
        help="log format on standard error (default: text)",
    )


def _add_record(command: argparse.ArgumentParser) -> None:
    command.add_argument("--surface", metavar="NAME", help="surface to record; needed if there are several")
    command.add_argument("-o", "--output", metavar="FILE.csv", type=Path, required=True, help="file to write")
    command.add_argument("--append", action="store_true", help="add to an existing file")
    command.add_argument(
        "--at",
        type=str.split,
        action="append",
        metavar="MM N",
        help="position and force of a load, on a plate x, y and force; repeat it for each load (default: ask for each "
        "load)",
    )
    command.add_argument(
        "--accept",
        action="store_true",
        help="record the loads of --at even if they are off the beam, too heavy, not visible or not steady",
    )
    command.add_argument(
        "--seconds", type=float, default=2.0, metavar="S", help="how long to record each load (default: 2)"
    )


def _add_noise(command: argparse.ArgumentParser) -> None:
    command.description = (
        "Measure the noise of the readings, with nothing on the beam: their standard deviation, how long they stay "
        "alike, and the drift. Prints the lines for the configuration and for the scene; the effective noise in them "
        "is that of the configured filter."
    )
    command.add_argument("--surface", metavar="NAME", help="measure this surface only (default: all)")
    command.add_argument(
        "--seconds",
        type=float,
        metavar="S",
        help="how long to record (default: 60, or longer if the filter averages longer); as drift grows with time, "
        "record as long as passes between two tares if it matters",
    )
    command.add_argument("--json", action="store_true", help="print one JSON object on standard output")


def _add_scan(command: argparse.ArgumentParser) -> None:
    command.description = (
        "Find what answers on a serial line or behind a Modbus TCP address. It only reads registers (functions 3 and "
        "4), and asks for a Beamtouch board. Stop other programs and masters on the line first."
    )
    command.add_argument("target", metavar="TARGET", help="/dev/ttyUSB0, for example, or tcp://HOST[:PORT]")
    words = "units to ask (default: 1-16; over TCP 0 and 255, too)"
    command.add_argument("--units", type=numbers, metavar="LIST", help=words)
    words = "baud rates to try (default: 9600,19200,115200,38400,57600, and 1000000 for a Beamtouch board)"
    command.add_argument("--baud", type=bauds, metavar="LIST", help=words)
    command.add_argument("--parity", type=parities, metavar="LIST", help="parities to try (default: none,even,odd)")
    words = "how long to wait for each answer (default: 100; over TCP 200)"
    command.add_argument("--timeout-ms", type=between(1, MAX_TIMEOUT_MS, "milliseconds"), metavar="MS", help=words)
    command.add_argument("--json", action="store_true", help="print one JSON object on standard output")


def _add_init(command: argparse.ArgumentParser) -> None:
    command.description = (
        "Write a configuration: what belongs to the model, from the file that design-sensors build --daemon-config "
        "wrote, and the source and the service of this machine."
    )
    command.add_argument("config", metavar="CONFIG", type=Path, help="configuration file to write (TOML)")
    words = "configuration that design-sensors build --daemon-config wrote for the model"
    command.add_argument("--model-config", metavar="FILE", type=Path, help=words)
    words = "rtu:/dev/ttyUSB0, serial:/dev/ttyACM0 or tcp://HOST[:PORT], as scan finds it"
    command.add_argument("--source", metavar="ADDRESS", help=words)
    words = "baud rate (default: 115200; serial: 1000000)"
    command.add_argument("--baud", type=whole_number(BAUDS[0], BAUDS[-1]), metavar="N", help=words)
    command.add_argument("--parity", choices=("none", "even", "odd"), help="parity of an rtu line (default: none)")
    command.add_argument("--unit", type=whole_number(0, 255), metavar="N", help="Modbus unit (default: 1)")
    words = "4: input registers, 3: holding registers (default: 4)"
    command.add_argument("--function", type=int, choices=(3, 4), help=words)
    words = "type of the values of a Modbus unit (default: as in the model's configuration, u16)"
    command.add_argument("--type", choices=get_args(ValueType), help=words)
    words = (
        "first register of the values, from 0; the channels follow without a gap (default: as in that configuration)"
    )
    command.add_argument("--register", type=whole_number(0, 65_535), metavar="N", help=words)
    words = "order of the bytes of values in several registers (default: ABCD)"
    command.add_argument("--byte-order", choices=get_args(ByteOrder), help=words)
    words = "how long to wait for each answer of a Modbus unit (default: 100; tcp: 200)"
    command.add_argument("--timeout-ms", type=between(1, MAX_TIMEOUT_MS, "milliseconds"), metavar="MS", help=words)
    words = "the service (default: as in the model's configuration)"
    command.add_argument("--url", metavar="URL", help=words)
    words = "file with the service's token (default: as in the model's configuration, beside CONFIG)"
    command.add_argument("--token-file", metavar="FILE", type=Path, help=words)
    words = "certificate to trust with https (PEM; default: those of the system)"
    command.add_argument("--certificate-file", metavar="FILE", type=Path, help=words)
    command.add_argument("--force", action="store_true", help="replace an existing CONFIG")
