"""The stated uncertainty of a sample: the number of its readings, and a covariance where that is not enough."""

import math
from typing import NamedTuple

import numpy as np

from beamtouch_models.filters import Filtered, FloatArray

PLAIN = (0.9, 1.02)
"""No covariance is stated while the variance is within these factors of that of a mean of the stated readings. The
variance of a low-pass lies between those of two such means."""
DIGITS_BELOW_NOISE = 1e-4
"""Entries are rounded to this part of the variance of the noise, so that rounding never makes the matrix indefinite."""
MAX_DIGITS = 300
"""Beyond it, entries are not rounded."""
SIGNIFICANT = 1e-12
"""Without noise, entries are rounded to this part of the largest one."""


class Uncertainty(NamedTuple):
    """The uncertainty of a sample."""

    readings: int | None
    """Number of readings in it; None if no channel has a value, or if the noise of a reading is not known."""
    covariance_mm2: list[float] | None
    """Lower triangle by rows; None if it is no more than the noise of a mean of `readings`."""


UNKNOWN = Uncertainty(None, None)


def uncertainties(filtered: Filtered) -> list[Uncertainty]:
    """Return the uncertainty of each sample."""
    samples = len(filtered.mean_mm)
    if filtered.noise_mm is None or not samples:
        return [UNKNOWN] * samples
    variance = filtered.relative_variance
    if (
        not filtered.uncertain.any() and variance.min() == variance.max()
    ):  # False for NaN; the usual case, in half the time
        readings = math.floor(1 / variance[0, 0] + 1e-6)
        if PLAIN[0] <= variance[0, 0] * readings <= PLAIN[1]:
            return [Uncertainty(readings, None)] * samples
    # The median that replaces a spike may be noisier than a reading. Then the covariance says so.
    number = np.maximum(np.floor(filtered.readings + 1e-6), 1.0)  # NaN stays NaN
    relative = variance * number[:, np.newaxis]
    differs = (relative < PLAIN[0]) | (relative > PLAIN[1])  # False for NaN
    results = [UNKNOWN if math.isnan(readings) else Uncertainty(int(readings), None) for readings in number.tolist()]
    stated = np.flatnonzero(filtered.uncertain | differs.any(axis=1))
    if len(stated):
        row, column = np.tril_indices(filtered.mean_mm.shape[1])
        triangles, least = filtered.covariances_mm2(stated)[:, row, column], float(filtered.noise_mm.min())
        for index, triangle in zip(stated.tolist(), triangles, strict=True):
            readings = results[index].readings
            if readings is not None:
                results[index] = Uncertainty(readings, _rounded(triangle, least**2 / readings))
    return results


def _rounded(triangle: FloatArray, white_mm2: float) -> list[float]:
    """Return a triangle with the fewest digits that keep the matrix positive; `white_mm2` is its noise variance."""
    quantum = max(DIGITS_BELOW_NOISE * white_mm2, SIGNIFICANT * float(triangle.max()))
    digits = -math.floor(math.log10(quantum)) if quantum > 0 else 0
    values: list[float] = (np.round(triangle, digits) if 0 < digits < MAX_DIGITS else triangle).tolist()
    return values
