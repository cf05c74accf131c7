"""The rig at work: loads touch the virtual surface, a device serves its readings, and a file records the true loads."""

import asyncio
import logging
import signal
import time
from collections.abc import Awaitable, Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pymodbus.server import ModbusSerialServer, ModbusTcpServer

from beamtouch_common.listening import remedy
from beamtouch_models.errors import SceneError
from beamtouch_models.rig.devices import Module, SerialDevice, rtu_server, start_board, tcp_server
from beamtouch_models.rig.faults import Faults
from beamtouch_models.rig.lines import Relay, joined_line, named_line
from beamtouch_models.rig.loads import ByHand, Load, Script
from beamtouch_models.rig.surface import VirtualSurface

TRUTH_PERIOD_S = 0.01
TRUTH_HEADER = "unix_time_s,position_mm,force_n"

Touching = Callable[[], tuple[Load, float]]
"""Returns the load on the surface now, and the time since the start [s]."""


@dataclass(frozen=True)
class Device:
    """The device that serves the surface: exactly one of the first three; `firmware` only with `serial`."""

    modbus_tcp: tuple[str, int] | None = None
    modbus_rtu: Path | None = None
    serial: Path | None = None
    firmware: tuple[Path, Path] | None = None
    """The board program, and the firmware image that it runs."""
    module: Module = field(default_factory=Module)

    @property
    def own_line(self) -> bool:
        """Whether the rig passes each reply on itself, so that it can delay it or leave it out."""
        on_a_port = self.modbus_rtu is not None and self.modbus_rtu.is_char_device()
        return self.firmware is None and not on_a_port


async def run(
    surface: VirtualSurface, script: Script | ByHand, device: Device, faults: Faults, truth: Path | None
) -> bool:
    """Serve until SIGINT or SIGTERM; returns whether it was SIGINT. `faults` delay replies and leave them out.

    Raises
    ------
    SceneError
        The port or the path is not available.
    OSError
        The truth file cannot be written.
    """
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
        serve = await _open(device, surface, touching, Relay(faults, clock), resources)
        if isinstance(script, ByHand):
            script.follow(clock)
        tasks: list[asyncio.Future[Any]] = [asyncio.ensure_future(serve)]
        if truth is not None:
            tasks.append(asyncio.ensure_future(_write_truth(truth, touching)))
        tasks.append(asyncio.ensure_future(stop.wait()))
        done, pending = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in pending:
            task.cancel()
        await asyncio.gather(*pending, return_exceptions=True)
        for task in done:
            task.result()
    return signal.SIGINT in received


async def _open(
    device: Device, surface: VirtualSurface, touching: Touching, relay: Relay, resources: ExitStack
) -> Awaitable[None]:
    """Open the device, print its address, and return the awaitable that serves it."""

    def convert() -> list[int]:
        return surface.counts(*touching())

    if device.modbus_tcp is not None:
        host, port = device.modbus_tcp
        # The relay delays replies, not the server: pymodbus gives a reply the number of the newest request.
        tcp = tcp_server(convert, surface.channels, device.module, "127.0.0.1", 0)
        await _listen(tcp, "127.0.0.1")
        try:
            front = await relay.listen(host, port, _port_of(tcp.transport))
        except OSError as error:
            await tcp.shutdown()  # type: ignore[no-untyped-call]  # pymodbus leaves it without annotations
            raise SceneError(f"cannot listen on {host}:{port}: {remedy(error, '--modbus-tcp')}") from None
        resources.callback(front.close)
        _announce(f"modbus-tcp {host}:{_port_of(front)}")
        return tcp.serving
    if device.modbus_rtu is not None:
        path = device.modbus_rtu
        port_name = str(path) if path.is_char_device() else resources.enter_context(joined_line(path, relay))
        rtu = rtu_server(convert, surface.channels, device.module, port_name)
        await _listen(rtu, str(path))
        _announce(f"modbus-rtu {path}")
        return rtu.serving
    if device.serial is None:
        raise AssertionError("no device given")
    if device.firmware is not None:
        serving = await start_board(*device.firmware, device.serial, lambda: surface.outputs(*touching()))
    else:
        line = resources.enter_context(named_line(device.serial))
        serving = SerialDevice(line, convert, surface.channels, surface.sensor.adc_bits, relay).serve()
    _announce(f"serial {device.serial}")
    return serving


async def _listen(server: ModbusTcpServer | ModbusSerialServer, where: str) -> None:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it prints its last frames when a client goes
    try:
        await server.serve_forever(background=True)
    except RuntimeError:  # pymodbus raises it when it cannot listen
        raise SceneError(f"cannot listen on {where}; it may be in use") from None


def _port_of(server: object) -> int:
    """Return the port of a server; with port 0 the system chooses it."""
    if not isinstance(server, asyncio.Server):
        raise AssertionError("the server does not listen")
    port: int = server.sockets[0].getsockname()[1]
    return port


def _announce(where: str) -> None:
    print(f"listening on {where}", flush=True)


async def _write_truth(path: Path, touching: Touching) -> None:
    """Write the true load every 10 ms; each row is flushed at once, so that a reader can follow the file live."""
    with path.open("w", encoding="ascii", buffering=1) as file:
        file.write(TRUTH_HEADER + "\n")
        while True:
            now, _ = touching()
            position = "" if now.position_mm is None else f"{now.position_mm:.4f}"
            file.write(f"{time.time():.6f},{position},{now.force_n:.4f}\n")
            await asyncio.sleep(TRUTH_PERIOD_S)
