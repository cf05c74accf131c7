"""Normal equations of a step of the departures, with their prior and bounds."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.optimize import lsq_linear

from beamtouch_models.arrays import Floats

MAX_STEP = 2.0
"""Bound of a step of a departure, in units of plausible ones: far off, the slopes are those of another surface."""


@dataclass(frozen=True)
class Normal:
    """Normal equations of the departures."""

    precision: Floats
    pull: Floats

    @classmethod
    def of(cls, slopes: Floats, left: Floats) -> Self:
        """Equations of whitened slopes (contacts, channels, departures) and residuals (contacts, channels)."""
        return cls(np.einsum("lcv,lcw->vw", slopes, slopes), np.einsum("lcv,lc->v", slopes, left))

    def with_prior(self, moved: Floats, deviation: Floats) -> Self:
        """Add the prior of departures that are now `moved` away from its middle."""
        return replace(self, precision=self.precision + np.diag(deviation**-2), pull=self.pull - moved / deviation**2)

    def step(self, low: Floats, high: Floats) -> Floats:
        """Return the best step between bounds."""
        root = np.linalg.cholesky(self.precision)
        bounds = np.clip(low, -MAX_STEP, -1e-9), np.clip(high, 1e-9, MAX_STEP)
        found: Floats = lsq_linear(root.T, np.linalg.solve(root, self.pull), bounds, method="bvls").x
        return found
