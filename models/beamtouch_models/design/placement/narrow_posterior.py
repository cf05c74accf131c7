"""The mean distance of posteriors on two axes that are narrower than cells resolve: those of Gaussians.

Cells of two axes are coarse, as they are few along each. Where the place is known better than a cell is wide, the
readings are as good as linear about the contact, and the posterior is a Gaussian whose covariance is the Cramer-Rao
bound.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ellipe

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.runtime.force_range import ForceRange

STEP = 2e-3
"""Step of the differences of influence, over the size of the structure."""


@dataclass(frozen=True)
class NarrowPosteriors:
    """What contacts tell of their own place, if nothing else resembles them."""

    change: Floats
    """(contacts, candidates, 2), change of the readings along each axis."""
    shape: Floats
    """(contacts, candidates), deflection per newton, in mm/N."""
    force_precision: float
    """What the stated range tells of the force, in 1/N^2; infinite if the force is exact."""

    @classmethod
    def of(
        cls, influence: InfluenceFunction, candidate_mm: Floats, place_mm: Floats, force_n: Floats
    ) -> "NarrowPosteriors":
        """Return those of contacts at places (contacts, 2)."""
        size_mm = influence.size_mm
        change = np.empty((len(place_mm), len(candidate_mm), 2))
        for axis in range(2):
            step = np.where(np.arange(2) == axis, STEP * size_mm, 0.0)
            low, high = (np.clip(place_mm + side * step, 0.0, size_mm) for side in (-1, 1))
            difference = influence.at(candidate_mm, high) - influence.at(candidate_mm, low)
            change[..., axis] = difference * (force_n / (high - low)[:, axis])[:, None]
        low_n, high_n = influence.force_n
        told = np.inf if low_n == high_n else ForceRange(low_n, high_n).precision_per_n2
        return cls(change, influence.at(candidate_mm, place_mm), told)

    def distances_mm(self, part: slice, layout: Indices, precision: Floats) -> Floats:
        """Return the mean distances from the medians (contacts,) of a part of the contacts; may be infinite.

        `precision` (contacts, sensors) is 1 over the variance of the readings of the sensors `layout`.
        """
        change, shape = self.change[part, layout], self.shape[part, layout]
        information = np.einsum("nca,nc,ncb->nab", change, precision, change)
        both = np.einsum("nca,nc,nc->na", change, precision, shape)
        force = np.einsum("nc,nc,nc->n", shape, precision, shape) + self.force_precision
        # The Schur complement: the force is unknown.
        information -= both[:, :, None] * (both / force[:, None])[:, None]
        half, apart = (information[:, 0, 0] + information[:, 1, 1]) / 2, information[:, 0, 0] - information[:, 1, 1]
        spread = np.hypot(apart / 2, information[:, 0, 1])
        least, most = np.maximum(half - spread, 0.0), half + spread
        with np.errstate(divide="ignore"):
            wide = 1 / np.sqrt(least)
        flat = 1 - np.divide(least, most, out=np.zeros_like(least), where=most > 0)
        # The mean of |r| for deviations s and t < s: sqrt(2 / pi) s E(1 - t^2 / s^2).
        distances: Floats = np.sqrt(2 / np.pi) * wide * ellipe(flat)
        return distances
