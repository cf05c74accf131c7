"""Scans a serial line for Modbus RTU units and for a device that speaks the protocol of `PROTOCOL.md`."""

from collections.abc import AsyncGenerator, Sequence

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_bus import RtuBus, UnitLine, silence_s
from beamtouch_daemon.sources.rtu_frame import Answer, find_answer
from beamtouch_daemon.sources.rtu_unit import Request
from beamtouch_daemon.sources.scanned_unit import FUNCTIONS, Asked, FoundUnit, Function, registers_of
from beamtouch_daemon.sources.serial_line import introduce
from beamtouch_daemon.sources.serial_port import SerialPort
from beamtouch_protocol.messages import Hello


def request_s(settings: ModbusRtu) -> float:
    """Return the longest time of a request with these line settings [s]."""
    return settings.timeout_ms / 1e3 + silence_s(settings)


async def scan_units(settings: ModbusRtu, units: Sequence[int]) -> AsyncGenerator[Asked, None]:
    """Ask units one after the other; yield each with what was found.

    Raises
    ------
    SourceError
        The port cannot be opened with these settings, or is gone.
    """
    bus = RtuBus(settings)
    async with bus.used():
        silent: list[int] = []
        for number in units:
            line = UnitLine(bus, number, settings.timeout_ms / 1e3)

            async def ask(function: Function, block: Block, line: UnitLine = line) -> Answer | None:
                return await line.ask(Request(function, block))

            registers = await registers_of(ask)
            found = None if registers is None else FoundUnit(number, registers, settings.baud, settings.parity)
            silent = [*silent[-1:], *([] if found else [number])]
            yield Asked(number, found, len(line.strays), _answered(silent, bytes(line.strays)))


def _answered(units: Sequence[int], received: bytes) -> frozenset[int]:
    """Return which units have sent an answer, in time or not."""
    return frozenset(
        unit for unit in units if any(find_answer(received, unit, function, None) for function in FUNCTIONS)
    )


async def scan_board(path: str, baud: int) -> Hello | None:
    """Return the hello of a device that speaks the protocol, None without one.

    Raises
    ------
    SourceError
        The port cannot be opened with this rate.
    """
    port = SerialPort(path, baud)
    try:
        return await introduce(port, path, baud)
    except SourceError:
        return None
    finally:
        port.close()
