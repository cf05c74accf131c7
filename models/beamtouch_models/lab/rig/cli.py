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

    def work() -> int:
        options = _parser().parse_args(arguments)
        # Imported here, so that --help is quick and a missing extra is reported in one line.
        code: int = import_module("beamtouch_models.lab.rig.run").run(options)
        return code

    return exit_code(PROGRAM, "rig", work, WRONG_INPUT_ERRORS)


def _parser() -> Parser:
    parser = Parser(PROGRAM, description="Simulate a surface and serve its readings over Modbus or serial.")
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file of the simulated surface (TOML)")
    words = "model file with the sensor positions (.onnx)"
    parser.add_argument("--model", type=Path, required=True, metavar="MODEL", help=words)
    device = parser.add_mutually_exclusive_group(required=True)
    words = "serve Modbus TCP; port 0 picks a free port"
    device.add_argument("--modbus-tcp", type=_address, metavar="HOST:PORT", help=words)
    words = "serve Modbus RTU on a serial device, or on a pseudo-terminal created at PATH"
    device.add_argument("--modbus-rtu", type=Path, metavar="PATH", help=words)
    words = "serve the serial protocol on a pseudo-terminal created at PATH"
    device.add_argument("--serial", type=Path, metavar="PATH", help=words)
    words = "with --serial: run this firmware on the simulated board"
    parser.add_argument("--firmware", type=Path, nargs=2, metavar=("BOARD", "ELF"), help=words)
    module = parser.add_argument_group("registers of the Modbus module, as in the daemon's configuration")
    module.add_argument("--unit", type=whole_number(0, 255), metavar="N", help="unit (default: 1)")
    words = "3: holding registers; 4: input registers (default: 4)"
    module.add_argument("--function", type=int, choices=(3, 4), help=words)
    words = "register of the first sensor, counted from 0; the others follow (default: 0)"
    module.add_argument("--register", type=whole_number(0, 2**16 - 1), metavar="N", help=words)
    words = "data type of a value (default: u16)"
    module.add_argument("--type", choices=("u16", "i16", "u32", "i32", "f32", "f64"), help=words)
    words = "order of the bytes (default: ABCD)"
    module.add_argument("--byte-order", choices=("ABCD", "CDAB", "BADC", "DCBA"), help=words)
    touching = parser.add_mutually_exclusive_group()
    words = "loads over time (TOML; default: a built-in script)"
    touching.add_argument("--script", type=Path, metavar="FILE", help=words)
    touching.add_argument(
        "--by-hand",
        action="store_true",
        help="take loads from standard input: a position in mm (on a plate, x and y) and a force in N per line; an "
        "empty line lifts. A line may also be a fault as with --fault, without times, or mend, which ends all faults",
    )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="FAULT",
        help="unplugged:s1, stuck:s1, inverted:s1 (a sensor); swapped:s1,s2 (the cables of two); lost:10 (percent of "
        "the replies), late:80 (ms that each takes longer), pause (the device does nothing). @10..20 puts it on from "
        "10 to 20 s after the start, @10.. from 10 s on, and @0..0.06/0.4 for 0.06 s every 0.4 s. May be repeated",
    )
    parser.add_argument("--truth", type=Path, metavar="FILE.csv", help="write the true place and force every 10 ms")
    words = "differences of the real surface from the scene (TOML)"
    parser.add_argument("--imperfections", type=Path, metavar="FILE", help=words)
    words = "let the surface follow a load at once. By default it rings, with the damping that the scene states"
    parser.add_argument("--no-ringing", action="store_true", help=words)
    number, words = whole_number(0, 2**32 - 1), "seed of the noise (default: 0)"
    parser.add_argument("--seed", type=number, default=0, metavar="S", help=words)
    return parser


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    try:
        host_name(host)
    except ValueError:
        host = ""
    if not host or not port.isdecimal() or int(port) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT, such as 127.0.0.1:5020")
    return host, int(port)


if __name__ == "__main__":
    sys.exit(main())
