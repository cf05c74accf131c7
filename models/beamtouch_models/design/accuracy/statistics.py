"""Means, ratios and quantiles with their standard errors. Pure.

Values are (draws, ...), in SCRAMBLINGS consecutive parts of (almost) equal length, as `limit.draw_evenly` returns them.
Values within a part may be correlated, as evenly spread draws are; standard errors come from the scatter of the parts.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Bools, Floats

SCRAMBLINGS = 16
"""Number of independent parts of evenly spread draws."""


@dataclass(frozen=True, repr=False)
class Measurement:
    """A measured value and its standard error.

    >>> print(Measurement(2.8123, 0.0345).scaled(0.1))
    0.281 +- 0.003
    """

    value: float
    standard_error: float

    def __str__(self) -> str:
        """Return the value with three digits, and its error with one."""
        return f"{digits(self.value, 3)} +- {digits(self.standard_error, 1)}"

    __repr__ = __str__

    def scaled(self, factor: float) -> "Measurement":
        """Return the measurement in another unit."""
        return Measurement(self.value * factor, self.standard_error * factor)


def ratio_of(above: Floats, below: Floats) -> Measurement:
    """Return the ratio of two means over the same draws; their common scatter cancels in its standard error."""
    parts = [np.array([part.mean() for part in np.array_split(values, SCRAMBLINGS)]) for values in (above, below)]
    ratio, mean = above.mean() / below.mean(), below.mean()
    scatter = (parts[0] - ratio * parts[1]).std(ddof=1) / SCRAMBLINGS**0.5
    return Measurement(float(ratio), float(scatter / abs(mean)))


def mean_of(values: Floats, weight: Floats | None = None) -> Measurement:
    """Return the mean of values (draws, ...), weighted by an array of the same shape."""
    weight = np.ones(values.shape) if weight is None else weight
    return ratio_of(values * weight, weight)


def share_of(happened: Bools, weight: Floats | None = None) -> Measurement:
    """Return the share of cases; its standard error is not zero even if none or all of them happened."""
    share = mean_of(happened.astype(np.float64), weight)
    return Measurement(share.value, 1 / len(happened)) if share.value in (0.0, 1.0) else share


def quantile_of(values: Floats, level: float, weight: Floats | None = None) -> Measurement:
    """Return a quantile of values (draws, ...), weighted by an array of the same shape."""
    weight = np.ones(values.shape) if weight is None else weight
    pairs = zip(np.array_split(values, SCRAMBLINGS), np.array_split(weight, SCRAMBLINGS), strict=True)
    parts = [_quantile(*pair, level) for pair in pairs]
    return Measurement(_quantile(values, weight, level), float(np.std(parts, ddof=1) / SCRAMBLINGS**0.5))


def _quantile(values: Floats, weight: Floats, level: float) -> float:
    return float(np.quantile(values, level, weights=weight, method="inverted_cdf"))
