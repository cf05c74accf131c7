"""Never takes an old answer of a Modbus RTU unit for a new one. Pure; the line sends and receives.

Answers carry no number, but a unit answers in order. A probe is a request whose answer cannot be a value: it has
another function or another length. Once a unit has answered a probe, it owes no answer to earlier requests. Two probes
take turns: the answer to one shows that every earlier request for the other is done as well, so that its next answer
is new. No clock is involved, however late a unit is.

At the beginning of a session the requests of earlier programs are unknown. Then both probes must be answered, one after
the other, and silence must follow.
"""

import random
from collections.abc import Callable, Collection
from typing import NamedTuple, Protocol

from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import MAX_REGISTERS, Block
from beamtouch_daemon.sources.rtu_frame import Answer
from beamtouch_daemon.uptime import uptime_s

READ_FUNCTIONS = (4, 3, 1, 2)
"""Functions that only read, so that a probe never changes a device; the most widely supported first."""
REFUSALS = (1, 2, 3)
"""Exceptions by which a unit refuses a probe each time: function, address and number of registers. A refusal is an
answer too. Other exceptions pass, or come from a gateway."""
AT_A_START, AFTER_A_FAILURE = 2, 1
"""Probes needed before the next value."""
STARTS = 3
"""A start is repeated this often if answers come in its silence. Then another master may be asking the unit."""
SUSPECT_S = 10.0
"""After an answer that nobody asked for, a probe precedes every value for this long."""
LEARN_AGAIN_S = 60.0
"""A unit that has proven nothing for this long may be another device: its probes are found again."""
FORGOTTEN_S, FORGOTTEN_TIMEOUTS = 5.0, 10
"""No answer is expected after the longer of this time and this number of timeouts. Used only where no probe helps."""


class Request(NamedTuple):
    """Registers to read, and by function and length what the answer looks like."""

    function: int
    block: Block
    any_length: bool = False
    """Whether the function alone identifies the answer."""


class Line(Protocol):
    """The way to one unit."""

    timeout_s: float
    complaint: str
    """Why the last request has no answer."""

    async def ask(self, request: Request) -> Answer | None:
        """Send a request; return its answer or refusal, None if neither comes intact within the timeout."""
        ...

    async def is_quiet(self) -> bool:
        """Listen for answers that nobody asked for; return whether none came."""
        ...

    async def wait(self, for_s: float) -> None:
        """Send nothing for a time [s]."""
        ...


class _Probe(NamedTuple):
    request: Request
    is_refused: bool


def forgotten_s(timeout_s: float) -> float:
    """Return the largest delay of an answer [s], for units without two probes."""
    return max(FORGOTTEN_S, FORGOTTEN_TIMEOUTS * timeout_s)


def probes_of(asked: Collection[tuple[int, Block]]) -> list[Request]:
    """Return requests whose answers differ from all values that are read from a unit as these (function, block) pairs.

    They have another function, or another length: up to two registers more than the longest block.
    """
    function, longest = max(asked, key=lambda one: one[1].count)
    lengths = {block.count for asked_function, block in asked if asked_function == function}
    free = [count for count in range(1, min(longest.count + 2, MAX_REGISTERS) + 1) if count not in lengths]
    blocks = [Block(min(longest.first, 0x10000 - count), count) for count in (free[:2] + free[-2:])]
    used = {asked_function for asked_function, _ in asked}
    others = [Request(one, Block(longest.first, 1), any_length=True) for one in READ_FUNCTIONS if one not in used]
    return [*others, *(Request(function, block) for block in dict.fromkeys(blocks))]


