"""The command `beamtouch-rig`: serves a virtual surface over a real line."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from beamtouch_common.commands import Parser, exit_code, whole_number
from beamtouch_common.hosts import host_name
from beamtouch_models.errors import WRONG_INPUT_ERRORS

PROGRAM = "beamtouch-rig"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `beamtouch-rig`; returns the exit code: 0 stopped by SIGTERM, 2 wrong input, 130 interrupted by Ctrl-C."""
    return exit_code(PROGRAM, "rig", lambda: _run(_parser().parse_args(arguments)), WRONG_INPUT_ERRORS)


def _run(options: argparse.Namespace) -> int:
    # Imported here, so that --help is quick and a missing extra is reported in one line.
    code: int = import_module("beamtouch_models.rig.command").run(options)
    return code


def _parser() -> Parser:
    parser = Parser(PROGRAM, description="Simulate a surface and serve its readings over Modbus or serial.")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file of the simulated beam (TOML)")
    parser.add_argument(
        "--model", type=Path, required=True, metavar="MODEL", help="model file with the sensor positions (.onnx)"
    )
    device = parser.add_mutually_exclusive_group(required=True)
    device.add_argument(
        "--modbus-tcp",
        type=_address,
        metavar="HOST:PORT",
        help="serve Modbus TCP, unit 1; port 0 picks a free port",
    )
    device.add_argument(
        "--modbus-rtu",
        type=Path,
        metavar="PATH",
        help="serve Modbus RTU on a serial device, or on a pseudo-terminal created at PATH",
    )
    device.add_argument(
        "--serial", type=Path, metavar="PATH", help="serve the serial protocol on a pseudo-terminal created at PATH"
    )
    parser.add_argument(
        "--firmware",
        type=Path,
        nargs=2,
        metavar=("BOARD", "ELF"),
        help="with --serial: run this firmware on the simulated board",
    )
    touching = parser.add_mutually_exclusive_group()
    touching.add_argument(
        "--script", type=Path, metavar="FILE", help="loads over time (TOML; default: a built-in script)"
    )
    touching.add_argument(
        "--by-hand",
        action="store_true",
        help="take loads from standard input: a position in mm and a force in N per line; an empty line lifts",
    )
    parser.add_argument("--truth", type=Path, metavar="FILE.csv", help="write the true position and force every 10 ms")
    parser.add_argument(
        "--imperfections", type=Path, metavar="FILE", help="differences of the real surface from the scene (TOML)"
    )
    parser.add_argument(
        "--seed", type=whole_number(0, 2**32 - 1), default=0, metavar="S", help="seed of the noise (default: 0)"
    )
    return parser


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    try:
        host_name(host)
    except ValueError:
        host = ""
    if not host or not port.isdecimal() or int(port) > 65535:
        message = f"{text!r} is not HOST:PORT, such as 127.0.0.1:5020"
        raise argparse.ArgumentTypeError(message)
    return host, int(port)


if __name__ == "__main__":
    sys.exit(main())
