"""Polls the readings of a surface from one or several Modbus units, on a schedule that does not drift.

Units that answer are read in every slot. A unit that does not answer is given up after a few slots: its channels are
missing from the readings, and the other units continue. It is tried again outside the slots, rarely enough to cost the
other units little. A session without a unit that answers ends, unless its units may still boot.
"""

import asyncio
import logging
from collections.abc import AsyncGenerator, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager, AsyncExitStack, ExitStack, contextmanager
from typing import Protocol

from beamtouch_common.log_lines import Repeated
from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.reading import NoAnswerError, Reading, Schedule, SourceError
from beamtouch_daemon.sources.registers import Block, RegisterAnswer, Value
from beamtouch_daemon.sources.requests import Requests, reason_of, refusal_text
from beamtouch_daemon.sources.stamps import Stamps
from beamtouch_daemon.tasks import cancel

GIVEN_UP_AFTER = 3
"""A unit is given up after this many failed slots in a row."""

BOOT_REST_S = 0.5
"""Shortest pause before a unit is tried again that may boot."""
_logger = logging.getLogger(__name__)


class Link(Protocol):
    """Connection to one unit."""

    name: str
    """For messages."""
    rest_s: float
    """Pause before a unit that does not answer is tried again."""
    requests: Requests
    """Outcomes of the requests."""

    @property
    def boots_until_s(self) -> float:
        """Time until which the unit may boot, because the link was just opened."""
        ...

    @property
    def observed(self) -> str:
        """Description of the bytes that came instead of answers; empty if that is not known."""
        ...

    @property
    def limits(self) -> tuple[str, ...]:
        """Known cases in which old or foreign answers may pass unnoticed, a sentence each."""
        ...

    def opened(self) -> AbstractAsyncContextManager[None]:
        """Return a context in which the unit can be read; SourceError if the link cannot be opened."""
        ...

    def kept_open(self) -> AbstractContextManager[None]:
        """Let the link stay open between the contexts of `opened` in the block."""
        ...

    async def read(self, block: Block) -> RegisterAnswer:
        """Read registers; NoAnswerError if the unit does not answer, SourceError if the link is gone."""
        ...


class Part:
    """One unit of a surface, its channels, and whether it answers.

    Parameters
    ----------
    link : Connection to the unit.
    blocks : Registers that are read.
    values : Values by the index of their channel in the reading.
    """

    def __init__(self, link: Link, blocks: Sequence[Block], values: Mapping[int, Value]) -> None:
        self.link = link
        self.values = values
        self.rests_until_s: float
        """Time until which it is left alone, once it is given up."""
        self.complaint = ""
        """Reason of the last failure."""
        self.refusal = ""
        """Reason why some of the registers are missing from the last answers; empty if none are."""
        self.may_boot: bool
        """True if the unit could still boot when it failed last."""
        self._blocks = blocks
        self._failures: int
        """Failed slots in a row."""
        self.revive()

    @property
    def is_given_up(self) -> bool:
        """True if the unit is left out of the slots."""
        return self._failures >= GIVEN_UP_AFTER

    def revive(self) -> None:
        """Take part in the slots again. A unit that then does not answer is given up at once."""
        self._failures = GIVEN_UP_AFTER - 1

    async def read(self) -> tuple[Mapping[int, int], float] | None:
        """Return the contents of the registers, and the time of the first request; None if the unit failed.

        The delay of an answer is unknown, so the time of the request is the latest safe time stamp. Raises SourceError
        if the link is gone.
        """
        contents: dict[int, int] = {}
        answers: list[RegisterAnswer] = []
        self.refusal = ""
        try:
            for block in self._blocks:
                answers.append(answer := await self.link.read(block))
                contents.update(enumerate(answer.registers, block.first))
                if answer.exception:
                    self.refusal = f"{self.link.name} answers with {refusal_text(answer.exception, block)}"
        except NoAnswerError as error:
            self._count(answers, has_contents=True)
            self.link.requests.fail(error.failure)
            self.failed(str(error))
            return None
        self._count(answers, has_contents=bool(contents))
        if not contents:
            self.failed(self.refusal or f"{self.link.name} answers with no registers")
            return None
        self._failures = 0
        return contents, answers[0].asked_s

    def failed(self, complaint: str) -> None:
        """Note a failure."""
        self._failures += 1
        self.complaint = complaint
        now_s = uptime_s()
        self.may_boot = now_s < self.link.boots_until_s
        if self.is_given_up:
            self.rests_until_s = now_s + self.link.rest_s
            if self.may_boot:  # and is tried at the end of that time at the latest
                self.rests_until_s = min(self.rests_until_s, max(self.link.boots_until_s, now_s + BOOT_REST_S))
            self.link.requests.forget()

    def _count(self, answers: Sequence[RegisterAnswer], *, has_contents: bool) -> None:
        """Count the requests that were answered. That a unit lacks some of the registers is no failure now and then."""
        for answer in answers:
            for exception in answer.refusals:
                self.link.requests.fail(reason_of(exception))
            if answer.may_pass or (answer.exception and not has_contents):
                self.link.requests.fail(reason_of(answer.exception))
            else:
                self.link.requests.answered()


