"""Touches: sharp changes of a beam that lay still.

A beam that rings makes none: its readings do not agree before one. So the mean since a touch is right, although it is
too early to prove that the beam is at rest. The growing mean ends at a touch, however few readings followed it; and a
mean since a touch has the noise of a single reading at most, if the readings in it agree.
"""

import math

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import FloatArray
from beamtouch_models.filters.significance import chi_square_quantile
from beamtouch_models.filters.splits import Sums

SHARP = 1e-6
"""Probability at rest of a sharp change."""
CALM = 0.001
"""Probability at rest that readings before or after a change seem to differ."""
STILL_PART = 1 / 4
"""Part of the slowest period in which readings must agree to prove rest."""
CALM_PART = 1.0
"""Part of the slowest period before a touch in which readings must be calm. A whole one shows the amplitude of a swing.
About a turning point, those of a part may agree, and if a period has few readings, the next one differs sharply."""


def still_readings(slowest_period: float) -> int:
    """Return the number of readings that must agree to prove rest, for a slowest period in readings."""
    return math.ceil(STILL_PART * slowest_period)


def calm_readings(slowest_period: float) -> int:
    """Return the number of readings before a touch that must be calm, for a slowest period in readings."""
    return max(2, math.ceil(CALM_PART * slowest_period))


def calm_limit(readings: int, channels: int) -> float:
    """Return the limit of the squares of calm readings about their mean, in units of their noise."""
    return chi_square_quantile(channels * (readings - 1), CALM)


def is_sharp_touch(before: FloatArray, since: FloatArray, number: int, sharp: float, calm: float) -> NDArray[np.bool_]:
    """Return whether beams lay still and then changed sharply, shape (means,).

    Parameters
    ----------
    before
        Readings before the change, shape (means, still, channels).
    since
        Mean of the first readings after it, shape (means, channels).
    number
        How many readings that mean is of.
    sharp, calm
        Limits of the squares of a change, and of calm readings, in squared units of the readings.
    """
    jump, away = since - before[:, -1], before - before.mean(axis=1, keepdims=True)
    change: FloatArray = (jump * jump).sum(axis=1)
    unrest: FloatArray = (away * away).sum(axis=(1, 2))
    return (change > (1 + 1 / number) * sharp) & (unrest < calm)


def follow_touch(sums: Sums, sizes: NDArray[np.intp], still: int, sharp: float, calm: float) -> NDArray[np.bool_]:
    """Return whether the last `sizes` rows, two or more, follow a touch; the first of them shows it.

    `still` readings before it, none of them missing, must be calm. The limits are those of `is_sharp_touch`.
    """
    long_ago = (sizes >= 2) & (sums.starts >= sizes + still)
    ages = np.where(long_ago, sizes, 2)[:, np.newaxis] + np.arange(still, -2, -1)
    each = np.diff(sums.before(np.minimum(ages, sums.starts[:, np.newaxis])), axis=1)
    touch = is_sharp_touch(each[:, :-1, 0], each[:, -1, 0], 1, sharp, calm)
    found: NDArray[np.bool_] = long_ago & each[:, :, 1].all(axis=(1, 2)) & touch
    return found


def calm_since_touch(units: FloatArray, sizes: NDArray[np.intp], still: int, calm: int) -> NDArray[np.bool_]:
    """Return whether the last `sizes` readings follow a touch and are calm themselves, shape (means,).

    Parameters
    ----------
    units
        Readings in units of their noise, shape (means, rows, channels); NaN if missing. A missing one makes no touch.
    sizes
        Number of readings since the supposed touch, shape (means,); it shows from two readings on.
    still
        Number of readings from which on no touch is looked for: these prove rest by themselves.
    calm
        Number of readings before the touch that must be calm.
    """
    found = np.zeros(len(units), dtype=np.bool_)
    channels = units.shape[2]
    sharp = chi_square_quantile(channels, SHARP)
    for index in np.flatnonzero((sizes >= 2) & (sizes < still)).tolist():
        size = int(sizes[index])
        since, before = units[index : index + 1, -size:], units[index : index + 1, -size - calm : -size]
        mean = since.mean(axis=1)
        agree = ((since - mean[:, np.newaxis]) ** 2).sum() < calm_limit(size, channels)
        found[index] = agree and is_sharp_touch(before, mean, size, sharp, calm_limit(before.shape[1], channels))[0]
    return found
