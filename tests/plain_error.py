"""The mean position error by its definition, over plain draws."""

import numpy as np

from beamtouch_models.accuracy.limit import Draws, MeanError
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats


def mean_error(prior: Prior, drawn: Draws, estimate_mm: Floats) -> MeanError:
    """Eq. 5 of the paper, over all draws."""
    percent = np.abs(estimate_mm - drawn.position_mm) / prior.length_mm * 100
    return MeanError(float(percent.mean()), float(percent.std(ddof=1) / np.sqrt(len(percent))))
