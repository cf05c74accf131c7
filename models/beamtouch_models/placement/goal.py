"""The goal of a placement by position error: the least error among the layouts that notice enough."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.placement.noticing import OtherLoads
from beamtouch_models.placement.position_error import Surrogate

SLACK = 0.01
"""Share of other loads that a layout may notice less than that of the eigenvalue product: too little to be told from
chance in a hundred loads, and more than a layout that notices none of them could lose."""
STEPS = 16
"""Layouts that are tried on the way from one to another."""
FIRST_LOOK = 4
"""A layout is first compared on one contact in this many; most layouts are rejected there."""
TIE = 1e-6
"""Weight of the error with all sensors in an objective with a spare: it decides between equals only."""
GAIN = 1e-9
"""Smallest relative gain that exceeds rounding."""


@dataclass(frozen=True)
class Scored:
    """A layout with its score."""

    layout: Indices
    """(sensors,), ascending."""
    objective: float
    """The quantity that is minimised: an error in mm, or minus a share that is noticed."""
    distances_mm: Floats
    """(contacts,), errors of the sensors that decide: all of them, or with a spare those with the largest error."""


@dataclass(frozen=True)
class Goal:
    """The scores of layouts that notice enough."""

    surrogate: Surrogate
    spare: int
    """1: the objective is the largest error with one sensor failed."""
    others: OtherLoads
    least: Floats | None
    """(kinds,), least shares of other loads that a layout notices; None: it need not notice any."""
    measured: dict[tuple[bytes, int], Floats] = field(default_factory=dict, repr=False)
    """Errors that sets of sensors have at the first contacts, as far as they were asked for; many layouts share a set
    if there is a spare, and a search comes back to many layouts."""
    noticing: dict[bytes, bool] = field(default_factory=dict, repr=False)
    """Whether layouts notice enough, as far as it was asked for."""

    @property
    def candidates(self) -> int:
        """Number of places for a sensor."""
        return len(self.surrogate.rules.position_mm)

    def scores(self, layouts: Indices) -> Floats:
        """Return minus the objective in mm of layouts (population, sensors); -inf if not allowed.

        A layout is not allowed if it breaks a rule or notices too little.
        """
        allowed = self.surrogate.rules.allowed(layouts)
        pairs = zip(layouts, allowed, strict=True)
        return np.array(
            [-self.scored(one).objective if kept and self.notices_enough(one) else -np.inf for one, kept in pairs]
        )

    def scored(self, layout: Indices) -> Scored:
        """Score a layout (sensors,) whether or not it is allowed.

        Without a spare, the objective is the mean error with all sensors. With one, it is the largest, over each one
        sensor failed, of the mean error of the others; the error with all sensors decides between equals.
        """
        layout = np.sort(layout)
        worst = max((self._distances_mm(sensors) for sensors in self._working(layout)), key=_mean)
        tie = TIE * _mean(self._distances_mm(layout)) if self.spare else 0.0
        return Scored(layout, _mean(worst) + tie, worst)

    def better(self, layout: Indices, than: Scored) -> Scored | None:
        """Score a layout (sensors,) if it is allowed and its objective is less than that of another.

        Most layouts are left out by a few of their contacts, by what they notice, or by one failed sensor.
        """
        if not self.surrogate.rules.allowed(layout[None, :])[0]:
            return None
        layout = np.sort(layout)
        few = len(than.distances_mm) // FIRST_LOOK
        for sensors in self._working(layout):
            change = self._distances_mm(sensors, few) - than.distances_mm[:few]
            if change.mean() > change.std() / math.sqrt(few):
                return None
        if not self.notices_enough(layout):
            return None
        for sensors in self._working(layout):
            if _mean(self._distances_mm(sensors)) > than.objective:
                return None
        found = self.scored(layout)
        return found if found.objective < (1 - GAIN) * than.objective else None

    def _working(self, layout: Indices) -> Iterator[Indices]:
        """Yield the sets of sensors whose largest error is the objective."""
        if not self.spare:
            yield layout
        else:
            yield from (np.delete(layout, failed) for failed in range(len(layout)))

    def _distances_mm(self, sensors: Indices, contacts: int | None = None) -> Floats:
        """Return the errors of a set of sensors at the first contacts, by default at all: (contacts,)."""
        contacts = len(self.surrogate.weight) if contacts is None else contacts
        key = sensors.tobytes(), contacts
        if key not in self.measured:
            self.measured[key] = self.surrogate.distances_mm(sensors, contacts)
        return self.measured[key]

    def notices_enough(self, layout: Indices) -> bool:
        """Return whether a layout (sensors,), ascending, notices enough of each kind of other loads."""
        if self.least is None:
            return True
        key = layout.tobytes()
        if key not in self.noticing:
            self.noticing[key] = bool((self.others.noticed(layout) >= self.least).all())
        return self.noticing[key]

    def towards(self, near: Indices, far: Indices) -> Indices:
        """Return the layout farthest on the way from an allowed layout to another one that is still allowed."""
        position = self.surrogate.rules.position_mm
        for part in np.linspace(1, 0, STEPS, endpoint=False):
            layout = self.surrogate.rules.fitted(position[near] + part * (position[far] - position[near]))
            if layout is not None and self.notices_enough(layout):
                return layout
        return near


def _mean(distances_mm: Floats) -> float:
    return float(distances_mm.mean())
