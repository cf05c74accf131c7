"""Never takes an old answer of a Modbus RTU unit for a new one. Pure; the line sends and receives.

Answers carry no number, but a unit answers in order. A probe is a request whose answer cannot be a value: it has
another function or another length. Once a unit has answered a probe, it owes no answer to earlier requests. Two probes
take turns: the answer to one shows that every earlier request for the other is done as well, so that its next answer
is new. No clock is involved, however late a unit is.

At the beginning of a session the requests of earlier programs are unknown. Then both probes must be answered, one after
the other, and silence must follow.
"""

import asyncio
import math
import random
from collections.abc import Callable, Collection
from contextlib import suppress
from enum import IntEnum
from typing import NamedTuple, Protocol

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.reading import NoAnswerError
from beamtouch_daemon.sources.registers import MAX_REGISTERS, UNREAD, Block, RegisterAnswer
from beamtouch_daemon.sources.requests import reason_of, refusal_text
from beamtouch_daemon.sources.rtu_frames import READ_FUNCTIONS

PROBES = 2
STARTS = 3
"""A start is repeated this often if answers come in its silence. Then another master may be asking the unit."""
SUSPECT_S = 10.0
"""After an answer that nobody asked for, a probe precedes every value for this long."""
LEARN_AGAIN_S = 60.0
"""A unit that has proven nothing for this long may be another device: its probes are found again."""
FORGOTTEN_S, FORGOTTEN_TIMEOUTS = 5.0, 10
"""No answer is expected after the longer of this time and this number of timeouts. Used only where no probe helps."""


class Line(Protocol):
    """The way to one unit, through a port that is open."""

    @property
    def timeout_s(self) -> float:
        """Time for an answer."""
        ...

    async def ask(self, block: Block) -> RegisterAnswer:
        """Send a request; return its answer or refusal, NoAnswerError if neither comes intact within the timeout.

        It is repeated while the refusal may pass. Otherwise a unit that refuses each second request would never answer
        a probe and then a request for values.
        """
        ...

    async def is_quiet(self) -> bool:
        """Listen for answers that nobody asked for; return whether none came."""
        ...


class Owed(IntEnum):
    """Answers that a unit may still send."""

    NOTHING = 0
    VALUES = 1
    """To a request for values."""
    UNKNOWN = 2
    """To requests of earlier programs."""


class _Probe(NamedTuple):
    block: Block
    is_refused: bool


def forgotten_s(timeout_s: float) -> float:
    """Return the largest delay of an answer [s], for units without two probes."""
    return max(FORGOTTEN_S, FORGOTTEN_TIMEOUTS * timeout_s)


def probes_for(blocks: Collection[Block]) -> list[Block]:
    """Return requests whose answers differ from those to all blocks: by function, or by a length close to theirs."""
    longest = max(blocks, key=lambda block: block.count)
    lengths = {block.count for block in blocks if block.function == longest.function}
    free = [count for count in range(1, min(longest.count + 2, MAX_REGISTERS) + 1) if count not in lengths]
    others = set(READ_FUNCTIONS) - {block.function for block in blocks}
    return [
        *(Block(longest.first, 1, function) for function in others),
        *(Block(min(longest.first, 0x10000 - count), count, longest.function) for count in {*free[:2], *free[-2:]}),
    ]


