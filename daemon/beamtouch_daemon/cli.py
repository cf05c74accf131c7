"""Command line of the daemon: its arguments. Each command is a module in `commands`.

Exit 0: done; 1: failed; 2: wrong input; 130: Ctrl-C. An error is one line that says what to do.
"""

import argparse
import importlib
from collections.abc import Sequence
from pathlib import Path

from beamtouch_common.commands import Parser, exit_code
from beamtouch_daemon import logs
from beamtouch_daemon.exits import PROGRAM


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""

    def work() -> int:
        arguments = _parser().parse_args(argv)
        logs.set_up(as_json=arguments.log_format == "json")
        code: int = importlib.import_module(f"beamtouch_daemon.commands.{arguments.command}").run(arguments)
        return code

    return exit_code(PROGRAM, "daemon", work)


def _parser() -> Parser:
    parser = Parser(PROGRAM, description="Read the sensors and publish samples.")
    parser.set_defaults(log_format="text")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, text: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        command.add_argument("config", metavar="CONFIG", type=Path, help="configuration file (TOML)")
        return command

    _add_run(add("run", "read all surfaces and publish their samples until stopped"))
    check = add("check", "read every channel once and print counts, gap, deflection and quality")
    check.add_argument("--json", action="store_true", help="print one JSON object on standard output")
    tare = add("tare", "measure the rest gaps, with nothing on the beam")
    tare.add_argument("--surface", metavar="NAME", help="tare this surface only (default: all)")
    tare.add_argument(
        "--accept-change",
        action="store_true",
        help="accept rest gaps that contradict the last tare or the configuration, for example after moving sensors",
    )
    _add_record(add("record", "record known loads for design-sensors calibrate"))
    _add_noise(add("noise", "measure the noise of the readings, with nothing on the beam"))
    return parser


def _add_run(command: argparse.ArgumentParser) -> None:
    words = "file with the service's token; overrides the configuration"
    command.add_argument("--token-file", metavar="FILE", type=Path, help=words)
    words = "file that keeps undelivered samples on disk; overrides the configuration"
    command.add_argument("--spool-file", metavar="FILE", type=Path, help=words)
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
        nargs=2,
        action="append",
        metavar=("MM", "N"),
        help="position and force of a load; repeat it for each load (default: ask for each load)",
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
