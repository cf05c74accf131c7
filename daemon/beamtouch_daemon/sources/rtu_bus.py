"""A serial bus with any number of Modbus RTU units, shared by all surfaces that read from it.

Answers carry no number, so that nothing but order, unit, function and length tells them apart. A client that goes on
after a late answer takes every answer for the one before it, without an error. Here, at most one request is under way
on the bus, and a unit that may owe an answer is asked for values only after it has answered probes (`rtu_unit`): at the
beginning of a session, after an answer that did not come, and after one that came unasked. A unit that answers no probe
is left alone for long instead.
"""

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager
from time import monotonic
from typing import NamedTuple

from beamtouch_daemon.config_sources import ModbusRtu
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_frame import EXCEPTION, Answer, find_answer, find_frame, is_damaged, request
from beamtouch_daemon.sources.rtu_port import RtuPort
from beamtouch_daemon.sources.rtu_unit import AFTER_A_FAILURE, AT_A_START, EXPLORE_S, Probe, Proof, Unit

BITS_PER_CHARACTER = 11
MIN_SILENCE_S = 0.00175
"""Between frames the line is silent for 3.5 characters, and for this long above 19200 baud."""
DAMAGED_AFTER_S = 0.05
"""A damaged answer is given up when no more bytes come for this long: three latency timers (16 ms) of a USB adapter."""
QUIET_S = 0.1
"""A port that was just opened is listened to until it has been quiet for this long."""
LONGEST_LISTENING_S = 1.0
"""Another master may never be quiet."""
FORGOTTEN_S = 5.0
FORGOTTEN_TIMEOUTS = 50
"""No answer comes after the longer of a time and a number of timeouts. Only what no probe proves rests on it."""
SUSPECT_S = 10.0
"""After an answer that came unasked, a probe comes before every value for this long."""


class Query(NamedTuple):
    """What to ask of a unit, and how long its answer may take."""

    unit: Unit
    function: int
    block: Block
    timeout_s: float

    @property
    def forgotten_s(self) -> float:
        """How long the unit is left alone where no probe proves that it owes nothing [s]."""
        return forgotten_s(self.timeout_s)


def forgotten_s(timeout_s: float) -> float:
    """Return how late an answer may be at most [s] where no probe proves that none is owed."""
    return max(FORGOTTEN_S, FORGOTTEN_TIMEOUTS * timeout_s)


