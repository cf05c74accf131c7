"""The state of a surface from the evidence of consecutive samples. Pure.

A large covariance explains everything, rest and contact alike. So a state ends only on a sample precise enough to have
shown it: with its covariance, the last clear deflection of that state would contradict rest about as well as
these channels can show it. A sample that does not move is as precise as it can be.

Where samples are not known, all that they may have left is decided side by side, and a state is shown once all
hypotheses agree on it. So it does not depend on what the missing samples were, and is the same when they arrive later.
They may have left a beam that lay still, one that rings from a lift, or a contact of which nothing is known. An
unexplained stretch is left out: only three samples show that it is over, and to doubt every contact and every rest for
so long would cost more than it tells.
"""

from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from beamtouch_models.runtime.decision.evidence import Evidence, is_odd
from beamtouch_models.runtime.metadata_parts import Thresholds

LIFT_FRACTION = 1 / 8
"""The log odds at which a contact ends, over those at which it begins.

Log odds grow as the square of deflection over noise, so a contact ends at about a third (the root of 1/8) of the
deflection that began it. A load that stands exactly at the threshold of touch falls below that in less than 0.1 % of
its samples, and a beam at rest is below it in most of them.
"""
PERSISTENCE = 3
"""Samples in a row that a contradiction, or its end, must last; likewise a lift that only a large covariance allows
or that means of few readings show, and a weak touch of a beam that has not come to rest."""
CLEARLY = 4
"""Log odds of a touch that is not weak, over those of any touch: twice the deflection."""
REST = 5
"""Still samples in a row that show rest. A single one may be taken at the turning point of a swing."""


class State(StrEnum):
    """State of a surface: touched, clear, or explained by neither."""

    CONTACT = "contact"
    CLEAR = "clear"
    UNEXPLAINED = "unexplained"
    """Neither rest nor a single contact explains the sample."""


class Memory(NamedTuple):
    """The memory of the samples so far. Equal memories decide alike on everything that follows."""

    state: State
    armed: bool = False
    """True if a clear beam lay still since the last contact. Then nothing but a touch moves it."""
    still: int = 0
    """Still samples in a row since the last contact, of a clear beam that is not armed."""
    changing: int = 0
    """Samples in a row that could be a lift, or a touch of a beam that has not come to rest."""
    run: int = 0
    """Odd samples in a row; in the state `unexplained`, precise samples since the last odd one."""
    seen_mm: tuple[float | None, ...] | None = None
    """The last deflection (channels,) that the state stands on, None for a channel that took no part; None for a clear
    beam, or if it is not known."""


AT_REST = Memory(State.CLEAR, armed=True)


def decide(thresholds: Thresholds, before: Memory, evidence: Evidence) -> tuple[Memory, bool]:
    """Decide on the next sample of a sender, from the memory of those before.

    Returns
    -------
    What is known after it, and whether the beam moves or this sample alone does not settle the state.
    """
    touch, odd = thresholds.touch[evidence.channels - 1], is_odd(thresholds, evidence)
    after = _decide(before, evidence, touch, odd=odd)
    # An ongoing unexplained stretch is not itself marked unsteady.
    contradicts = odd or (evidence.log_odds > touch) != (after.state is State.CONTACT)
    return after, evidence.moves or (contradicts and after.state is not State.UNEXPLAINED)


def _decide(before: Memory, evidence: Evidence, touch: float, *, odd: bool) -> Memory:
    """Return what is known after a sample whose log odds are compared with `touch`."""
    if before.state is State.UNEXPLAINED:
        if odd:
            return _standing_on(State.UNEXPLAINED, evidence)
        run = before.run + _shows(before, evidence, touch)
        if run < PERSISTENCE:
            return before._replace(run=run)
        return _standing_on(State.CONTACT, evidence) if evidence.log_odds > touch else _cleared(evidence)
    if odd:
        run = before.run + 1
        return _standing_on(State.UNEXPLAINED, evidence) if run >= PERSISTENCE else before._replace(run=run)
    if before.state is State.CLEAR:
        return _touch(before, evidence, touch)
    return _lift(before._replace(run=0), evidence, touch)


