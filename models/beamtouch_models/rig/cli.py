"""The command `beamtouch-rig`: serves a virtual surface over a real line."""

from __future__ import annotations

import argparse
import asyncio
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_common.commands import DONE, INTERRUPTED, Parser, exit_code, whole_number
from beamtouch_common.errors import InputError
from beamtouch_common.hosts import host_name
from beamtouch_models.errors import WRONG_INPUT_ERRORS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beamtouch_models.rig.devices import Module
    from beamtouch_models.rig.loads import ByHand, Script

PROGRAM = "beamtouch-rig"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `beamtouch-rig`; returns the exit code: 0 stopped by SIGTERM, 2 wrong input, 130 interrupted by Ctrl-C."""
    return exit_code(PROGRAM, "rig", lambda: _run(_parser().parse_args(arguments)), WRONG_INPUT_ERRORS)


def _run(options: argparse.Namespace) -> int:
    """Serve the surface until the command is stopped; returns the exit code, InputError for wrong input."""
    # Imported here, so that --help is quick and a missing extra is reported in one line.
    from beamtouch_common.files import require_writable
    from beamtouch_models import loading
    from beamtouch_models.rig.devices import ADC_BITS
    from beamtouch_models.rig.faults import Faults
    from beamtouch_models.rig.loads import ByHand, default_script, load_script
    from beamtouch_models.rig.run import Device, run
    from beamtouch_models.rig.surface import PERFECT, VirtualSurface, load_imperfections
    from beamtouch_models.scene import load_scene

    require_writable([options.truth], [options.scene, options.model, options.script])
    scene, _ = load_scene(options.scene)
    model = loading.load(options.model)
    length_mm, firmware = scene.beam.length_mm, options.firmware
    device = Device(options.modbus_tcp, options.modbus_rtu, options.serial, firmware, _module(options))
    names = [channel.name for channel in model.metadata.layout]
    faults = Faults(names, options.fault, options.seed, own_line=device.own_line)
    script: Script | ByHand
    if options.by_hand:
        script = ByHand(length_mm, faults)
    else:
        script = load_script(options.script, length_mm) if options.script else default_script(scene)
    imperfect = load_imperfections(options.imperfections) if options.imperfections else PERFECT
    rings = not options.no_ringing
    surface = VirtualSurface(scene, model.metadata, options.seed, imperfect, faults=faults, rings=rings)
    device.module.check(surface.channels, surface.sensor.adc_bits)
    if firmware and options.serial is None:
        raise InputError("--firmware needs --serial")
    if firmware and surface.sensor.adc_bits != ADC_BITS:
        raise InputError(f"the firmware's ADC has {ADC_BITS} bits; set sensors.adc_bits = {ADC_BITS} in the scene")
    return INTERRUPTED if asyncio.run(run(surface, script, device, faults, options.truth)) else DONE


def _module(options: argparse.Namespace) -> Module:
    """Return the module that the options state; InputError for a device that has no registers."""
    from beamtouch_models.rig.devices import Module

    stated = {field.name: getattr(options, field.name) for field in fields(Module)}
    stated = {name: value for name, value in stated.items() if value is not None}
    if stated and options.serial is not None:
        raise InputError(f"--{next(iter(stated)).replace('_', '-')} needs --modbus-tcp or --modbus-rtu")
    return Module(**stated)


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
        help="serve Modbus TCP; port 0 picks a free port",
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
    module = parser.add_argument_group("registers of the Modbus module, as in the daemon's configuration")
    module.add_argument("--unit", type=whole_number(0, 255), metavar="N", help="unit (default: 1)")
    module.add_argument(
        "--function", type=int, choices=(3, 4), help="3: holding registers; 4: input registers (default: 4)"
    )
    module.add_argument(
        "--register",
        type=whole_number(0, 2**16 - 1),
        metavar="N",
        help="register of the first sensor, counted from 0; the others follow (default: 0)",
    )
    module.add_argument(
        "--type", choices=("u16", "i16", "u32", "i32", "f32"), help="data type of a value (default: u16)"
    )
    module.add_argument(
        "--byte-order", choices=("ABCD", "CDAB", "BADC", "DCBA"), help="order of the bytes (default: ABCD)"
    )
    touching = parser.add_mutually_exclusive_group()
    touching.add_argument(
        "--script", type=Path, metavar="FILE", help="loads over time (TOML; default: a built-in script)"
    )
    touching.add_argument(
        "--by-hand",
        action="store_true",
        help="take loads from standard input: a position in mm and a force in N per line; an empty line lifts. A line "
        "may also be a fault as with --fault, without times, or mend, which ends all faults",
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
    parser.add_argument("--truth", type=Path, metavar="FILE.csv", help="write the true position and force every 10 ms")
    parser.add_argument(
        "--imperfections", type=Path, metavar="FILE", help="differences of the real surface from the scene (TOML)"
    )
    parser.add_argument(
        "--no-ringing",
        action="store_true",
        help="let the beam follow a load at once. By default it rings, with the damping that the scene states",
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
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT, such as 127.0.0.1:5020")
    return host, int(port)


if __name__ == "__main__":
    sys.exit(main())
