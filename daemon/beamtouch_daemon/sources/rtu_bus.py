"""A serial bus with any number of Modbus RTU units, shared by all surfaces that read from it.

Answers carry no number: only order, unit, function and length tell them apart. A client that continues after a late
answer assigns every answer to the wrong request, without an error. Serial clients of libraries do that, so this one is
written by hand: a link asks its unit (`rtu_unit`), which proves which answers are new, and asks the line (`rtu_line`).
"""

from collections.abc import AsyncIterator, Collection
from contextlib import AbstractContextManager, asynccontextmanager

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.kept_port import KeptPort
from beamtouch_daemon.sources.registers import Block, RegisterAnswer, answer_to
from beamtouch_daemon.sources.requests import Requests
from beamtouch_daemon.sources.rtu_frames import answers_of, silence_of
from beamtouch_daemon.sources.rtu_line import RtuLine, UnitLine
from beamtouch_daemon.sources.rtu_unit import Unit, forgotten_s
from beamtouch_daemon.sources.serial_port import LineSettings

REST_S, REST_TIMEOUTS = 0.5, 13.0
"""A unit that was given up is tried again after the longer of this time and this number of timeouts: it takes at most
1/14 of the bus."""
COPIES = (
    "Modbus RTU answers carry no number. Two kinds of answers cannot be told from the right one: a copy that comes "
    "after the next request, and the answer to another master that asks the same unit for as many registers."
)


class RtuBus:
    """The line of one port, and the units on it."""

    def __init__(self, settings: ModbusRtu) -> None:
        self.port = KeptPort(settings.port, LineSettings(settings.baud, settings.parity, settings.stop_bits))
        self._silence_s = silence_of(settings.baud) if settings.silence_ms is None else settings.silence_ms / 1e3
        self._units: dict[int, Unit] = {}
        self._line: RtuLine | None = None

    def unit(self, address: int) -> Unit:
        """Return the unit at an address, shared by all its users."""
        return self._units.setdefault(address, Unit(address))

    @asynccontextmanager
    async def used(self) -> AsyncIterator[RtuLine]:
        """Give the line during a session; SourceError if its port cannot be opened."""
        async with self.port.used() as port:
            if self._line is None or self._line.port is not port:
                self._line = RtuLine(port, self._silence_s, self._take_unexpected)
                for unit in self._units.values():
                    unit.restart()
            yield self._line

    def _take_unexpected(self, received: bytes) -> None:
        """Suspect the units that have sent values which nobody waits for."""
        for unit in self._units.values():
            answers = [data for _, data in answers_of(unit.address, received)]
            if any(answer_to(block, data) for block in unit.blocks for data in answers):
                unit.suspect()


class RtuLink:
    """A unit on a serial bus, as a surface reads it."""

    def __init__(self, bus: RtuBus, address: int, blocks: Collection[Block], timeout_s: float) -> None:
        self.name = f"unit {address}"
        self.rest_s = max(REST_S, REST_TIMEOUTS * timeout_s)
        self.requests = Requests()
        self._timeout_s = timeout_s
        self._bus = bus
        self._unit = bus.unit(address)
        self._blocks = blocks
        self._unit_line: UnitLine
        """Through the port of this session. If it fails, the session ends, and the next one proves again."""

    @property
    def limits(self) -> tuple[str, ...]:
        """Cases in which old or foreign answers may pass unnoticed, a sentence each."""
        if not self._unit.is_unprovable:
            return (COPIES,)
        unprovable = (
            f"{self.name} answers only requests for its values, so a late answer looks like a new one. After a missing "
            f"answer it is not polled for {forgotten_s(self._timeout_s):g} s; an answer that comes even later counts "
            "as a new one."
        )
        return unprovable, COPIES

    @property
    def boots_until_s(self) -> float:
        """Time until which the devices on the bus may boot, as opening the port may reset them."""
        return self._unit_line.line.port.traffic.boots_until_s

    @property
    def observed(self) -> str:
        """Description of the bytes that came through the port instead of answers; empty if any came lately."""
        return self._unit_line.line.port.traffic.describe(uptime_s())

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """Use the port for a session; SourceError if it cannot be opened."""
        async with self._bus.used() as line:
            self._unit_line = UnitLine(line, self._unit.address, self._timeout_s)
            async with self._unit.lock:
                self._unit.will_be_asked(self._blocks)
            yield

    def kept_open(self) -> AbstractContextManager[None]:
        """Let the port stay open between the sessions in the block."""
        return self._bus.port.kept_open()

    async def read(self, block: Block) -> RegisterAnswer:
        """Read registers, in turn with the other users of the bus."""
        async with self._unit.lock:
            return await self._unit.read(self._unit_line, block)
