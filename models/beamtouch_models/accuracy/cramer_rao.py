"""The Cramer-Rao bound on the position.

The standard deviation of an unbiased estimate is at least one over the root of the Fisher information. For a reading of
mean F g(x) with independent Gaussian errors s per channel, the information is |F g'(x) / s|^2 if the force is known.
If the force is open, only the part of g'/s orthogonal to g/s counts: a change along g may as well come from the force.
The errors are those of the noise, of gains and of zeros. Their size depends on the contact; the bound ignores that.
Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, sec. 3.7 and 3.8.
"""

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats

POSITIONS, FORCES = 1001, 32


def position_deviation_mm(prior: Prior, position_mm: ArrayLike, force_n: ArrayLike) -> Floats:
    """Return the bound on the standard deviation of position at contacts (contacts,), in mm; may be infinite.

    It holds for unbiased estimates. Where it exceeds the range, as at a support, an estimate that uses the range is
    better.
    """
    position, force = np.broadcast_arrays(np.asarray(position_mm, np.float64), np.asarray(force_n, np.float64))
    influence = prior.table(position)
    deviation = prior.deviation_in_table_mm(position, force[:, None])
    slope, shape = prior.table.derivative()(position) / deviation, influence / deviation
    if not prior.force_is_known:
        size = (shape**2).sum(axis=1, keepdims=True)
        along = (slope * shape).sum(axis=1, keepdims=True)
        slope = slope - shape * np.divide(along, size, out=np.zeros_like(size), where=size > 0)
    told = force * np.linalg.norm(slope, axis=1)
    with np.errstate(divide="ignore"):
        bound: Floats = 1 / told
    return bound


def mean_error_mm(prior: Prior) -> float:
    """Return the mean |error| over the ranges of a Gaussian error with the bound's deviation, at most that of a guess.

    It approaches the accuracy limit as the noise goes to zero. At high noise it is a rough value and not a bound.
    """
    return float(mean_errors_mm(prior).mean())


def mean_errors_mm(prior: Prior) -> Floats:
    """The same over the forces alone, in the middle of POSITIONS equal parts of the range of positions."""
    low, high = prior.position_mm
    # Integrate over both ranges with the midpoint rule.
    positions = low + (high - low) * (np.arange(POSITIONS) + 0.5) / POSITIONS
    weak, strong = prior.force_n
    forces = weak + (strong - weak) * (np.arange(FORCES) + 0.5) / FORCES if weak < strong else np.array([weak])
    every, each = np.repeat(positions, len(forces)), np.tile(forces, POSITIONS)
    gaussian = np.sqrt(2 / np.pi) * position_deviation_mm(prior, every, each).reshape(POSITIONS, -1)
    guess = ((positions - low) ** 2 + (high - positions) ** 2) / (2 * (high - low))
    errors: Floats = np.minimum(gaussian, guess[:, None]).mean(axis=1)
    return errors
