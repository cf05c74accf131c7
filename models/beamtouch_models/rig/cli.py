"""The command `beamtouch-rig`: a virtual surface behind a real line."""

import argparse
import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `beamtouch-rig`; returns the exit code: 0 done, 2 wrong input."""
    options = _parser().parse_args(arguments)
    try:
        # Imported here so that a missing extra is one clear line.
        from beamtouch_models import modelfile  # noqa: PLC0415
        from beamtouch_models.errors import InputError  # noqa: PLC0415
        from beamtouch_models.rig.by_hand import ByHand  # noqa: PLC0415
        from beamtouch_models.rig.firmware import ADC_BITS, Firmware  # noqa: PLC0415
        from beamtouch_models.rig.imperfections import Imperfections, load_imperfections  # noqa: PLC0415
        from beamtouch_models.rig.run import Device, run  # noqa: PLC0415
        from beamtouch_models.rig.script import Script, default_script, load_script  # noqa: PLC0415
        from beamtouch_models.rig.surface import VirtualSurface  # noqa: PLC0415
        from beamtouch_models.scene import load_scene  # noqa: PLC0415
    except ModuleNotFoundError as error:
        return _fail(f"needs {error.name}: pip install 'beamtouch[rig]'")
    try:
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
            return _fail("--firmware speaks on a serial line: give --serial as well")
        if firmware and surface.sensor.adc_bits != ADC_BITS:
            return _fail(f"the firmware's ADC has {ADC_BITS} bits: give sensors.adc_bits = {ADC_BITS} in the scene")
        device = Device(options.modbus_tcp, options.modbus_rtu, options.serial, firmware)
        asyncio.run(run(surface, script, device, options.truth))
    except InputError as error:
        return _fail(str(error))
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="beamtouch-rig", description="A virtual surface: loads touch, move and lift on it, and a real line tells."
    )
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML): the beam as it really is")
    parser.add_argument("--model", type=Path, required=True, help="model file: its layout says where the sensors are")
    device = parser.add_mutually_exclusive_group(required=True)
    device.add_argument(
        "--modbus-tcp", type=_address, metavar="HOST:PORT", help="be a Modbus TCP module, unit 1; port 0: any"
    )
    device.add_argument(
        "--modbus-rtu",
        type=Path,
        metavar="PATH",
        help="be a Modbus RTU module; PATH is made unless it is a serial device",
    )
    device.add_argument("--serial", type=Path, metavar="PATH", help="be a device of the serial protocol; PATH is made")
    parser.add_argument(
        "--firmware",
        type=Path,
        nargs=2,
        metavar=("BOARD", "ELF"),
        help="with --serial: let this firmware speak there, on the simulated board",
    )
    touching = parser.add_mutually_exclusive_group()
    touching.add_argument("--script", type=Path, metavar="FILE", help="what touches when (TOML; a default is built in)")
    touching.add_argument(
        "--by-hand",
        action="store_true",
        help="take loads from standard input: a position in mm and a force in N per line; an empty line lifts",
    )
    parser.add_argument(
        "--truth", type=Path, metavar="FILE.csv", help="write the true position and force, a row each 10 ms"
    )
    parser.add_argument(
        "--imperfections", type=Path, metavar="FILE", help="how the real surface differs from the scene (TOML)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the noise (default 0)")
    return parser


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        message = f"{text!r} is not HOST:PORT, such as 127.0.0.1:5020"
        raise argparse.ArgumentTypeError(message)
    return host, int(port)


def _fail(reason: str) -> int:
    print(f"beamtouch-rig: {reason}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