class RtuBus:
    """One serial port; opened by its first user and closed by its last."""

    def __init__(self, settings: ModbusRtu) -> None:
        silence_s = max(MIN_SILENCE_S if settings.baud > 19_200 else 0.0, 3.5 * BITS_PER_CHARACTER / settings.baud)
        self._silence_s = silence_s if settings.silence_ms is None else settings.silence_ms / 1e3
        self.line = settings.line
        """The settings that all its users agree on."""
        self._lock = asyncio.Lock()
        self._users = 0
        self._port = RtuPort(settings)
        self._sent: deque[bytes] = deque(maxlen=2)
        self._free_s = 0.0
        self._units: dict[int, Unit] = {}

    def unit(self, address: int, function: int, blocks: Collection[Block]) -> Unit:
        """Return a unit that is to be asked for `blocks`; all who read from it share one."""
        unit = self._units.setdefault(address, Unit(address))
        unit.will_be_asked(function, blocks)
        return unit

    @asynccontextmanager
    async def used(self) -> AsyncIterator[None]:
        """Keep the port open during the block; SourceError if it cannot be opened."""
        is_first = self._port.open()
        self._users += 1
        try:
            if is_first:
                await self._begin()
            yield
        finally:
            self._users -= 1
            if not self._users:
                self._port.close()

    async def read(self, query: Query) -> tuple[Answer, float, float]:
        """Read registers; return the answer, and when it was asked and answered on the monotonic clock [s].

        Raises
        ------
        NoAnswerError
            The unit does not answer, or is being left alone after it did not.
        SourceError
            The port is gone.
        """
        unit, lives = query.unit, False
        async with self._lock:
            if monotonic() < unit.suspect_until_s and not unit.is_unprovable:
                unit.doubt(AFTER_A_FAILURE)
            begin_s = monotonic()
            if unit.missing and not (unit.is_unprovable and begin_s - unit.explored_s < EXPLORE_S):
                refusal = await self._prove(query)
                if refusal is not None:
                    return refusal, begin_s, monotonic()
                lives = not unit.missing
            if not unit.missing:
                return await self._exchange(query, lives=lives)
        await self._leave_alone(query)
        return await self.read(query)

    async def _begin(self) -> None:
        """Listen until the line is quiet; nobody knows what was asked before the port was opened."""
        async with self._lock:
            for unit in self._units.values():
                unit.doubt(AT_A_START)
            until_s = monotonic() + LONGEST_LISTENING_S
            while await self._port.more(QUIET_S) and monotonic() < until_s:
                pass

    async def _prove(self, query: Query) -> Answer | None:
        """Send probes until the unit owes no value; return its refusal if that is all that it gives.

        Nothing is proven of a unit that turns out to answer values only. NoAnswerError if a unit does not answer.
        """
        unit, refusal = query.unit, None
        proof = Proof(unit, monotonic(), query.forgotten_s)
        while (probe := proof.next()) is not None:
            answer = await self._ask(query._replace(function=probe.function, block=probe.block), probe)
            is_refused = answer is not None and bool(answer.exception)
            refusal = answer if is_refused else refusal
            proof.take(probe, lives=answer is not None, answered=answer is not None and not is_refused)
        if proof.explores and not proof.lives:
            proof.lives = await self._ask(query, None) is not None  # not believed: it may be late
        proof.end(monotonic())
        if not unit.missing or unit.is_unprovable:
            return None
        if refusal is not None:
            return refusal
        if proof.lives:
            message = f"unit {unit.address} answers, but late; it is asked again once it owes nothing any more"
            raise NoAnswerError(message)
        raise self._no_answer(query)

    async def _leave_alone(self, query: Query) -> None:
        """Wait for the first time until an unprovable unit owes nothing any more; NoAnswerError later, for so long."""
        unit, has_waited = query.unit, query.unit.has_waited
        unit.has_waited = True
        while unit.missing and (left_s := unit.asked_s + query.forgotten_s - monotonic()) > 0:
            if has_waited:
                message = (
                    f"unit {unit.address} is left alone for {query.forgotten_s:g} s, so that no late answer is believed"
                )
                raise NoAnswerError(message)
            await asyncio.sleep(left_s)
        unit.is_in_step(monotonic())

    async def _exchange(self, query: Query, *, lives: bool) -> tuple[Answer, float, float]:
        """Ask a unit that owes nothing for values."""
        begin_s = monotonic()
        answer = await self._ask(query, None)
        if answer is None:
            raise self._no_answer(query, lives=lives)
        query.unit.is_in_step(monotonic())
        return answer, begin_s, monotonic()

    def _no_answer(self, query: Query, *, lives: bool = False) -> NoAnswerError:
        damaged = " intact" if self._port.received else ""
        message = f"unit {query.unit.address} does not answer{damaged} within {query.timeout_s * 1e3:.0f} ms"
        return NoAnswerError(message, lives=lives)

    async def _ask(self, query: Query, probe: Probe | None) -> Answer | None:
        """Send one request and return its answer; None if it does not come, or damaged."""
        await asyncio.sleep(max(0.0, self._free_s - monotonic()))
        self._discard()
        unit, block = query.unit, query.block
        frame = request(unit.address, query.function, block.first, block.count)
        now_s = monotonic()
        unit.sent(probe, now_s)  # and owed until it has come, whatever happens
        self._sent.append(frame)
        self._port.send(frame)
        answer = await self._answer(query, probe, now_s + query.timeout_s)
        self._free_s = monotonic() + self._silence_s
        return answer

    async def _answer(self, query: Query, probe: Probe | None, deadline_s: float) -> Answer | None:
        unit, function, count = query.unit.address, query.function, query.block.count
        while True:
            self._take_off_echo()
            received = bytes(self._port.received)
            if probe is None or probe.by_length:
                answer = find_answer(received, unit, function, count)
            else:
                answer = Answer() if find_frame(received, unit, function) else None
            if answer is not None:
                self._port.received.clear()
                return answer
            left_s = deadline_s - monotonic()
            if is_damaged(received, unit, function, count):
                left_s = min(left_s, DAMAGED_AFTER_S)
            if left_s <= 0 or not await self._port.more(left_s):
                return self._refusal(query.unit) if probe else None

    def _refusal(self, unit: Unit) -> Answer | None:
        """Return the refusal of a value that came instead of the answer to a probe, if one did."""
        functions = {function for function, _ in unit.asked}
        received = bytes(self._port.received)
        found = (find_answer(received, unit.address, function, 0) for function in functions)
        return next((answer for answer in found if answer is not None and answer.exception), None)

    def _take_off_echo(self) -> None:
        """Take off requests of our own, which an adapter may echo, late and in parts."""
        received = self._port.received
        for frame in self._sent:
            while (begin := received.find(frame)) >= 0:
                del received[begin : begin + len(frame)]

    def _discard(self) -> None:
        """Throw away what came unasked; a unit that seems to have sent it is suspect from now on."""
        self._port.read()
        self._take_off_echo()
        received = self._port.received
        for unit in self._units.values():
            functions = {function for function, _ in unit.asked}
            heads = [bytes([unit.address, code]) for one in functions for code in (one, one | EXCEPTION)]
            if not unit.missing and any(head in received for head in heads):
                unit.suspect_until_s = monotonic() + SUSPECT_S
        received.clear()
