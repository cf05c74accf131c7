"""A part of a polled surface: one Modbus unit, the connection to it, and its channels."""

import asyncio
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import Protocol

from beamtouch_daemon.sources.registers import Block, Value
from beamtouch_daemon.sources.rtu_frame import Answer
from beamtouch_daemon.uptime import uptime_s

GIVEN_UP_AFTER = 3
"""A unit is given up after this many failed slots in a row."""


class Link(Protocol):
    """Connection to one unit."""

    @property
    def name(self) -> str:
        """Name for messages."""
        ...

    @property
    def timeout_s(self) -> float:
        """Timeout of an answer."""
        ...

    @property
    def rest_s(self) -> float:
        """Pause before a unit that does not answer is tried again."""
        ...

    @property
    def limits(self) -> tuple[str, ...]:
        """Known cases in which old or foreign answers may pass unnoticed, a sentence each."""
        ...

    def opened(self) -> AbstractAsyncContextManager[None]:
        """Return a context in which the unit can be read; SourceError if the link cannot be opened."""
        ...

    async def read(self, block: Block) -> tuple[Answer, float, float]:
        """Read registers; return the answer, and the times of request and answer on the monotonic clock [s].

        Raises NoAnswerError if the unit does not answer, SourceError if the link is gone.
        """
        ...


@dataclass(slots=True)
class Part:
    """One unit and its channels."""

    link: Link
    blocks: tuple[Block, ...]
    values: dict[int, Value]
    """Values by the index of their channel in the reading."""
    failures: int = GIVEN_UP_AFTER - 1
    """Failed slots in a row. A unit that never answered is given up at once."""
    rests_until_s: float = 0.0
    complaint: str = ""
    """Reason of the last failure."""
    attempt: asyncio.Task[None] | None = field(default=None)

    @property
    def is_given_up(self) -> bool:
        """Whether the unit is left out of the slots."""
        return self.failures >= GIVEN_UP_AFTER

    def failed(self, complaint: str) -> None:
        """Note a failure."""
        self.failures += 1
        self.complaint = complaint
        if self.is_given_up:
            self.rests_until_s = uptime_s() + self.link.rest_s
