"""The probability that a contact is a single one, from the residual that the best place and force leave."""

import numpy as np

from beamtouch_models.arrays import Floats

MISFITS = (4.0, 16.0, 64.0, 256.0)
"""Residuals of several contacts at once, in units of the errors; each is as probable as the others."""
SHARES = (0.01, 0.5)
"""Bounds of the share of samples that are not a single contact."""


def single_contact(misfit: Floats, degrees: int, share: float) -> Floats:
    """Return the probability that each contact is a single one, by its misfit; `share` are not."""
    log_other = np.logaddexp.reduce([-misfit / 2 / scale**2 - degrees * np.log(scale) for scale in MISFITS], axis=0)
    odds = np.log(share / (1 - share) / len(MISFITS)) + log_other + misfit / 2
    single: Floats = 1 / (1 + np.exp(np.minimum(odds, 700.0)))
    return single
