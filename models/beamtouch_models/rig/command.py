"""The work of `beamtouch-rig`: from its arguments to a virtual surface on a line."""

import argparse
import asyncio
from dataclasses import fields

from beamtouch_common.commands import DONE, INTERRUPTED
from beamtouch_common.errors import InputError
from beamtouch_common.files import require_writable
from beamtouch_models import loading
from beamtouch_models.rig.by_hand import ByHand
from beamtouch_models.rig.faults import Faults
from beamtouch_models.rig.firmware import ADC_BITS, Firmware
from beamtouch_models.rig.imperfections import Imperfections, load_imperfections
from beamtouch_models.rig.modbus_device import Module
from beamtouch_models.rig.run import Device
from beamtouch_models.rig.run import run as serve
from beamtouch_models.rig.script import Script, default_script, load_script
from beamtouch_models.rig.surface import VirtualSurface
from beamtouch_models.scene import load_scene


def run(options: argparse.Namespace) -> int:
    """Serve the surface until the command is stopped; returns the exit code, InputError for wrong input."""
    require_writable([options.truth], [options.scene, options.model, options.script])
    scene, _ = load_scene(options.scene)
    model = loading.load(options.model)
    length_mm = scene.beam.length_mm
    firmware = Firmware(*options.firmware) if options.firmware else None
    device = Device(options.modbus_tcp, options.modbus_rtu, options.serial, firmware, _module(options))
    names = [channel.name for channel in model.metadata.layout]
    faults = Faults(names, options.fault, options.seed, own_line=device.own_line)
    if options.by_hand:
        script: Script | ByHand = ByHand(length_mm, faults)
    else:
        script = load_script(options.script, length_mm) if options.script else default_script(scene)
    imperfect = load_imperfections(options.imperfections) if options.imperfections else Imperfections()
    rings = not options.no_ringing
    surface = VirtualSurface(scene, model.metadata, options.seed, imperfect, faults=faults, rings=rings)
    device.module.check(surface.channels, surface.sensor.adc_bits)
    if firmware and options.serial is None:
        message = "--firmware needs --serial"
        raise InputError(message)
    if firmware and surface.sensor.adc_bits != ADC_BITS:
        message = f"the firmware's ADC has {ADC_BITS} bits; set sensors.adc_bits = {ADC_BITS} in the scene"
        raise InputError(message)
    interrupted = asyncio.run(serve(surface, script, device, faults, options.truth))
    return INTERRUPTED if interrupted else DONE


def _module(options: argparse.Namespace) -> Module:
    """Return the module that the options state; InputError for a device that has no registers."""
    stated = {field.name: getattr(options, field.name) for field in fields(Module)}
    stated = {name: value for name, value in stated.items() if value is not None}
    if stated and options.serial is not None:
        message = f"--{next(iter(stated)).replace('_', '-')} needs --modbus-tcp or --modbus-rtu"
        raise InputError(message)
    return Module(**stated)