class PolledSource:
    """Yields readings of one surface, each from all units that answered in its slot."""

    def __init__(self, name: str, parts: Sequence[Part], channels: int, rate_hz: float) -> None:
        self.requests = {part.link.name: part.link.requests for part in parts}
        """Outcomes of the requests, by the name of the unit."""
        self._parts = tuple(parts)
        self._channels = channels
        self._rate_hz = rate_hz
        self._stamps = Stamps(1 / rate_hz)
        self._repeated = {part: Repeated(_logger, name) for part in parts}
        self._attempts: dict[Part, asyncio.Task[None]] = {}

    @property
    def limits(self) -> tuple[str, ...]:
        """Known cases in which old or foreign answers may pass unnoticed, a sentence each."""
        return tuple(dict.fromkeys(limit for part in self._parts for limit in part.link.limits))

    @contextmanager
    def kept_open(self) -> Iterator[None]:
        """Let the links stay open between the sessions in the block."""
        with ExitStack() as stack:
            for part in self._parts:
                stack.enter_context(part.link.kept_open())
            yield

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        """Open the links and yield a reading per slot, until no unit answers."""
        async with AsyncExitStack() as stack:
            for part in self._parts:
                await stack.enter_async_context(part.link.opened())
            await self._rest()
            stack.push_async_callback(self._end_attempts)
            schedule, lost, failed = Schedule(self._rate_hz, uptime_s()), 0, 0
            has_begun = has_failed = False
            while True:
                missed = await schedule.wait()
                lost += missed
                failed += missed if has_failed else 0  # a request that fails may take many slots
                self._attempt_again()
                failures = self._failures()
                reading = await self._poll()
                has_failed = self._failures() > failures
                if reading is None:
                    lost += 1
                    failed += 1
                elif has_begun:
                    yield [reading._replace(lost=lost, failed=failed)]
                    lost = failed = 0
                else:
                    yield [reading]
                    has_begun, lost, failed = True, 0, 0
                    schedule = Schedule(self._rate_hz, reading.monotonic_s + 1 / self._rate_hz)

    def _failures(self) -> int:
        """Return how many requests have failed."""
        return sum(part.link.requests.failures for part in self._parts)

    async def _rest(self) -> None:
        """If all units were given up, wait until the first of them may be tried again."""
        if all(part.is_given_up for part in self._parts):
            until_s = min(part.rests_until_s for part in self._parts)
            await asyncio.sleep(max(0.0, until_s - uptime_s()))
            for part in self._parts:
                if part.rests_until_s <= until_s:
                    part.revive()

    async def _poll(self) -> Reading | None:
        """Read all units that are not given up; None if none answered, SourceError if all are, and none may boot.

        The reading is as old as the first request; it was taken between that and the last answer.
        """
        live = [part for part in self._parts if not part.is_given_up]
        asked: list[float] = []
        counts: list[float | None] = [None] * self._channels
        if len(live) == 1:  # without a task, which would take a tenth of the time
            answers_of_all = [await self._read(live[0])]
        else:
            answers_of_all = await asyncio.gather(*map(self._read, live))
        answered_s = uptime_s()
        for part, answers in zip(live, answers_of_all, strict=True):
            if answers is not None:
                contents, asked_s = answers
                asked.append(asked_s)
                for index, value in part.values.items():
                    counts[index] = value.decode(contents)
        if asked:
            return Reading(min(asked), tuple(counts), taken_s=self._stamps.date(min(asked), answered_s))
        if all(part.is_given_up and not part.may_boot for part in self._parts):
            reason, observed = (
                "; ".join(dict.fromkeys(filter(None, texts)))
                for texts in ([part.complaint for part in self._parts], [part.link.observed for part in self._parts])
            )
            raise SourceError(reason, observed)
        return None

    async def _read(self, part: Part) -> tuple[Mapping[int, int], float] | None:
        """Read a unit; log once if it refuses some of its registers, or is given up while others go on."""
        answers = await part.read()
        if answers is not None and part.refusal:
            self._repeated[part].failed(part.refusal)
        elif answers is not None:
            self._repeated[part].over(f"{part.link.name} works again")
        elif part.is_given_up and len(self._parts) > 1 and not part.may_boot:
            # The end of the session is logged elsewhere.
            self._repeated[part].failed(f"{part.complaint}; trying again")
        return answers

    def _attempt_again(self) -> None:
        """Try units again that were given up, after their pause and outside the slots."""
        for part, attempt in list(self._attempts.items()):
            if attempt.done():
                del self._attempts[part]
                attempt.result()  # an unexpected error ends the session
        for part in self._parts:
            if part.is_given_up and part not in self._attempts and uptime_s() >= part.rests_until_s:
                self._attempts[part] = asyncio.create_task(self._attempt(part))

    async def _attempt(self, part: Part) -> None:
        try:
            await self._read(part)
        except SourceError as error:
            part.failed(str(error))

    async def _end_attempts(self) -> None:
        await cancel(self._attempts.values())
        self._attempts.clear()
