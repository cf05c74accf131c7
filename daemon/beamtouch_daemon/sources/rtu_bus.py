"""A serial bus with any number of Modbus RTU units, shared by all surfaces that read from it.

Answers carry no number: only order, unit, function and length tell them apart. A client that continues after a late
answer assigns every answer to the wrong request, without an error. Serial clients of libraries do that, so this one is
written by hand. It has at most one request on the bus; `rtu_unit` proves which answers are new.
"""

import asyncio
from collections.abc import AsyncIterator, Collection, Iterator
from contextlib import asynccontextmanager

from pymodbus.framer import FramerRTU

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import DECODER, Answer, Block, answer_to
from beamtouch_daemon.sources.rtu_unit import READ_FUNCTIONS, Unit, forgotten_s
from beamtouch_daemon.sources.serial_port import SerialPort
from beamtouch_daemon.uptime import uptime_s

BITS_PER_CHARACTER = 11
MIN_SILENCE_S = 0.00175
"""Silence between frames: 3.5 characters, or this long above 19200 baud."""
QUIET_S = (0.1, 0.5)
"""Bounds of the silence that a proof needs at the start of a session; in between, it is one timeout."""
REST_S, REST_TIMEOUTS = 0.5, 13.0
"""A unit that was given up is tried again after the longer of this time and this number of timeouts: it takes at most
1/14 of the bus."""
COPIES = (
    "Modbus RTU answers carry no number. Two kinds of answers cannot be told from the right one: a copy that comes "
    "after the next request, and the answer to another master that asks the same unit for as many registers."
)
_FRAMER = FramerRTU(DECODER)
_ENVELOPE_BYTES = 3
"""Unit and checksum."""


class RtuBus:
    """One serial port, opened by its first user and closed by its last."""

    def __init__(self, settings: ModbusRtu) -> None:
        self._settings = settings
        self._silence_s = _silence_s(settings)
        self._lock = asyncio.Lock()
        """Held for one request and its answer."""
        self._users = 0
        self._port: SerialPort | None = None
        self._units: dict[int, Unit] = {}
        self._free_s = 0.0

    def unit(self, address: int) -> Unit:
        """Return the unit at an address, shared by all its users."""
        return self._units.setdefault(address, Unit(address))

    @asynccontextmanager
    async def used(self) -> AsyncIterator[SerialPort]:
        """Keep the port open during the block; SourceError if it cannot be opened."""
        if self._port is None or self._port.failure:
            settings = self._settings
            self._port = SerialPort(settings.port, settings.baud, settings.parity, settings.stop_bits)
            for unit in self._units.values():
                unit.restart()
        self._users += 1
        try:
            yield self._port
        finally:
            self._users -= 1
            if not self._users and self._port is not None:
                self._port.close()

    @asynccontextmanager
    async def turn(self, port: SerialPort) -> AsyncIterator[bytes]:
        """Hold the line for one request, once it has been silent for long enough; give what came unexpectedly."""
        async with self._lock:
            await asyncio.sleep(max(0.0, self._free_s - uptime_s()))
            unexpected = port.take()
            self.take_unexpected(unexpected)
            try:
                yield unexpected
            finally:
                self._free_s = uptime_s() + self._silence_s

    def take_unexpected(self, received: bytes) -> None:
        """Suspect the units that have sent values which nobody waits for."""
        for unit in self._units.values():
            answers = [data for _, data in _answers_of(unit.address, received)]
            if any(answer_to(block, data) for block in unit.blocks for data in answers):
                unit.suspect()


class RtuLink:
    """A unit on a serial bus, as a surface reads it; the way to it while the link is open."""

    def __init__(self, bus: RtuBus, address: int, blocks: Collection[Block], timeout_s: float) -> None:
        self.name = f"unit {address}"
        self.rest_s = max(REST_S, REST_TIMEOUTS * timeout_s)
        self.timeout_s = timeout_s
        self._bus = bus
        self._unit = bus.unit(address)
        self._blocks = blocks
        self._port: SerialPort
        """The port that this session has opened. If it fails, the session ends, and the next one proves anew."""

    @property
    def limits(self) -> tuple[str, ...]:
        """Cases in which old or foreign answers may pass unnoticed, a sentence each."""
        if not self._unit.is_unprovable:
            return (COPIES,)
        unprovable = (
            f"{self.name} answers only requests for its values, so a late answer looks like a new one. After a missing "
            f"answer it is left alone for {forgotten_s(self.timeout_s):g} s; an answer that comes even later counts "
            "as a new one."
        )
        return unprovable, COPIES

    @asynccontextmanager
    async def opened(self) -> AsyncIterator[None]:
        """Keep the port open; SourceError if it cannot be opened."""
        async with self._bus.used() as self._port:
            async with self._unit.turn:
                self._unit.will_be_asked(self._blocks)
            yield

    async def read(self, block: Block) -> Answer:
        """Read registers, in turn with the other users of the bus."""
        async with self._unit.turn:
            return await self._unit.read(self, block)

    async def ask(self, block: Block) -> Answer:
        """Send a request; return its answer or refusal, NoAnswerError if neither comes intact within the timeout."""
        request = _FRAMER.encode(block.request, self._unit.address, 0)
        async with self._bus.turn(self._port):
            asked_s, received = uptime_s(), b""
            self._port.send(request)
            while (left_s := asked_s + self.timeout_s - uptime_s()) > 0:
                received += await self._port.receive(left_s)
                received = received.replace(request, b"")  # adapters may echo
                for end, data in _answers_of(self._unit.address, received):
                    if answer := answer_to(block, data, asked_s):
                        self._bus.take_unexpected(received[end:])
                        return answer
        within = f"within {self.timeout_s * 1e3:.0f} ms"
        message = f"{self.name} does not answer{' intact' if received else ''} {within}"
        if any(_answers_of(self._unit.address, received)):
            message = f"{self.name} answers, but not {within}: its answers come late"
        raise NoAnswerError(message)

    async def is_quiet(self) -> bool:
        """Listen for answers to an earlier program; return whether none came."""
        until_s = uptime_s() + min(max(self.timeout_s, QUIET_S[0]), QUIET_S[1])
        async with self._bus.turn(self._port) as unexpected:
            received = unexpected
            while (left_s := until_s - uptime_s()) > 0:
                received += await self._port.receive(left_s)
            received += self._port.take()  # a busy machine reads late
        codes = [code for function in READ_FUNCTIONS for code in (function, function | 0x80)]
        return not any(bytes([self._unit.address, code]) in received for code in codes)


def _silence_s(settings: ModbusRtu) -> float:
    """Return the silence between two frames on a bus [s]."""
    if settings.silence_ms is not None:
        return settings.silence_ms / 1e3
    return max(MIN_SILENCE_S if settings.baud > 19_200 else 0.0, 3.5 * BITS_PER_CHARACTER / settings.baud)


def _answers_of(address: int, received: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield function and contents of all intact answers of a unit, each with the place behind it.

    A frame has no start mark, only a checksum at its end. So everything that begins as an answer of the unit is tried.
    """
    for begin in range(len(received) - 1):
        if received[begin] == address and received[begin + 1] & 0x7F in READ_FUNCTIONS:
            *_, data = _FRAMER.decode(received[begin:])
            if data:
                yield begin + len(data) + _ENVELOPE_BYTES, data
