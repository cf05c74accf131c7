"""Steps of a beam that lay still: readings that agree, a sharp change, and since then readings that agree again.

A beam that rings makes no such step: its readings do not agree before one and right after it. So the mean since the
step is right, although it is too early to prove that the beam is at rest.
"""

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import FloatArray
from beamtouch_models.filters.significance import chi_square_quantile

SHARP = 1e-6
"""Probability at rest of the difference that makes a step."""
AGREE = 0.001
"""Probability at rest that the readings before a step, or those after it, seem to differ."""


def are_steps(units: FloatArray, sizes: NDArray[np.intp], still: int) -> NDArray[np.bool_]:
    """Return whether the last `sizes` readings follow a step of a beam that lay still, shape (means,).

    Parameters
    ----------
    units
        Readings in units of their noise, shape (means, rows, channels); NaN if missing. A missing one makes no step.
    sizes
        Number of readings since the supposed step, shape (means,); a step shows from two readings on.
    still
        Number of readings before the step that must agree; none: no step is looked for.
    """
    found = np.zeros(len(units), dtype=np.bool_)
    channels = units.shape[2]
    for index in np.flatnonzero((sizes >= 2) & (sizes < still)).tolist():
        size = int(sizes[index])
        since, before = units[index, -size:], units[index, -size - still : -size]
        mean = since.sum(axis=0) / size
        jump = before[-1] - mean
        found[index] = (
            float(jump @ jump) > (1 + 1 / size) * chi_square_quantile(channels, SHARP)
            and float(((since - mean) ** 2).sum()) < chi_square_quantile(channels * (size - 1), AGREE)
            and float(((before - before.mean(axis=0)) ** 2).sum()) < chi_square_quantile(channels * (still - 1), AGREE)
        )
    return found