def _touch(before: Memory, evidence: Evidence, touch: float) -> Memory:
    """Let a contact begin; while a clear beam rings from a lift, one sample shows only a strong touch."""
    changing = before.changing + 1 if evidence.log_odds > touch else 0
    if before.armed:
        is_touched = max(evidence.log_odds, evidence.still_log_odds) > touch
    else:
        is_touched = evidence.log_odds > CLEARLY * touch or changing >= PERSISTENCE
    return _standing_on(State.CONTACT, evidence) if is_touched else _rest(before, evidence, changing)


def _lift(before: Memory, evidence: Evidence, touch: float) -> Memory:
    """Let a contact end."""
    if evidence.log_odds > touch:
        return _standing_on(State.CONTACT, evidence)
    if evidence.log_odds > LIFT_FRACTION * touch or not _shows(before, evidence, touch):
        return before._replace(changing=0)
    is_plain = evidence.still_log_odds <= touch and evidence.is_settled
    if is_plain or before.changing + 1 >= PERSISTENCE:
        return _cleared(evidence)
    return before._replace(changing=before.changing + 1)


def _standing_on(state: State, evidence: Evidence) -> Memory:
    return Memory(state, seen_mm=evidence.seen_mm)


def _cleared(evidence: Evidence) -> Memory:
    # A beam that still rings from the lift is not touched by that.
    return _rest(Memory(State.CLEAR), evidence, 0)


def _rest(before: Memory, evidence: Evidence, changing: int) -> Memory:
    """Follow a clear beam that comes to rest."""
    still = 0 if evidence.moves else before.still + 1
    return AT_REST if before.armed or still >= REST else Memory(State.CLEAR, still=still, changing=changing)


def _shows(before: Memory, evidence: Evidence, touch: float) -> bool:
    """Return whether the sample is precise enough to show what the state stands on."""
    if not evidence.moves:
        return True
    if before.seen_mm is None:
        return False
    seen_mm = np.array(before.seen_mm, float)  # NaN for None
    return evidence.shows(seen_mm) >= min(evidence.could_show(seen_mm) / 2, 2 * touch)


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


def state_of(thresholds: Thresholds, evidence: Evidence) -> State:
    """Return the state that a settled sample shows by itself, whatever was before."""
    if is_odd(thresholds, evidence):
        return State.UNEXPLAINED
    return State.CONTACT if evidence.log_odds > thresholds.touch[evidence.channels - 1] else State.CLEAR


class Judgement(NamedTuple):
    """The state after a sample, as far as it is known."""

    state: State
    unsteady: bool
    """True if the beam moves, if this sample alone does not settle the state, and while no state is known yet."""
    shown: bool
    """True if all hypotheses agree on the state."""


class Hypotheses:
    """Decides on the samples of one sender, in order, from all that the samples before them may have left."""

    def __init__(self, thresholds: Thresholds, before: Iterable[Memory], *, is_known: bool = False) -> None:
        """Begin with these memories; the first one answers while they disagree."""
        self._thresholds = thresholds
        self.memories = tuple(before)
        """The memories so far, without repeats; one if the samples before no longer matter."""
        self.is_known = is_known or self.agree
        """True if a state was known at any time."""

    @property
    def state(self) -> State:
        """The state that is answered."""
        return self.memories[0].state

    @property
    def agree(self) -> bool:
        """True if all hypotheses have the same state."""
        return all(memory.state is self.state for memory in self.memories)

    def step(self, evidence: Evidence) -> Judgement:
        """Take the next sample."""
        decided = [decide(self._thresholds, memory, evidence) for memory in self.memories]
        memories = [memory for memory, _ in decided]
        if evidence.moves and any(memory.state is State.CONTACT and memory.seen_mm is None for memory in memories):
            # Whether the sample shows such a contact is not known, so that it may be a lift.
            memories += [_RINGING, *_CONTACT]
        self.memories = tuple(dict.fromkeys(memories))
        shown = self.agree
        self.is_known |= shown
        is_doubted = not self.is_known and self.state is not State.UNEXPLAINED
        _, is_unsteady = decided[0]
        return Judgement(self.state, is_unsteady or is_doubted, shown)
