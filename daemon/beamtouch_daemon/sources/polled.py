"""Polls the readings of a surface from one or several Modbus units, on a schedule that does not drift.

Units that answer are read in every slot. A unit that does not answer is given up after a few slots: its channels are
missing from the readings, and the other units continue. It is tried again outside the slots, rarely enough to cost the
other units little.
"""

import asyncio
import logging
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import AsyncExitStack

from beamtouch_daemon.faults import Fault
from beamtouch_daemon.sources.part import GIVEN_UP_AFTER, Part
from beamtouch_daemon.sources.reading import NoAnswerError, Reading, Schedule, SourceError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.tasks import cancel
from beamtouch_daemon.uptime import uptime_s

_EXCEPTIONS = {
    1: "it does not know this function",
    2: "it has no such register: asked for {registers}; addresses count from 0, so a manual's 30001 or 40001 is 0",
    3: "it refuses that many registers: asked for {registers}",
    4: "device failure",
    6: "device busy",
    10: "gateway path unavailable",
    11: "gateway: the device does not answer",
}
_log = logging.getLogger(__name__)


class PolledSource:
    """Yields readings of one surface, each from all units that answered in its slot."""

    def __init__(self, name: str, parts: Sequence[Part], channels: int, rate_hz: float) -> None:
        self._parts = tuple(parts)
        self._channels = channels
        self._rate_hz = rate_hz
        self._faults = {part.link.name: Fault(_log, f"{name}: {part.link.name}") for part in parts}

    @property
    def limits(self) -> tuple[str, ...]:
        """Known cases in which old or foreign answers may pass unnoticed, a sentence each."""
        return tuple(dict.fromkeys(limit for part in self._parts for limit in part.link.limits))

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        """Open the links and yield a reading per slot, until no unit answers."""
        async with AsyncExitStack() as stack:
            for part in self._parts:
                await stack.enter_async_context(part.link.opened())
            await self._rest()
            stack.push_async_callback(self._end_attempts)
            schedule, unread = Schedule(self._rate_hz, uptime_s()), 0
            while True:
                unread += await schedule.wait()
                if len(self._parts) > 1:
                    self._attempt_again()
                reading = await self._poll(unread)
                if reading is None:
                    unread += 1
                else:
                    unread = 0
                    yield [reading]

    async def _rest(self) -> None:
        """If all units were given up, wait until the first of them may be tried again."""
        if all(part.is_given_up for part in self._parts):
            until_s = min(part.rests_until_s for part in self._parts)
            await asyncio.sleep(max(0.0, until_s - uptime_s()))
            for part in self._parts:
                if part.rests_until_s <= until_s:
                    part.failures = GIVEN_UP_AFTER - 1

    async def _poll(self, lost: int) -> Reading | None:
        """Read all units that are not given up; None if none answered, SourceError if all are given up.

        The reading is as old as its oldest part.
        """
        if len(self._parts) == 1:
            live: Sequence[Part] = self._parts
            taken = [await self._read(live[0])]
        else:
            live = [part for part in self._parts if not part.is_given_up]
            taken = await asyncio.gather(*map(self._read, live))
        stamps: list[float] = []
        counts: list[float | None] = [None] * self._channels
        for part, found in zip(live, taken, strict=True):
            if found is not None:
                contents, stamp_s = found
                stamps.append(stamp_s)
                for index, value in part.values.items():
                    counts[index] = value.decode(contents)
        if stamps:
            return Reading(min(stamps), tuple(counts), lost)
        if all(part.is_given_up for part in self._parts):
            raise SourceError("; ".join(dict.fromkeys(part.complaint for part in self._parts)))
        return None

    async def _read(self, part: Part) -> tuple[Mapping[int, int], float] | None:
        """Return the contents of a unit's registers, and the time of the first request; None if it failed.

        The delay of an answer is unknown, so the time of the request is the latest safe time stamp.
        """
        contents: dict[int, int] = {}
        refusal: tuple[int, Block] | None = None
        begin_s = None
        try:
            for block in part.blocks:
                answer, asked_s, _ = await part.link.read(block)
                begin_s = asked_s if begin_s is None else begin_s
                if answer.exception:
                    refusal = answer.exception, block
                contents.update(enumerate(answer.registers, block.first))
        except NoAnswerError as error:
            part.failures = 0 if error.lives else part.failures
            self._failed(part, str(error))
            return None
        if not contents or begin_s is None:
            self._failed(part, f"{part.link.name} answers with {_refusal_text(refusal)}")
            return None
        if part.failures:
            part.failures = 0
            self._faults[part.link.name].recovered()
        return contents, begin_s

    def _failed(self, part: Part, complaint: str) -> None:
        part.failed(complaint)
        if part.is_given_up and len(self._parts) > 1:  # the end of the session is logged elsewhere
            self._faults[part.link.name].failed(f"{complaint}; trying again")

    def _attempt_again(self) -> None:
        """Try units again that were given up, after their pause and outside the slots."""
        for part in self._parts:
            idle = part.attempt is None or part.attempt.done()
            if part.is_given_up and idle and uptime_s() >= part.rests_until_s:
                part.attempt = asyncio.create_task(self._attempt(part))

    async def _attempt(self, part: Part) -> None:
        try:
            await self._read(part)
        except SourceError as error:
            part.failed(str(error))

    async def _end_attempts(self) -> None:
        await cancel(part.attempt for part in self._parts if part.attempt is not None)


def _refusal_text(refusal: tuple[int, Block] | None) -> str:
    if refusal is None:
        return "no registers"
    exception, block = refusal
    last = block.first + block.count - 1
    registers = f"{block.first}" if block.count == 1 else f"{block.first} to {last}"
    return f"exception {exception}: {_EXCEPTIONS.get(exception, 'an error').format(registers=registers)}"
