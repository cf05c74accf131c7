"""A serial bus with any number of Modbus RTU units, shared by all surfaces that read from it.

Answers carry no number: only order, unit, function and length tell them apart. A client that continues after a late
answer assigns every answer to the wrong request, without an error. Serial clients of libraries do that, so this one is
written by hand. It has at most one request on the bus, and removes echoes; `rtu_unit` proves which answers are new.
"""

import asyncio
from collections import defaultdict, deque
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources import rtu_frame
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_frame import Answer
from beamtouch_daemon.sources.rtu_port import RtuPort
from beamtouch_daemon.sources.rtu_unit import READ_FUNCTIONS, Request, Unit
from beamtouch_daemon.uptime import uptime_s

BITS_PER_CHARACTER = 11
MIN_SILENCE_S = 0.00175
"""Silence between frames: 3.5 characters, or this long above 19200 baud."""
QUIET_S = (0.1, 0.5)
"""Bounds of the silence that a proof needs at the start of a session; in between, it is one timeout."""
DAMAGED_AFTER_S = 0.05
"""A damaged answer ends when no byte comes for this long: three latency timers (16 ms) of a USB adapter."""


def silence_s(settings: ModbusRtu) -> float:
    """Return the silence between two frames on a bus [s]."""
    if settings.silence_ms is not None:
        return settings.silence_ms / 1e3
    return max(MIN_SILENCE_S if settings.baud > 19_200 else 0.0, 3.5 * BITS_PER_CHARACTER / settings.baud)


class RtuBus:
    """One serial port, opened by its first user and closed by its last."""

    def __init__(self, settings: ModbusRtu) -> None:
        self.line = settings.line
        """Line settings of all its users."""
        self.port = RtuPort(settings)
        self._silence_s = silence_s(settings)
        self._lock = asyncio.Lock()
        """Held for one request and its answer."""
        self._turns: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        """Held while a unit is read, by address; other units may be asked between two requests."""
        self._users = 0
        self._units: dict[int, Unit] = {}
        self._sent: deque[bytes] = deque(maxlen=2)
        self._free_s = 0.0

    def unit(self, address: int, function: int, blocks: Collection[Block]) -> Unit:
        """Return the unit at an address, which will be asked for `blocks`; all its users share it."""
        unit = self._units.setdefault(address, Unit(address))
        unit.will_be_asked(function, blocks)
        return unit

    @asynccontextmanager
    async def used(self) -> AsyncIterator[None]:
        """Keep the port open during the block; SourceError if it cannot be opened."""
        if self.port.open():
            for unit in self._units.values():
                unit.restart()
        self._users += 1
        try:
            yield
        finally:
            self._users -= 1
            if not self._users:
                self.port.close()

    async def read(self, unit: Unit, request: Request, timeout_s: float) -> tuple[Answer, float, float]:
        """Read registers; return the answer, and the times of request and answer on the monotonic clock [s].

        Raises
        ------
        NoAnswerError
            The unit does not answer, or is left alone because it did not answer.
        SourceError
            The port is gone.
        """
        async with self._turns[unit.address]:
            line = UnitLine(self, unit.address, timeout_s)
            answer = await unit.read(line, request)
            return answer, line.asked_s, uptime_s()

    @asynccontextmanager
    async def turn(self) -> AsyncIterator[bytes]:
        """Hold the line for one request, once it has been silent for long enough; give what came unexpectedly."""
        async with self._lock:
            await asyncio.sleep(max(0.0, self._free_s - uptime_s()))
            self.port.read()
            unexpected = self.received
            for unit in self._units.values():
                if any(rtu_frame.begins(unexpected, unit.address, *asked) for asked in unit.asked):
                    unit.take_unexpected()
            self.port.received.clear()
            try:
                yield unexpected
            finally:
                self._free_s = uptime_s() + self._silence_s
                self.port.received.clear()

    @property
    def received(self) -> bytes:
        """Received bytes that are not used yet, without echoes."""
        for frame in self._sent:
            while (begin := self.port.received.find(frame)) >= 0:
                del self.port.received[begin : begin + len(frame)]
        return bytes(self.port.received)

    def send(self, frame: bytes) -> None:
        """Send a request."""
        self._sent.append(frame)
        self.port.send(frame)


class UnitLine:
    """The way to one unit on a bus."""

    def __init__(self, bus: RtuBus, address: int, timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self.complaint = ""
        """Why the last request has no answer."""
        self.asked_s = 0.0
        """Time of the last request."""
        self.strays = bytearray()
        """Received bytes that were no answer in time."""
        self._bus = bus
        self._address = address

    async def ask(self, request: Request) -> Answer | None:
        """Send a request; return its answer or refusal, None if neither comes intact within the timeout."""
        block = request.block
        async with self._bus.turn() as unexpected:
            self.asked_s = uptime_s()
            self._bus.send(rtu_frame.request(self._address, request.function, block.first, block.count))
            answer = await self._answer(request)
            late = b"" if answer else self._bus.received
            self.complaint = self._complaint(late)
            self.strays += unexpected + late
            return answer

    async def is_quiet(self) -> bool:
        """Listen for answers to an earlier program; return whether none came."""
        async with self._bus.turn():
            until_s = uptime_s() + min(max(self.timeout_s, QUIET_S[0]), QUIET_S[1])
            while (left_s := until_s - uptime_s()) > 0:
                await self._bus.port.more(left_s)
            return not self._has_come(self._bus.received)

    async def wait(self, for_s: float) -> None:
        """Send nothing to the unit for a time [s]."""
        await asyncio.sleep(for_s)

    async def _answer(self, request: Request) -> Answer | None:
        count = None if request.any_length else request.block.count
        while True:
            received = self._bus.received
            answer = rtu_frame.find_answer(received, self._address, request.function, count)
            if answer is not None:
                return answer
            left_s = self.asked_s + self.timeout_s - uptime_s()
            if count and rtu_frame.is_damaged(received, self._address, request.function, count):
                left_s = min(left_s, DAMAGED_AFTER_S)
            if left_s <= 0 or not await self._bus.port.more(left_s):
                return None

    def _has_come(self, received: bytes) -> bool:
        """Return whether the received bytes contain the start of any answer of the unit."""
        codes = [code for function in READ_FUNCTIONS for code in (function, function | rtu_frame.EXCEPTION)]
        return any(bytes([self._address, code]) in received for code in codes)

    def _complaint(self, received: bytes) -> str:
        within = f"within {self.timeout_s * 1e3:.0f} ms"
        if any(rtu_frame.find_answer(received, self._address, function, None) for function in READ_FUNCTIONS):
            return f"answers, but not {within}: its answers come late"
        return f"does not answer{' intact' if received else ''} {within}"