class Unit:
    """A unit on a bus, and the answers that it may owe.

    Parameters
    ----------
    address : Of the unit.
    clock : Monotonic seconds.
    """

    def __init__(self, address: int, clock: Callable[[], float] = uptime_s) -> None:
        self.address = address
        self.lock = asyncio.Lock()
        """Held while the unit is read; other units may be asked between two requests."""
        self.blocks: set[Block] = set()
        """All that is read from it."""
        self._clock = clock
        self._probes: list[_Probe] | None = None
        """At most two requests that the unit answers; the next one to use is the first. None: not looked for."""
        self._owed = Owed.UNKNOWN
        self._asked_s = -math.inf
        """Time of the last request for values."""
        self._proven_s = -math.inf
        """Time when the probes were found, or the last time when they were of use."""
        self._suspect_until_s = -math.inf

    @property
    def is_unprovable(self) -> bool:
        """True if the unit has fewer than two probes, so that only a pause separates late answers from new ones."""
        return self._probes is not None and len(self._probes) < PROBES

    def will_be_asked(self, blocks: Collection[Block]) -> None:
        """Add blocks. Probes are then found again, as the answer to an old one may look like a value."""
        if not self.blocks.issuperset(blocks):
            self.blocks.update(blocks)
            self._probes = None
            self.restart()

    def restart(self) -> None:
        """Note that earlier requests are unknown, because the port was opened."""
        self._owed, self._asked_s = Owed.UNKNOWN, self._clock()

    def suspect(self) -> None:
        """Note an answer with values that nobody waits for; it may be a copy, or for another master."""
        if not self._owed:
            self._suspect_until_s = self._clock() + SUSPECT_S

    async def read(self, line: Line, block: Block) -> RegisterAnswer:
        """Return registers that the unit has read after this call, or its refusal.

        Raises
        ------
        NoAnswerError
            The unit does not answer, or is left alone because it did not answer.
        """
        if self._owed or (self._clock() < self._suspect_until_s and not self.is_unprovable):
            await self._prove(line, block)
        self._owed, self._asked_s = Owed.NOTHING, self._clock()
        is_settled = False
        try:
            answer = await line.ask(block)
            is_settled = self._is_settled_by(answer)
        finally:
            if not is_settled:
                self._owed = max(self._owed, Owed.VALUES)
        if is_settled and not self.is_unprovable:
            self._proven_s = self._clock()
        return answer

    def _is_settled_by(self, answer: RegisterAnswer) -> bool:
        """Return whether the unit owes no values after an answer to a request for them.

        A refusal may be the late one of a probe. A unit without probes has had time for that one.
        """
        refusals = {answer.exception, *answer.refusals} - {0}
        return not refusals or (self.is_unprovable and refusals.issubset(UNREAD))

    async def _prove(self, line: Line, block: Block) -> None:
        """Have probes answered, or let time pass, until the unit owes no values."""
        if self._probes is None or self._clock() - self._proven_s >= LEARN_AGAIN_S:
            await self._learn(line, block)
        if self.is_unprovable:
            await self._leave_alone(line)
        elif self._owed < Owed.UNKNOWN:
            await self._ask_probe(line)
        else:
            for _ in range(STARTS):
                await self._ask_probe(line)
                await self._ask_probe(line)
                if await line.is_quiet():
                    return
            self._suspect_until_s = self._clock() + SUSPECT_S

    async def _learn(self, line: Line, block: Block) -> None:
        """Find two probes that the unit answers, if it answers anything."""
        self._asked_s = self._clock()
        await line.ask(block)  # any working unit answers this; the answer may be an old one
        probes = list[_Probe]()
        # Answers to probes of an earlier program may still come, but hardly in this order.
        candidates = probes_for(self.blocks)
        for candidate in random.SystemRandom().sample(candidates, len(candidates)):
            # Two refusals of one function look alike.
            is_alike = any(known.is_refused and known.block.function == candidate.function for known in probes)
            if len(probes) < PROBES and not is_alike:
                with suppress(NoAnswerError):
                    answer = await line.ask(candidate)
                    if not answer.may_pass:
                        probes.append(_Probe(candidate, is_refused=bool(answer.exception)))
        self._probes, self._proven_s = probes, self._clock()
        if not self.is_unprovable:
            self._owed = Owed.UNKNOWN

    async def _ask_probe(self, line: Line) -> None:
        """Have the next probe answered; the other one is then the next."""
        probes = self._probes or []
        answer = await line.ask(probes[0].block)
        if answer.may_pass:
            refusal = refusal_text(answer.exception, probes[0].block)
            raise NoAnswerError(f"unit {self.address} answers with {refusal}", reason_of(answer.exception))
        if bool(answer.exception) is not probes[0].is_refused:
            self._probes = None
            self.restart()
            raise NoAnswerError(f"unit {self.address} answers otherwise than before")
        probes.reverse()

    async def _leave_alone(self, line: Line) -> None:
        """Wait until the unit owes nothing: at a start here, otherwise with NoAnswerError until then."""
        silence_s = forgotten_s(line.timeout_s)
        left_s = self._asked_s + silence_s - self._clock()
        if left_s > 0 and self._owed < Owed.UNKNOWN:
            reason = "so that no late answer counts as a new one"
            raise NoAnswerError(f"unit {self.address} is not polled for {silence_s:g} s, {reason}")
        await asyncio.sleep(max(0.0, left_s))
