"""Levels of significance, and the quantiles of the chi-square distribution that they stand for."""

import math
from functools import lru_cache
from statistics import NormalDist

FALSE = 0.001
"""Probability that a test finds something at rest."""
LAGS = 0.1
"""Probability at rest that a number of newest readings seem to be apart from the mean. It only widens intervals."""
SHARP = 1e-6
"""Probability at rest of a sharp change between two readings: each of them could be one."""


@lru_cache(maxsize=1024)
def chi_square_quantile(freedom: int, beyond: float) -> float:
    """Return the value that a chi-square variable exceeds with probability `beyond`; inf without degrees of freedom.

    Wilson and Hilferty's approximation (1931). It is within 3 % for two degrees of freedom and more.
    """
    if freedom < 1:
        return math.inf
    spread = 2 / (9 * freedom)
    deviations = -NormalDist().inv_cdf(beyond)
    return freedom * (1 - spread + deviations * math.sqrt(spread)) ** 3
