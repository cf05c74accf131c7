"""A serial bus with any number of Modbus RTU units, shared by all surfaces that read from it.

Answers carry no number: only order, unit, function and length tell them apart. A client that continues after a late
answer assigns every answer to the wrong request, without an error. Serial clients of libraries do that, so this one is
written by hand. It has at most one request on the bus. A unit that may owe an answer must answer probes (`rtu_unit`)
before it is asked for values: at the beginning of a session, after a missing answer, and after an unexpected one. A
unit that answers no probe is left alone for a long time instead.
"""

import asyncio
from collections import defaultdict
from collections.abc import AsyncIterator, Collection
from contextlib import asynccontextmanager

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_exchange import Query, RtuExchange, forgotten_s
from beamtouch_daemon.sources.rtu_frame import Answer
from beamtouch_daemon.sources.rtu_proof import Proof
from beamtouch_daemon.sources.rtu_unit import AFTER_A_FAILURE, AT_A_START, EXPLORE_S, READ_FUNCTIONS, Probe, Unit
from beamtouch_daemon.uptime import uptime_s

QUIET_S = (0.1, 0.5)
"""Bounds of the silence that a proof needs at the start of a session; in between, it is one timeout."""
PROOFS = 3
"""Number of proofs for a unit that sends unexpected answers. Then it is suspect: another master may be asking it."""
LEARNING_S = 5.0
"""Time limit for trying the probes of an unknown unit; a longer wait would look like a hanging daemon."""
SUSPECT_S = 10.0
"""After an unexpected answer, a probe precedes every value for this long."""


