"""The order of a unit's answers: those that it may still owe, and requests that prove that it owes none. Pure; no I/O.

Modbus RTU answers carry no number, but a unit answers in order. A probe is a request whose answer cannot be mistaken
for a value, because it has another function or another length. After the answer to a probe, every earlier request has
been answered or never will be. That holds only if no answer to an earlier probe of the same kind is owed: otherwise the
answer may belong to the earlier one. Values are requested only while no probe is owed, so two kinds of probe that a
unit answers are enough, however late it is.

At the beginning of a session the requests of earlier programs are unknown. Two different probes in succession are
needed then.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from beamtouch_daemon.sources.registers import MAX_REGISTERS, Block

READ_FUNCTIONS = (1, 2, 3, 4)
"""Functions that only read, so that a probe never changes a device. A refusal is an answer too."""
EXPLORE_S = 60.0
"""If nothing was proven for this long, the probes are tried again: the address may belong to another device."""
AT_A_START = 2
"""Probes needed if earlier requests are unknown."""
AFTER_A_FAILURE = 1
LONGER = 2
"""A probe may ask for this many more registers than the longest block."""


@dataclass(frozen=True, slots=True)
class Probe:
    """A request that proves the order of answers."""

    function: int
    block: Block
    by_length: bool
    """Whether values are read with the same function, so that only the length identifies the answer."""


@dataclass(slots=True)
class _Owed:
    first_s: float
    last_s: float


def probes_of(asked: Collection[tuple[int, Block]]) -> tuple[Probe, ...]:
    """Return probes for a unit that is asked for these (function, block) pairs; the most widely supported first."""
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
    """A unit on a bus, and the answers that it may owe."""

    def __init__(self, address: int) -> None:
        self.address = address
        self.asked: set[tuple[int, Block]] = set()
        """Function and block of all requests for values."""
        self.probes_needed = AT_A_START
        """Number of probes to be answered before the next value."""
        self.works: tuple[Probe, ...] = ()
        """Probes that the unit answers."""
        self.is_known = False
        """Whether `works` is complete or sufficient."""
        self.suspect_until_s = 0.0
        """Until this time a probe precedes every value, because copies of answers were seen."""
        self.asked_s = -EXPLORE_S
        """Time of the last request, on the monotonic clock."""
        self.explored_s = -EXPLORE_S
        self.proven_s = 0.0
        self.has_waited = False
        """True once its first pause without requests is over."""
        self._owed: dict[Probe, _Owed] = {}

    @property
    def is_unprovable(self) -> bool:
        """Whether the unit answers no probe, so that only a pause separates late answers from new ones."""
        return self.is_known and not self.works

    @property
    def unsure(self) -> tuple[Probe, ...]:
        """Probes that the unit may answer after all, if too few are known; a late answer can show it."""
        is_enough = not self.is_known or len(self.works) >= AT_A_START
        return () if is_enough else tuple(probe for probe in probes_of(self.asked) if probe not in self.works)

    def learn(self, probes: Iterable[Probe]) -> None:
        """Add probes that the unit answers."""
        self.works += tuple(probes)

    def will_be_asked(self, function: int, blocks: Collection[Block]) -> None:
        """Add requests for values. Probes are then learned again, as an old one may look like a new value."""
        more = {(function, block) for block in blocks} - self.asked
        if more:
            self.asked |= more
            self.works, self.is_known = (), False
            self.explored_s = -EXPLORE_S
            self.require_probes(AT_A_START)

    def require_probes(self, probes: int) -> None:
        """Require at least this many probes before the next value."""
        self.probes_needed = max(self.probes_needed, probes)

    def sent(self, probe: Probe | None, now_s: float) -> None:
        """Note a sent request: a probe, or None for values."""
        self.asked_s = now_s
        if probe is None:
            self.require_probes(AFTER_A_FAILURE)
        else:
            self._owed.setdefault(probe, _Owed(now_s, now_s)).last_s = now_s

    def owes(self, probe: Probe) -> bool:
        """Return whether an answer to an earlier probe of this kind may still come."""
        return probe in self._owed

    def answered(self, probe: Probe, *, fresh: bool) -> None:
        """Note the answer to a probe: all requests before it (not `fresh`: before the first of its kind) are done."""
        first_s = self._owed[probe].first_s
        later = {one: owed for one, owed in self._owed.items() if one == probe or owed.last_s >= first_s}
        self._owed = {} if fresh else later

    def is_in_step(self, now_s: float) -> None:
        """Note that the unit owes no answer."""
        self.probes_needed, self.proven_s = 0, now_s

    def forget(self, before_s: float) -> None:
        """Forget probes sent before a time; their answers are no longer expected."""
        self._owed = {one: owed for one, owed in self._owed.items() if owed.last_s >= before_s}

    def last_of(self, probes: Collection[Probe]) -> Probe:
        """Return the most recently sent of these probes, all of which are owed."""
        return max(probes, key=lambda probe: self._owed[probe].last_s)
