"""The rig at work: loads touch the virtual surface, a device serves its readings, and a file records the true loads."""

import argparse
import asyncio
import logging
import signal
import time
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import numpy as np
from pymodbus.server import ModbusSerialServer, ModbusTcpServer

from beamtouch_common.commands import DONE, INTERRUPTED
from beamtouch_common.errors import InputError
from beamtouch_common.files import require_writable
from beamtouch_common.listening import remedy
from beamtouch_common.outline import Outline, axes_of
from beamtouch_models.design.scene import load_scene
from beamtouch_models.errors import SceneError
from beamtouch_models.lab.rig.devices import ADC_BITS, Module, SerialDevice, rtu_server, start_board, tcp_server
from beamtouch_models.lab.rig.faults import Faults
from beamtouch_models.lab.rig.lines import Relay, joined_line, named_line
from beamtouch_models.lab.rig.loads import ByHand, Load, Script, default_script, load_script
from beamtouch_models.lab.rig.surface import PERFECT, VirtualSurface, load_imperfections
from beamtouch_models.places import in_rows
from beamtouch_models.runtime import loading

TRUTH_PERIOD_S = 0.01

Touching = Callable[[], tuple[Load, float]]
"""Returns the load on the surface now, and the time since the start [s]."""


def run(options: argparse.Namespace) -> int:
    """Serve the surface until the command is stopped; returns the exit code.

    Raises
    ------
    InputError
        An option or a file is wrong, or the port or the path is not available.
    OSError
        The truth file cannot be written.
    """
    inputs = options.scene, options.model, options.script, options.imperfections, *(options.firmware or ())
    require_writable([options.truth], inputs)
    scene, _ = load_scene(options.scene)
    model, module = loading.load(options.model), _module_of(options)
    axes, names = axes_of(len(scene.size_mm)), [channel.name for channel in model.metadata.layout]
    outline = Outline(dict(zip(axes, scene.size_mm, strict=True)))
    # A sensor off the structure comes from a model of another one.
    if model.metadata.outline.axes != axes or np.any(in_rows(model.metadata.layout_mm, len(axes)) > scene.size_mm):
        raise SceneError(
            f"{options.model}: it is a model of {model.metadata.outline}, but {options.scene} is a scene of {outline}"
        )
    # The rig passes replies on itself, and can delay them or leave them out, but for a board and a real port.
    on_a_port = options.modbus_rtu is not None and options.modbus_rtu.is_char_device()
    faults = Faults(names, options.fault, options.seed, own_line=options.firmware is None and not on_a_port)
    script: Script | ByHand
    if options.by_hand:
        script = ByHand(outline, faults)
    else:
        script = load_script(options.script, outline) if options.script else default_script(scene)
    imperfect = load_imperfections(options.imperfections) if options.imperfections else PERFECT
    rings = not options.no_ringing
    surface = VirtualSurface(scene, model.metadata, options.seed, imperfect, faults=faults, rings=rings)
    module.check(surface.channels, surface.sensor.adc_bits)
    if options.firmware and options.serial is None:
        raise InputError("--firmware needs --serial")
    if options.firmware and surface.sensor.adc_bits != ADC_BITS:
        raise InputError(f"the firmware's ADC has {ADC_BITS} bits; set sensors.adc_bits = {ADC_BITS} in the scene")
    return INTERRUPTED if asyncio.run(_serve(surface, script, faults, module, options)) else DONE


def _module_of(options: argparse.Namespace) -> Module:
    """Return the module that the options state; InputError for a device that has no registers."""
    settings = {field.name: getattr(options, field.name) for field in fields(Module)}
    settings = {name: value for name, value in settings.items() if value is not None}
    if settings and options.serial is not None:
        raise InputError(f"--{next(iter(settings)).replace('_', '-')} needs --modbus-tcp or --modbus-rtu")
    return Module(**settings)