class Unit:
    """A unit on a bus, and whether it may owe the answer to a request for values.

    Parameters
    ----------
    address
        Of the unit.
    clock
        Monotonic seconds.
    """

    def __init__(self, address: int, clock: Callable[[], float] = uptime_s) -> None:
        self.address = address
        self.asked: set[tuple[int, Block]] = set()
        """Function and block of all requests for values."""
        self._clock = clock
        self._probes: list[_Probe] = []
        """At most two requests that the unit answers; the next one to use is the first."""
        self._is_learned = False
        """Whether the probes have been looked for."""
        self._proofs = AT_A_START
        """Probes that must be answered before the next value."""
        self._is_start = True
        """Whether the requests of earlier programs may still be answered."""
        self._restarts = 0
        self._asked_s = self._proven_s = -LEARN_AGAIN_S
        self._suspect_until_s = -SUSPECT_S
        self._has_waited = False
        """Whether its first pause without requests is over."""

    @property
    def is_unprovable(self) -> bool:
        """Whether the unit has fewer than two probes, so that only a pause separates late answers from new ones."""
        return self._is_learned and len(self._probes) < AT_A_START

    def will_be_asked(self, function: int, blocks: Collection[Block]) -> None:
        """Add requests for values. Probes are then found again, as the answer to an old one may look like a value."""
        more = {(function, block) for block in blocks} - self.asked
        if more:
            self.asked |= more
            self._forget()
            self._restarts += 1

    def restart(self) -> None:
        """Note that earlier requests are unknown, because the port was opened."""
        self._is_start = True
        self._restarts += 1

    def take_unexpected(self) -> None:
        """Note an answer to a request for values that nobody waits for; it may be a copy, or for another master."""
        if not self._proofs and not self._is_start:
            self._suspect_until_s = self._clock() + SUSPECT_S

    async def read(self, line: Line, request: Request) -> Answer:
        """Return registers that the unit has read after this call, or its refusal.

        Raises
        ------
        NoAnswerError
            The unit does not answer, or is left alone because it did not answer.
        """
        restarts = self._restarts
        if self._clock() < self._suspect_until_s and not self.is_unprovable:
            self._proofs = max(self._proofs, AFTER_A_FAILURE)
        is_proof = self._is_start or self._proofs > 0
        if is_proof and (refusal := await self._prove(line, request)) is not None:
            return refusal
        if restarts == self._restarts:
            self._is_start = False
            self._asked_s = self._clock()
            answer = None
            try:
                answer = await line.ask(request)
            finally:
                # A refusal may be the late one of a probe.
                self._proofs = AFTER_A_FAILURE if answer is None or answer.exception else 0
        if restarts != self._restarts:
            message = f"unit {self.address} is probed again: the port was opened, or other registers are read"
            raise NoAnswerError(message, lives=is_proof)
        if answer is None:
            raise self._no_answer(line, lives=is_proof)
        if not self._proofs and not self.is_unprovable:
            self._proven_s = self._clock()
        return answer

    async def _prove(self, line: Line, request: Request) -> Answer | None:
        """Have probes answered, or wait, until the unit owes no value; return its refusal if it refuses a probe."""
        if self._clock() - self._proven_s >= LEARN_AGAIN_S:
            self._forget()
        if not self._is_learned:
            await self._learn(line, request)
        if self.is_unprovable:
            await self._leave_alone(line)
            return None
        refusal = await self._ask_probes(line)
        if not self._is_start:
            return refusal
        for _ in range(STARTS - 1):
            if refusal is not None or await line.is_quiet():
                return refusal
            refusal = await self._ask_probes(line)
        self._suspect_until_s = self._clock() + SUSPECT_S
        return refusal

    async def _learn(self, line: Line, request: Request) -> None:
        """Find two probes that the unit answers, if it answers anything."""
        self._asked_s, restarts = self._clock(), self._restarts
        if await line.ask(request) is None:  # any working unit answers this; the answer may be an old one
            raise self._no_answer(line)
        candidates, probes = probes_of(self.asked), list[_Probe]()
        # Answers to probes of an earlier program may still come, but hardly in this order.
        for candidate in random.SystemRandom().sample(candidates, len(candidates)):
            # Two refusals of one function look alike.
            is_alike = any(known.is_refused and known.request.function == candidate.function for known in probes)
            if len(probes) < AT_A_START and not is_alike:
                answer = await line.ask(candidate)
                if answer is not None and answer.exception in (0, *REFUSALS):
                    probes.append(_Probe(candidate, is_refused=bool(answer.exception)))
        if restarts == self._restarts:
            self._probes, self._is_learned, self._proven_s = probes, True, self._clock()
        else:
            raise NoAnswerError(f"unit {self.address} is probed again: other registers are read", lives=True)

    async def _ask_probes(self, line: Line) -> Answer | None:
        """Have the probes answered that are needed; return the refusal of one that was answered before."""
        probes, lives = self._probes, False
        if self._is_start:
            self._proofs = AT_A_START
        while self._proofs:
            answer = await line.ask(probes[0].request)
            if answer is None:
                raise self._no_answer(line, lives=lives)
            if bool(answer.exception) is not probes[0].is_refused:
                self._forget()  # it behaves otherwise than before
                if answer.exception:
                    return answer
                raise NoAnswerError(f"unit {self.address} is probed again: it answers what it refused", lives=True)
            lives = True
            probes.reverse()
            self._proofs -= 1
        return None

    async def _leave_alone(self, line: Line) -> None:
        """Wait until the unit owes nothing: the first time here, later with NoAnswerError until then."""
        silence_s = forgotten_s(line.timeout_s)
        left_s = self._asked_s + silence_s - self._clock()
        if left_s > 0:
            if self._has_waited or silence_s > FORGOTTEN_S:
                reason = "so that no late answer counts as a new one"
                raise NoAnswerError(f"unit {self.address} is left alone for {silence_s:g} s, {reason}")
            self._has_waited = True
            await line.wait(left_s)

    def _forget(self) -> None:
        self._probes, self._is_learned, self._is_start = [], False, True

    def _no_answer(self, line: Line, *, lives: bool = False) -> NoAnswerError:
        return NoAnswerError(f"unit {self.address} {line.complaint}", lives=lives)
