"""Finds out whether a Modbus unit answers, and which of its registers can be read. Only reads."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Literal

from beamtouch_daemon.sources.registers import MAX_REGISTERS, Block
from beamtouch_daemon.sources.rtu_frame import Answer

Function = Literal[3, 4]
Ask = Callable[[Function, Block], Awaitable[Answer | None]]
"""Asks a unit with a function for registers; None if it does not answer."""
Parity = Literal["none", "even", "odd"]

FUNCTIONS: tuple[Function, ...] = (4, 3)
"""Input registers and holding registers. They only read, so no scan changes a device."""
ABSENT = (4, 10, 11)
"""Exceptions for a unit that is not there: of gateways (10, 11), and of servers with a fixed set of units (4)."""
MAX_REQUESTS = 34
"""Limit of the requests to one unit that answers: two to find it, then eight for each function, each perhaps twice."""


@dataclass(frozen=True, slots=True)
class FoundUnit:
    """A unit that answers."""

    unit: int
    registers: dict[Function, int]
    """By function: how many registers from 0 it gives in one answer; 0: none."""
    baud: int | None = None
    """Line settings; None over TCP."""
    parity: Parity | None = None

    @property
    def function(self) -> Function:
        """The function for the source: input registers hold what a unit measures, holding registers its settings too.

        Many units have their values in holding registers only.
        """
        return 3 if self.registers[3] and not self.registers[4] else 4


@dataclass(frozen=True, slots=True)
class Asked:
    """A unit that was asked."""

    unit: int
    found: FoundUnit | None
    heard: int = 0
    """Received bytes that were no answer in time."""
    late: frozenset[int] = frozenset()
    """Units whose answers came, but too late."""


async def registers_of(ask: Ask) -> dict[Function, int] | None:
    """Return how many registers from 0 each function reads from a unit; None if there is no such unit."""
    for function in FUNCTIONS:
        answer = await ask(function, Block(0, 1))
        if answer is not None and answer.exception not in ABSENT:
            return {each: await _count(ask, each) for each in FUNCTIONS}
    return None


async def _count(ask: Ask, function: Function) -> int:
    """Return how many registers from 0 a unit gives in one answer.

    Pairs are tried first, because some units refuse half of a value of 32 bits.
    """

    async def gives(count: int) -> bool:
        # An answer may be lost once. Some units refuse by silence.
        answer = await ask(function, Block(0, count)) or await ask(function, Block(0, count))
        return answer is not None and not answer.exception

    if not await gives(2):
        return 1 if await gives(1) else 0
    low, high = 1, MAX_REGISTERS // 2
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if await gives(2 * middle) else (low, middle - 1)
    return 2 * low + 1 if await gives(2 * low + 1) else 2 * low
