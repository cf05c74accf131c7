"""The command `beamtouch-rig`: serves a virtual surface over a real line."""

import argparse
import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path

from beamtouch_common.commands import DONE, INTERRUPTED, Parser, exit_code, whole_number
from beamtouch_common.errors import InputError
from beamtouch_models.errors import WRONG_INPUT_ERRORS

PROGRAM = "beamtouch-rig"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `beamtouch-rig`; returns the exit code: 0 stopped by SIGTERM, 2 wrong input, 130 interrupted by Ctrl-C."""
    return exit_code(PROGRAM, "rig", lambda: _run(_parser().parse_args(arguments)), WRONG_INPUT_ERRORS)


def _run(options: argparse.Namespace) -> int:
    # Imported here, so that --help is quick and a missing extra is reported in one line.
    from beamtouch_models import modelfile  # noqa: PLC0415
    from beamtouch_models.rig.by_hand import ByHand  # noqa: PLC0415
    from beamtouch_models.rig.firmware import ADC_BITS, Firmware  # noqa: PLC0415
    from beamtouch_models.rig.imperfections import Imperfections, load_imperfections  # noqa: PLC0415
    from beamtouch_models.rig.run import Device, run  # noqa: PLC0415
    from beamtouch_models.rig.script import Script, default_script, load_script  # noqa: PLC0415
    from beamtouch_models.rig.surface import VirtualSurface  # noqa: PLC0415
    from beamtouch_models.scene import load_scene  # noqa: PLC0415

    scene, _ = load_scene(options.scene)
    model = modelfile.load(options.model)
    length_mm = scene.beam.length_mm
    if options.by_hand:
        script: Script | ByHand = ByHand(length_mm)
    else:
        script = load_script(options.script, length_mm) if options.script else default_script(scene)
    imperfect = load_imperfections(options.imperfections) if options.imperfections else Imperfections()
    surface = VirtualSurface(scene, model.metadata, options.seed, imperfect)
    firmware = Firmware(*options.firmware) if options.firmware else None
    if firmware and options.serial is None:
        message = "--firmware needs --serial"
        raise InputError(message)
    if firmware and surface.sensor.adc_bits != ADC_BITS:
        message = f"the firmware's ADC has {ADC_BITS} bits; set sensors.adc_bits = {ADC_BITS} in the scene"
        raise InputError(message)
    device = Device(options.modbus_tcp, options.modbus_rtu, options.serial, firmware)
    interrupted = asyncio.run(run(surface, script, device, options.truth))
    return INTERRUPTED if interrupted else DONE


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
    if not host or not port.isdecimal() or int(port) > 65535:
        message = f"{text!r} is not HOST:PORT, such as 127.0.0.1:5020"
        raise argparse.ArgumentTypeError(message)
    return host, int(port)


if __name__ == "__main__":
    sys.exit(main())
