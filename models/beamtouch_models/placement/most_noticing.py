"""Of layouts whose error is hardly larger than the least, the one that notices the most loads other than one contact.

Layouts with nearly the same error notice very different shares: on the bench scene with a spare, the layout with the
least error notices 3 % of two contacts half of the range apart, and one with 1 % more error notices 48 %.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from beamtouch_models.arrays import Indices
from beamtouch_models.placement.goal import Goal, Scored

PRICE = 0.01
"""Share of the error that noticing may cost: about as much as the accuracy limit of a layout scatters between seeds."""
GAIN = 1e-4
"""Smallest gain of a share that is worth another layout."""


@dataclass(frozen=True)
class MostNoticing:
    """The shares of other loads that layouts notice, with at most a certain error."""

    goal: Goal
    most_mm: float

    @classmethod
    def near(cls, goal: Goal, layout: Indices) -> Self:
        """Allow `PRICE` more than the error of a layout (sensors,)."""
        return cls(goal, (1 + PRICE) * goal.scored(layout).objective)

    @property
    def candidates(self) -> int:
        """Number of places for a sensor."""
        return self.goal.candidates

    def scored(self, layout: Indices) -> Scored:
        """Score a layout (sensors,): the objective is minus the share that it notices, the mean of both kinds."""
        return replace(self.goal.scored(layout), objective=self._objective(np.sort(layout)))

    def better(self, layout: Indices, than: Scored) -> Scored | None:
        """Score a layout (sensors,) if it is allowed, notices more than another, and its error is small enough."""
        if not self.goal.surrogate.rules.allowed(layout[None, :])[0]:
            return None
        objective = self._objective(np.sort(layout))
        if objective > than.objective - GAIN:
            return None
        found = self.goal.scored(layout)
        return replace(found, objective=objective) if found.objective <= self.most_mm else None

    def _objective(self, layout: Indices) -> float:
        return -float(self.goal.others.noticed(layout).mean())
