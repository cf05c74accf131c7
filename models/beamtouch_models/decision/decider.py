"""The state of a surface from the evidence of consecutive samples. Pure.

A large covariance explains everything, rest and contact alike. So a state ends only on a sample that could show what
the state stands on: with its covariance, the last clear deflection of that state would contradict rest about as well as
these channels can show it. A sample that does not move is as precise as it can be.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.decision.evidence import Evidence, is_odd
from beamtouch_models.metadata import Thresholds

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
    """Whether something touches the surface."""

    CONTACT = "contact"
    CLEAR = "clear"
    UNEXPLAINED = "unexplained"
    """Neither rest nor a single contact explains the sample."""


class Memory(NamedTuple):
    """What a decider knows of the samples so far. Equal memories decide alike on everything that follows."""

    state: State
    armed: bool = False
    """Whether a clear beam lay still since the last contact. Then nothing but a touch moves it."""
    still: int = 0
    """Still samples in a row since the last contact, of a clear beam that is not armed."""
    changing: int = 0
    """Samples in a row that could be a lift, or a touch of a beam that has not come to rest."""
    run: int = 0
    """Odd samples in a row; in the state `unexplained`, precise samples since the last odd one."""
    seen_mm: tuple[float, ...] | None = None
    """The last deflection (channels,) that the state stands on; None for a clear beam, or if it is not known."""


AT_REST = Memory(State.CLEAR, armed=True)


class Verdict(NamedTuple):
    """The state after a sample."""

    state: State
    unsteady: bool
    """Whether the readings move, or do not show the state by themselves."""


class Decider:
    """Decides on the samples of one sender, in order, with the memory of those before them."""

    def __init__(self, thresholds: Thresholds, memory: Memory = AT_REST) -> None:
        self._thresholds = thresholds
        self.state, self._armed, self._still, self._changing, self._run, seen_mm = memory
        self._seen_mm: Floats | None = None if seen_mm is None else np.array(seen_mm)

    @property
    def memory(self) -> Memory:
        """What it knows of the samples so far, without what no longer matters."""
        if self.state is State.CLEAR:
            if self._armed:
                return AT_REST if not self._run else AT_REST._replace(run=self._run)
            return Memory(self.state, still=self._still, changing=self._changing, run=self._run)
        seen_mm = None if self._seen_mm is None else tuple(self._seen_mm.tolist())
        return Memory(self.state, changing=self._changing, run=self._run, seen_mm=seen_mm)

    @property
    def is_of_unknown_contact(self) -> bool:
        """Whether there is a contact, and nothing is known of its deflection."""
        return self.state is State.CONTACT and self._seen_mm is None

    def step(self, evidence: Evidence) -> Verdict:
        """Take the next sample."""
        odd = is_odd(self._thresholds, evidence)
        if self.state is State.UNEXPLAINED:
            if odd:
                self._stand_on(evidence)
            self._run = 0 if odd else self._run + self._shows(evidence)
            if self._run >= PERSISTENCE:
                self._settle(evidence)
        elif odd:
            self._run += 1
            if self._run >= PERSISTENCE:
                self.state, self._run, self._changing = State.UNEXPLAINED, 0, 0
                self._stand_on(evidence)
        else:
            self._run = 0
            self._follow(evidence)
        return Verdict(self.state, evidence.moves or self._contradicts(evidence, odd=odd))

    def _contradicts(self, evidence: Evidence, *, odd: bool) -> bool:
        """Return whether the sample alone would give another state; a stretch is no doubt about itself."""
        if self.state is State.UNEXPLAINED:
            return False
        return odd or (evidence.log_odds > self._touch(evidence)) != (self.state is State.CONTACT)

    def _follow(self, evidence: Evidence) -> None:
        """Let a contact begin or end."""
        touch = self._touch(evidence)
        if self.state is State.CLEAR:
            self._changing = self._changing + 1 if evidence.log_odds > touch else 0
            if self._touches(evidence, touch):
                self.state, self._changing = State.CONTACT, 0
                self._stand_on(evidence)
            self._rest(evidence)
        elif evidence.log_odds > touch:
            self._changing = 0
            self._stand_on(evidence)
        elif evidence.log_odds > LIFT_FRACTION * touch or not self._shows(evidence):
            self._changing = 0
        else:
            self._changing += 1
            at_once = evidence.still_log_odds <= touch and evidence.is_settled
            if at_once or self._changing >= PERSISTENCE:
                self._clear(evidence)

    def _touches(self, evidence: Evidence, touch: float) -> bool:
        """Return whether a clear beam is touched; while it rings from a lift, one sample shows only a strong touch."""
        if self._armed:
            return max(evidence.log_odds, evidence.still_log_odds) > touch
        return evidence.log_odds > CLEARLY * touch or self._changing >= PERSISTENCE

    def _settle(self, evidence: Evidence) -> None:
        """Leave the state `unexplained`."""
        self._run = 0
        if evidence.log_odds > self._touch(evidence):
            self.state = State.CONTACT
            self._stand_on(evidence)
        else:
            self._clear(evidence)

    def _clear(self, evidence: Evidence) -> None:
        # A beam that still rings from the lift is not touched by that.
        self.state, self._armed = State.CLEAR, False
        self._still = self._changing = 0
        self._rest(evidence)

    def _rest(self, evidence: Evidence) -> None:
        """Follow a beam that comes to rest."""
        self._still = 0 if evidence.moves else self._still + 1
        self._armed |= self._still >= REST

    def _stand_on(self, evidence: Evidence) -> None:
        self._seen_mm = evidence.deflection_mm

    def _shows(self, evidence: Evidence) -> bool:
        """Return whether the sample is precise enough to show what the state stands on."""
        if not evidence.moves:
            return True
        if self._seen_mm is None:
            return False
        enough = min(evidence.could_show(self._seen_mm) / 2, 2 * self._touch(evidence))
        return evidence.shows(self._seen_mm) >= enough

    def _touch(self, evidence: Evidence) -> float:
        return self._thresholds.touch[evidence.channels - 1]
