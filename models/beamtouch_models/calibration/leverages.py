"""The residuals of loads that are left out of a fit, from the leverages of all loads in one fit.

PRESS; Allen 1974, doi 10.1080/00401706.1974.10489157.
"""

import numpy as np

from beamtouch_models.arrays import Floats


def hat_matrix(slopes: Floats) -> Floats:
    """Return the hat matrix of whitened residuals, with priors of variance 1 on the departures."""
    matrix: Floats = slopes @ np.linalg.solve(slopes.T @ slopes + np.eye(slopes.shape[1]), slopes.T)
    return matrix


def left_out_residuals(residual: Floats, slopes: Floats) -> Floats:
    """Return the whitened residuals (loads, channels, 1) of each load when it is left out of the fit."""
    hat, channels = hat_matrix(slopes), residual.shape[1]
    own = [slice(start, start + channels) for start in range(0, residual.size, channels)]
    pairs = zip(own, residual, strict=True)
    return np.array([np.linalg.solve(np.eye(channels) - hat[rows, rows], one) for rows, one in pairs])
