"""The state of a surface after samples that are not known: what they may have left is decided side by side. Pure.

A state is shown once all hypotheses agree on it. So it does not depend on what the missing samples were, and is the
same when they arrive later. They may have left a beam that lay still, one that rings from a lift, or a contact of
which nothing is known. An unexplained stretch is left out: only three samples show that it is over, and to doubt every
contact and every rest for so long would cost more than it tells.
"""

from collections.abc import Iterable
from typing import NamedTuple

from beamtouch_models.decision.decider import AT_REST, PERSISTENCE, REST, Decider, Memory, State
from beamtouch_models.decision.evidence import Evidence
from beamtouch_models.metadata import Thresholds

_RINGING = Memory(State.CLEAR)
_COUNTS = range(PERSISTENCE)
_CLEAR = tuple(_RINGING._replace(still=still, changing=changing) for still in range(REST) for changing in _COUNTS)
_CONTACT = tuple(Memory(State.CONTACT, changing=changing) for changing in _COUNTS)
# Nothing speaks against the very first sample: if it is odd, it is unexplained at once.
_UNKNOWN = _RINGING._replace(run=PERSISTENCE - 1)


def memories_after(state: State | None) -> tuple[Memory, ...]:
    """Return the memories that missing samples may have left, likeliest first.

    `state` is the last known state, None if it is unknown.
    """
    if state is State.UNEXPLAINED:
        return (Memory(state),)
    if state is State.CONTACT:
        return _CONTACT
    return (*_CLEAR, AT_REST) if state else (_UNKNOWN, *_CLEAR, AT_REST, *_CONTACT)


class Judgement(NamedTuple):
    """The state after a sample, as far as it is known."""

    state: State
    unsteady: bool
    """Whether the readings move, or do not show the state by themselves; also if no state is known yet."""
    shown: bool
    """Whether all hypotheses agree on the state."""


class Hypotheses:
    """Decides on the samples of one sender, in order, from all that the samples before them may have left."""

    def __init__(self, thresholds: Thresholds, before: Iterable[Memory], *, is_known: bool = False) -> None:
        """Begin with these memories; the first one answers while they disagree."""
        self._thresholds = thresholds
        self._deciders = [Decider(thresholds, memory) for memory in before]
        self.is_known = is_known or self.agree
        """Whether a state was known at any time."""

    @property
    def state(self) -> State:
        """The state that is answered."""
        return self._deciders[0].state

    @property
    def agree(self) -> bool:
        """Whether all hypotheses have the same state."""
        state = self.state
        return len(self._deciders) == 1 or all(one.state is state for one in self._deciders)

    @property
    def memories(self) -> tuple[Memory, ...]:
        """The memories so far, without repeats; one if the samples before no longer matter."""
        return tuple(one.memory for one in self._deciders)

    def step(self, evidence: Evidence) -> Judgement:
        """Take the next sample."""
        said, *_ = [one.step(evidence) for one in self._deciders]
        if evidence.moves and any(one.is_of_unknown_contact for one in self._deciders):
            # Whether the sample shows such a contact is not known, so that it may be a lift.
            self._admit(_RINGING, *_CONTACT)
        if len(self._deciders) > 1:
            self._merge()
        shown = self.agree
        self.is_known |= shown
        is_doubted = not self.is_known and said.state is not State.UNEXPLAINED
        return Judgement(said.state, said.unsteady or is_doubted, shown)

    def _admit(self, *others: Memory) -> None:
        self._deciders += [Decider(self._thresholds, memory) for memory in others]

    def _merge(self) -> None:
        """Keep one hypothesis of each memory, in order."""
        kept: dict[Memory, Decider] = {}
        for one in self._deciders:
            kept.setdefault(one.memory, one)
        self._deciders = list(kept.values())