async def _serve(
    surface: VirtualSurface, script: Script | ByHand, faults: Faults, module: Module, options: argparse.Namespace
) -> bool:
    """Serve until SIGINT or SIGTERM; returns whether it was SIGINT. `faults` delay replies and leave them out."""
    started = time.monotonic()

    def clock() -> float:
        return time.monotonic() - started

    def touching() -> tuple[Load, float]:
        seconds = clock()
        return script.at(seconds), seconds

    stop = asyncio.Event()
    received: list[signal.Signals] = []

    def stop_on(number: signal.Signals) -> None:
        received.append(number)
        stop.set()

    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop_on, number)
    with ExitStack() as resources:
        serve = await _open(options, surface, touching, module, Relay(faults, clock), resources)
        if isinstance(script, ByHand):
            script.follow(clock)
        tasks: list[asyncio.Future[Any]] = [asyncio.ensure_future(serve)]
        if options.truth is not None:
            tasks.append(asyncio.ensure_future(_write_truth(options.truth, surface.axes, touching)))
        tasks.append(asyncio.ensure_future(stop.wait()))
        done, pending = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in pending:
            task.cancel()
        await asyncio.gather(*pending, return_exceptions=True)
        for task in done:
            task.result()
    return signal.SIGINT in received


async def _open(
    options: argparse.Namespace,
    surface: VirtualSurface,
    touching: Touching,
    module: Module,
    relay: Relay,
    resources: ExitStack,
) -> Awaitable[None]:
    """Open the device, print its address, and return the awaitable that serves it."""

    def convert() -> list[int]:
        return surface.counts(*touching())

    if options.modbus_tcp is not None:
        host, port = options.modbus_tcp
        # The relay delays replies, not the server: pymodbus gives a reply the number of the newest request.
        tcp = tcp_server(convert, surface.channels, module, "127.0.0.1", 0)
        await _listen(tcp, "127.0.0.1")
        try:
            front = await relay.listen(host, port, _port_of(tcp.transport))
        except OSError as error:
            await tcp.shutdown()  # type: ignore[no-untyped-call]  # pymodbus leaves it without annotations
            raise SceneError(f"cannot listen on {host}:{port}: {remedy(error, '--modbus-tcp')}") from None
        resources.callback(front.close)
        _announce(f"modbus-tcp {host}:{_port_of(front)}")
        return tcp.serving
    if options.modbus_rtu is not None:
        path = options.modbus_rtu
        port_name = str(path) if path.is_char_device() else resources.enter_context(joined_line(path, relay))
        rtu = rtu_server(convert, surface.channels, module, port_name)
        await _listen(rtu, str(path))
        _announce(f"modbus-rtu {path}")
        return rtu.serving
    if options.firmware is not None:
        board, elf = options.firmware
        serving = await start_board(board, elf, options.serial, lambda: surface.outputs(*touching()))
    else:
        line = resources.enter_context(named_line(options.serial))
        serving = SerialDevice(line, convert, surface.channels, surface.sensor.adc_bits, relay).serve()
    _announce(f"serial {options.serial}")
    return serving


async def _listen(server: ModbusTcpServer | ModbusSerialServer, where: str) -> None:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it prints its last frames when a client goes
    try:
        await server.serve_forever(background=True)
    except RuntimeError:  # pymodbus raises it when it cannot listen
        raise SceneError(f"cannot listen on {where}; it may be in use") from None


def _port_of(server: object) -> int:
    """Return the port of a server that listens; with port 0 the system chooses it."""
    port: int = cast(asyncio.Server, server).sockets[0].getsockname()[1]
    return port


def _announce(where: str) -> None:
    print(f"listening on {where}", flush=True)


async def _write_truth(path: Path, axes: tuple[str, ...], touching: Touching) -> None:
    """Write the true load every 10 ms; each row is flushed at once, so that a reader can follow the file live."""
    with path.open("w", encoding="ascii", buffering=1) as file:
        file.write(",".join(["unix_time_s", *(f"{axis}_mm" for axis in axes), "force_n"]) + "\n")
        while True:
            now, _ = touching()
            there = [""] * len(axes) if now.place_mm is None else [f"{mm:.4f}" for mm in np.atleast_1d(now.place_mm)]
            file.write(f"{time.time():.6f},{','.join(there)},{now.force_n:.4f}\n")
            await asyncio.sleep(TRUTH_PERIOD_S)
