"""The order of a unit's answers: what it may still owe, and which requests prove that it owes no value. Pure; no I/O.

Modbus RTU answers carry no number, but a unit answers in order. A probe is a request whose answer no value can be
mistaken for: it has another function, or another length. Once the answer to a probe has come, all that was asked before
it has been answered or never will be. That holds only for a fresh probe, one of which no earlier answer may be owed:
of several like ones in a row, the answer to the first proves nothing of what came between it and the last. Values are
asked for only while no probe is owed, so two kinds of probe that a unit answers are enough, however late it is.

At the beginning of a session nobody knows what an earlier program has asked. Two different probes in succession are
then needed.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from beamtouch_daemon.sources.registers import MAX_REGISTERS, Block

READ_FUNCTIONS = (1, 2, 3, 4)
"""Functions that read; a unit without one refuses it, which is an answer as well. A probe never changes a device."""
EXPLORE_S = 60.0
"""After so long without a proof, what a unit answers is found out anew; another device may have its address."""
AT_A_START = 2
"""Probes needed where the past is unknown."""
AFTER_A_FAILURE = 1
LONGER = 2
"""A probe may ask for up to this many registers more than the longest reading."""


@dataclass(frozen=True, slots=True)
class Probe:
    """A request that proves the order of answers."""

    function: int
    block: Block
    by_length: bool
    """Whether values are read with the same function, so that only the length of the answer tells."""


@dataclass(slots=True)
class _Owed:
    first_s: float
    last_s: float


def probes_of(asked: Collection[tuple[int, Block]]) -> tuple[Probe, ...]:
    """Return probes for a unit that is asked for these blocks by function; those that most units answer come first."""
    function, longest = max(asked, key=lambda one: one[1].count)
    lengths = {block.count for asked_function, block in asked if asked_function == function}
    free = [count for count in range(1, min(longest.count + LONGER, MAX_REGISTERS) + 1) if count not in lengths]
    shorter = [Probe(function, Block(longest.first, count), True) for count in free if count < longest.count][:2]
    longer = [Probe(function, _within(longest.first, count), True) for count in free if count > longest.count]
    used = {asked_function for asked_function, _ in asked}
    others = [Probe(other, Block(longest.first, 1), False) for other in reversed(READ_FUNCTIONS) if other not in used]
    return (*shorter[:1], *others[:1], *shorter[1:], *longer, *others[1:])


def _within(first: int, count: int) -> Block:
    return Block(min(first, 0x10000 - count), count)


class Unit:
    """A unit on a bus, whoever reads it, and what it may owe."""

    def __init__(self, address: int) -> None:
        self.address = address
        self.asked: set[tuple[int, Block]] = set()
        """All that anyone asks it for: function and block."""
        self.missing = AT_A_START
        """Probes to be answered before a value is believed."""
        self.works: tuple[Probe, ...] = ()
        """Probes that it answers."""
        self.is_known = False
        """Whether `works` is all that it answers, or enough."""
        self.suspect_until_s = 0.0
        """A probe comes before every value until then, as copies of answers were seen."""
        self.asked_s = -EXPLORE_S
        """When it was asked for anything last, on the monotonic clock."""
        self.explored_s = -EXPLORE_S
        self.proven_s = 0.0
        self.has_waited = False
        """Whether its first silence is over."""
        self._owed: dict[Probe, _Owed] = {}

    @property
    def is_unprovable(self) -> bool:
        """Whether it answers no probe, so that only a silence separates a late answer from a new one."""
        return self.is_known and not self.works

    @property
    def unsure(self) -> tuple[Probe, ...]:
        """Probes that it may answer after all, if too few are known; a late answer to one shows that."""
        is_enough = not self.is_known or len(self.works) >= AT_A_START
        return () if is_enough else tuple(probe for probe in probes_of(self.asked) if probe not in self.works)

    def learn(self, probes: Iterable[Probe]) -> None:
        """Note that it answers further probes."""
        self.works += tuple(probes)

    def will_be_asked(self, function: int, blocks: Collection[Block]) -> None:
        """Note what a user reads; what it answers is learned anew, as a probe could now be taken for a value."""
        more = {(function, block) for block in blocks} - self.asked
        if more:
            self.asked |= more
            self.works, self.is_known = (), False
            self.explored_s = -EXPLORE_S
            self.doubt(AT_A_START)

    def doubt(self, probes: int) -> None:
        """Require so many probes before the next value."""
        self.missing = max(self.missing, probes)

    def sent(self, probe: Probe | None, now_s: float) -> None:
        """Note a request: a probe, or None for values."""
        self.asked_s = now_s
        if probe is None:
            self.doubt(AFTER_A_FAILURE)
        else:
            self._owed.setdefault(probe, _Owed(now_s, now_s)).last_s = now_s

    def owes(self, probe: Probe) -> bool:
        """Whether an answer to an earlier probe like this one may still come."""
        return probe in self._owed

    def answered(self, probe: Probe, *, fresh: bool) -> None:
        """Note the answer to a probe: what was asked before it is done, or before the first like it if not `fresh`."""
        first_s = self._owed[probe].first_s
        later = {one: owed for one, owed in self._owed.items() if one == probe or owed.last_s >= first_s}
        self._owed = {} if fresh else later

    def is_in_step(self, now_s: float) -> None:
        """Note that it owes nothing."""
        self.missing, self.proven_s = 0, now_s

    def forget(self, before_s: float) -> None:
        """Forget probes of before a time; their answers come no more."""
        self._owed = {one: owed for one, owed in self._owed.items() if owed.last_s >= before_s}

    def last_of(self, probes: Collection[Probe]) -> Probe:
        """Return the probe that was sent last of those, all of which are owed."""
        return max(probes, key=lambda probe: self._owed[probe].last_s)
