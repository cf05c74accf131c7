"""One request on a serial bus and its answer, among echoes, noise and frames of other units."""

import asyncio
from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_frame import EXCEPTION, Answer, find_answer, find_frame, is_damaged, request
from beamtouch_daemon.sources.rtu_port import RtuPort
from beamtouch_daemon.sources.rtu_unit import Probe, Unit
from beamtouch_daemon.uptime import uptime_s

BITS_PER_CHARACTER = 11
MIN_SILENCE_S = 0.00175
"""Silence between frames: 3.5 characters, or this long above 19200 baud."""
DAMAGED_AFTER_S = 0.05
"""A damaged answer ends when no byte comes for this long: three latency timers (16 ms) of a USB adapter."""
FORGOTTEN_S = 5.0
FORGOTTEN_TIMEOUTS = 10
"""No answer is expected after the longer of this time and this number of timeouts. Used only where no probe helps."""


def forgotten_s(timeout_s: float) -> float:
    """Return the largest delay of an answer [s], for units without probes."""
    return max(FORGOTTEN_S, FORGOTTEN_TIMEOUTS * timeout_s)


def silence_s(settings: ModbusRtu) -> float:
    """Return the silence between two frames on a bus [s]."""
    if settings.silence_ms is not None:
        return settings.silence_ms / 1e3
    return max(MIN_SILENCE_S if settings.baud > 19_200 else 0.0, 3.5 * BITS_PER_CHARACTER / settings.baud)


class Query(NamedTuple):
    """A request to a unit, and the timeout of its answer."""

    unit: Unit
    function: int
    block: Block
    timeout_s: float

    def of(self, probe: Probe) -> "Query":
        """Return the query for a probe of the same unit."""
        return self._replace(function=probe.function, block=probe.block)


class RtuExchange:
    """Sends a request and waits for its answer; the caller sends only one at a time."""

    def __init__(self, settings: ModbusRtu) -> None:
        self.port = RtuPort(settings)
        self._silence_s = silence_s(settings)
        self._sent: deque[bytes] = deque(maxlen=2)
        self._free_s = 0.0

    @property
    def received(self) -> bytes:
        """Received bytes that are not used yet, without echoes."""
        for frame in self._sent:
            while (begin := self.port.received.find(frame)) >= 0:
                del self.port.received[begin : begin + len(frame)]
        return bytes(self.port.received)

    async def pause(self) -> None:
        """Wait until the line has been silent for long enough; collect received bytes."""
        await asyncio.sleep(max(0.0, self._free_s - uptime_s()))
        self.port.read()

    async def listen(self, for_s: float) -> None:
        """Collect received bytes for a time [s]."""
        until_s = uptime_s() + for_s
        while (left_s := until_s - uptime_s()) > 0:
            await self.port.more(left_s)

    def discard(self) -> None:
        """Discard received bytes."""
        self.port.received.clear()

    def has_come_from(self, unit: Unit, functions: Collection[int]) -> bool:
        """Return whether the received bytes contain the start of an answer of a unit to one of these functions."""
        codes = [code for function in functions for code in (function, function | EXCEPTION)]
        return any(bytes([unit.address, code]) in self.received for code in codes)

    async def ask(self, query: Query, probe: Probe | None) -> Answer | None:
        """Send a request for values or (if not None) a probe; return its answer, None if missing or damaged."""
        unit, block = query.unit, query.block
        frame = request(unit.address, query.function, block.first, block.count)
        begin_s = uptime_s()
        unit.sent(probe, begin_s)  # the answer is owed from now on, whatever happens
        self._sent.append(frame)
        self.port.send(frame)
        answer = await self._answer(query, probe, begin_s + query.timeout_s)
        self._free_s = uptime_s() + self._silence_s
        return answer

    async def _answer(self, query: Query, probe: Probe | None, deadline_s: float) -> Answer | None:
        while True:
            answer = self.find(query) if probe is None else self.find_probe(query.unit, probe)
            if answer is not None:
                self.discard()
                return answer
            left_s = deadline_s - uptime_s()
            if is_damaged(self.received, query.unit.address, query.function, query.block.count):
                left_s = min(left_s, DAMAGED_AFTER_S)
            if left_s <= 0 or not await self.port.more(left_s):
                return self._refusal(query.unit) if probe else None

    def find(self, query: Query) -> Answer | None:
        """Return the answer to a query, None if it has not come."""
        return find_answer(self.received, query.unit.address, query.function, query.block.count)

    def find_probe(self, unit: Unit, probe: Probe) -> Answer | None:
        """Return the answer to a probe, None if it has not come; its registers have no meaning."""
        if probe.by_length:
            return find_answer(self.received, unit.address, probe.function, probe.block.count)
        return Answer() if find_frame(self.received, unit.address, probe.function) else None

    def _refusal(self, unit: Unit) -> Answer | None:
        """Return the refusal of a value that came instead of the answer to a probe, or None."""
        functions = {function for function, _ in unit.asked}
        found = (find_answer(self.received, unit.address, function, 0) for function in functions)
        return next((answer for answer in found if answer is not None and answer.exception), None)
