"""The goal of a placement by position error: the least error among the layouts that notice enough."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.placement.noticing import OtherLoads
from beamtouch_models.placement.position_error import Surrogate

SLACK = 0.01
"""Share of other loads that a layout may notice less than that of the eigenvalue product: too little to be told from
chance in a hundred loads, and more than a layout that notices none of them could lose."""
STEPS = 16
"""Layouts that are tried on the way from one to another."""


@dataclass(frozen=True)
class Goal:
    """The scores of layouts that notice enough."""

    surrogate: Surrogate
    others: OtherLoads
    least: Floats
    """(kinds,), least shares of other loads that a layout notices."""

    def scores(self, layouts: Indices) -> Floats:
        """Return minus the objective in mm of layouts (population, sensors); -inf if not allowed.

        A layout is not allowed if it breaks a rule or notices too little.
        """
        found = np.full(len(layouts), -np.inf)
        kept = np.flatnonzero(self.surrogate.rules.allowed(layouts))
        kept = kept[[self.notices_enough(layout) for layout in layouts[kept]]]
        found[kept] = self.surrogate.scores(layouts[kept])
        return found

    def notices_enough(self, layout: Indices) -> bool:
        """Return whether a layout (sensors,) notices enough of each kind of other loads."""
        return bool((self.others.noticed(layout) >= self.least).all())

    def towards(self, near: Indices, far: Indices) -> Indices:
        """Return the layout farthest on the way from an allowed layout to another one that is still allowed."""
        position = self.surrogate.rules.position_mm
        for part in np.linspace(1, 0, STEPS, endpoint=False):
            layout = self.surrogate.rules.fitted(position[near] + part * (position[far] - position[near]))
            if layout is not None and self.notices_enough(layout):
                return layout
        return near
