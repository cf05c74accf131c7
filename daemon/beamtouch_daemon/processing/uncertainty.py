"""Statement of a sample's uncertainty: the number of readings in it, and their covariance where it says more."""

import math
from typing import NamedTuple

import numpy as np

from beamtouch_models.filters import Filtered

PLAIN_WITHIN = 0.02
"""Largest relative difference between the variance and that of so many readings, for which no covariance is stated."""
DIGITS_BELOW_NOISE = 1e-4
"""Entries are rounded to this part of the variance of the noise, so that rounding never makes the matrix indefinite."""
SIGNIFICANT = 1e-12
"""Without noise, entries are rounded to this part of the largest one."""


class Uncertainty(NamedTuple):
    """The uncertainty of a sample."""

    readings: int | None
    """How many readings are in it; None if no channel has a value, or if the noise of a reading is not known."""
    covariance_mm2: list[float] | None
    """Lower triangle by rows; None if it is the variance of so many readings, on the diagonal."""


UNKNOWN = Uncertainty(None, None)


def uncertainties(filtered: Filtered) -> list[Uncertainty]:
    """Return the uncertainty of each sample."""
    if filtered.noise_mm is None:
        return [UNKNOWN] * len(filtered.mean_mm)
    number = np.floor(filtered.readings + 1e-6)
    differs = np.abs(filtered.relative_variance * number[:, np.newaxis] - 1) > PLAIN_WITHIN  # False for NaN
    stated = filtered.moves | differs.any(axis=1)
    found = [UNKNOWN if math.isnan(readings) else Uncertainty(int(readings), None) for readings in number.tolist()]
    if stated.any():
        matrices, (row, column) = filtered.covariance_mm2, np.tril_indices(filtered.mean_mm.shape[1])
        for index in np.flatnonzero(stated).tolist():
            readings = found[index].readings
            if readings is not None:
                found[index] = Uncertainty(readings, _rounded(matrices[index][row, column], filtered.noise_mm, readings))
    return found


def _rounded(triangle: np.ndarray, noise_mm: np.ndarray, readings: int) -> list[float]:
    white = float(noise_mm.min()) ** 2 / readings
    quantum = max(DIGITS_BELOW_NOISE * white, SIGNIFICANT * float(triangle.max()))
    return np.round(triangle, max(0, -math.floor(math.log10(quantum)))).tolist() if quantum > 0 else triangle.tolist()
