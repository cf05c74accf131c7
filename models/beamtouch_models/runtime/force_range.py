"""The stated range of forces as evidence: how much it says against a force beyond it.

A narrow range says much, that of an open force nothing, and all ranges lie on one path between these. How open a range
[l, h] is,

    o = min(1, (r / OPEN)^2),    r = (h - l) / (h + l),

weakens what it says about the force, to nothing where the largest force is twice the smallest. A force F that is beyond
the range costs a contact (F - nearest end)^2 / s^2 of misfit, where s^2 is the square of a third of half the range,
over 1 - o. Where only the size of what is known matters, the range counts as a reading of its middle, with the variance
of an even density over it, over 1 - o. Numpy only, and pure.
"""

import math
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats

OPEN = 1 / 3
"""Half the range over its middle from which on a force is open: the largest is then twice the smallest."""
EXACT = 1e-12
"""Half the range over its middle below which a force is exact: no sample tells the difference."""
DETECTED = 6.0
"""Deviations that a contact moves the sample by at least, to be one: the force of none is known less well."""


@dataclass(frozen=True)
class ForceRange:
    """The range of forces that a scene states; equal ends for an exact force."""

    low_n: float
    high_n: float

    @property
    def middle_n(self) -> float:
        """Force in the middle."""
        return (self.low_n + self.high_n) / 2

    @property
    def half_n(self) -> float:
        """Half the length of the range."""
        return (self.high_n - self.low_n) / 2

    @property
    def openness(self) -> float:
        """0 for an exact force, 1 for an open one."""
        return min(1.0, (self.half_n / (OPEN * self.middle_n)) ** 2)

    @property
    def is_open(self) -> bool:
        """True if the range says nothing against a force beyond it."""
        return self.openness == 1.0

    @property
    def precision_per_n2(self) -> float:
        """Precision of the range as a reading of its middle: 1 over the variance, 0 for an open force."""
        return 3 * self._sharpness_per_n2

    @property
    def relative_error(self) -> float:
        """Standard deviation of the force about the middle, over the middle; infinite for an open force."""
        precision = self.precision_per_n2
        return 1 / (precision**0.5 * self.middle_n) if precision else math.inf

    @property
    def penalty_per_n2(self) -> float:
        """Misfit of a force beyond the range, per square of the distance to the nearest end; 0 for an open force."""
        return 9 * self._sharpness_per_n2

    @property
    def _sharpness_per_n2(self) -> float:
        return (1 - self.openness) / max(self.half_n, EXACT * self.middle_n) ** 2

    @property
    def checked(self) -> float:
        """Directions of the errors that a contact leaves because its force is in the range: 1 if exact, 0 if open.

        A free force fits one direction, and the penalty leaves the share 1 / (1 + a s^2) of its square there, where a
        is the precision of the force in the sample. That is least for a contact that is barely detected, which has
        a = (DETECTED / middle)^2.
        """
        penalty = self.penalty_per_n2 * self.middle_n**2
        return penalty / (penalty + DETECTED**2)

    def likeliest(self, force_n: Floats, precision_per_n2: Floats) -> Floats:
        """Return the forces with the least misfit, from those that samples show by themselves, with this precision."""
        if self.is_open:
            return force_n
        share = precision_per_n2 / (precision_per_n2 + self.penalty_per_n2)
        force: Floats = np.clip(force_n, self.low_n, self.high_n) + share * self.beyond(force_n)
        return force

    def beyond(self, force_n: Floats) -> Floats:
        """Return how far forces are above the range, or below it (negative)."""
        beyond: Floats = force_n - np.clip(force_n, self.low_n, self.high_n)
        return beyond

    def misfit(self, force_n: Floats) -> Floats:
        """Return what forces beyond the range add to the misfit of a contact."""
        misfit: Floats = self.penalty_per_n2 * self.beyond(force_n) ** 2
        return misfit


ANY_FORCE = ForceRange(0.0, 1.0)
"""The range of which nothing follows."""