class RtuBus:
    """One serial port, opened by its first user and closed by its last."""

    def __init__(self, settings: ModbusRtu) -> None:
        self.line = settings.line
        """Line settings of all its users."""
        self._exchange = RtuExchange(settings)
        self._lock = asyncio.Lock()
        """Held for one request and its answer."""
        self._turns: defaultdict[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        """Held while a unit is read, by address; other units may be asked between two requests."""
        self._users = 0
        self._units: dict[int, Unit] = {}

    def unit(self, address: int, function: int, blocks: Collection[Block]) -> Unit:
        """Return the unit at an address, which will be asked for `blocks`; all its users share it."""
        unit = self._units.setdefault(address, Unit(address))
        unit.will_be_asked(function, blocks)
        return unit

    @asynccontextmanager
    async def used(self) -> AsyncIterator[None]:
        """Keep the port open during the block; SourceError if it cannot be opened."""
        if self._exchange.port.open():
            for unit in self._units.values():
                unit.require_probes(AT_A_START)  # earlier requests are unknown
        self._users += 1
        try:
            yield
        finally:
            self._users -= 1
            if not self._users:
                self._exchange.port.close()

    async def read(self, query: Query) -> tuple[Answer, float, float]:
        """Read registers; return the answer, and the times of request and answer on the monotonic clock [s].

        Raises
        ------
        NoAnswerError
            The unit does not answer, or is left alone because it did not answer.
        SourceError
            The port is gone.
        """
        unit = query.unit
        async with self._turns[unit.address]:
            begin_s = uptime_s()
            if begin_s < unit.suspect_until_s and not unit.is_unprovable:
                unit.require_probes(AFTER_A_FAILURE)
            was_needed = unit.probes_needed
            if was_needed and not (unit.is_unprovable and begin_s - unit.explored_s < EXPLORE_S):
                refusal = await self._bring_in_step(query)
                if refusal is not None:
                    return refusal, begin_s, uptime_s()
            if not unit.probes_needed:
                return await self._read(query, lives=bool(was_needed))
        await self._leave_alone(query)
        return await self.read(query)

    async def _bring_in_step(self, query: Query) -> Answer | None:
        """Prove that a unit owes no value; return its refusal if it refuses every request.

        A unit that answers only requests for values cannot be proven. NoAnswerError if the unit does not answer.
        """
        unit = query.unit
        is_start = unit.probes_needed >= AT_A_START or not unit.is_known
        refusal = await self._prove(query)
        for _ in range(PROOFS - 1):
            if not is_start or unit.probes_needed or await self._is_quiet(query):
                return refusal
            unit.require_probes(AT_A_START)
            refusal = await self._prove(query)
        unit.suspect_until_s = uptime_s() + SUSPECT_S
        return refusal

    async def _is_quiet(self, query: Query) -> bool:
        """Listen for answers to an earlier program; return whether none came."""
        async with self._lock:
            await self._exchange.listen(min(max(query.timeout_s, QUIET_S[0]), QUIET_S[1]))
            has_come = self._exchange.has_come_from(query.unit, READ_FUNCTIONS)
            self._exchange.discard()
            return not has_come

    async def _prove(self, query: Query) -> Answer | None:
        """Send probes until the unit owes no value to this program; return its refusal, if any."""
        unit, refusal = query.unit, None
        begin_s = uptime_s()
        proof = Proof(unit, begin_s, forgotten_s(query.timeout_s))
        if proof.is_held_back:
            raise self._left_alone(query)
        if not unit.is_known:  # any working unit answers this; the answer is not used as a value: it may be late
            answer = await self._ask(query, None)
            proof.lives = answer is not None
            refusal = answer if answer is not None and answer.exception else None
        while (unit.is_known or uptime_s() - begin_s < LEARNING_S) and (probe := proof.next()) is not None:
            answer = await self._ask(query, probe)
            is_refused = answer is not None and bool(answer.exception)
            refusal = answer if is_refused else refusal
            proof.take(probe, lives=answer is not None, answered=answer is not None and not is_refused)
        proof.end(uptime_s())
        if not unit.probes_needed or unit.is_unprovable:
            return None
        if refusal is not None:
            return refusal
        if proof.lives:
            message = f"unit {unit.address} answers too late; it is asked for values again when it owes no answer"
            raise NoAnswerError(message)
        raise self._no_answer(query)

    async def _leave_alone(self, query: Query) -> None:
        """Wait until an unprovable unit owes nothing: the first time here, later with NoAnswerError until then."""
        unit, has_waited, silence_s = query.unit, query.unit.has_waited, forgotten_s(query.timeout_s)
        unit.has_waited = True
        while unit.probes_needed and (left_s := unit.asked_s + silence_s - uptime_s()) > 0:
            if has_waited or silence_s > LEARNING_S:
                raise self._left_alone(query)
            await asyncio.sleep(left_s)
        unit.is_in_step(uptime_s())

    async def _read(self, query: Query, *, lives: bool) -> tuple[Answer, float, float]:
        """Ask a unit that owes no answer for values."""
        async with self._lock:
            await self._pause()
            if query.unit.probes_needed:  # while this waited for its turn
                message = f"unit {query.unit.address} is probed again: the port was opened, or other registers are read"
                raise NoAnswerError(message, lives=lives)
            begin_s = uptime_s()
            answer = await self._exchange.ask(query, None)
        if answer is None:
            raise self._no_answer(query, lives=lives)
        query.unit.is_in_step(uptime_s())
        return answer, begin_s, uptime_s()

    async def _ask(self, query: Query, probe: Probe | None) -> Answer | None:
        """Send one request of a proof; other units may be asked between two of them."""
        async with self._lock:
            await self._pause()
            return await self._exchange.ask(query.of(probe) if probe else query, probe)

    def _no_answer(self, query: Query, *, lives: bool = False) -> NoAnswerError:
        damaged = " intact" if self._exchange.received else ""
        message = f"unit {query.unit.address} does not answer{damaged} within {query.timeout_s * 1e3:.0f} ms"
        return NoAnswerError(message, lives=lives)

    def _left_alone(self, query: Query) -> NoAnswerError:
        silence_s = forgotten_s(query.timeout_s)
        reason = "so that no late answer counts as a new one"
        return NoAnswerError(f"unit {query.unit.address} is left alone for {silence_s:g} s, {reason}")

    async def _pause(self) -> None:
        """Wait until a request may be sent. Discard unexpected answers; a unit that owed none becomes suspect."""
        exchange = self._exchange
        await exchange.pause()
        if not exchange.received:
            return
        for unit in self._units.values():
            if not unit.probes_needed and exchange.has_come_from(unit, {function for function, _ in unit.asked}):
                unit.suspect_until_s = uptime_s() + SUSPECT_S
            found = {probe: exchange.find_probe(unit, probe) for probe in unit.unsure}
            unit.learn(probe for probe, answer in found.items() if answer is not None and not answer.exception)
        exchange.discard()
