"""The fit of all departures, with how large each kind of them is, and how uncertain that leaves them.

Gains, sensor positions and fixities explain much the same. Which of them depart much and which little is not known, and
a choice by the data would sometimes be chance. So no kind is left out: every combination of small and of plausible
kinds is weighed by the probability of the recording under it (Bayesian model averaging; Hoeting, Madigan, Raftery &
Volinsky 1999, doi 10.1214/ss/1009212519), linearly about one fit of all kinds. The fit has the mean sizes, and its
errors are those of all combinations, so that they hold what the choice leaves open.
"""

from dataclasses import replace
from itertools import product

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.fit import Fit, fit
from beamtouch_models.design.calibration.nominal_surface import GAIN, RIGIDITY

SIZES = (0.3, 1.0)
"""Small and plausible departures, over the plausible ones. A smaller one, or none, would promise more of unknown
surfaces than is true."""
ALIKE = 1e-3
"""Relative difference of slopes that are the same but for rounding."""


def averaged_fit(full: Fit) -> Fit:
    """Return the fit of the kinds of a fit to all, in the mean size of each, and with the errors of all sizes."""
    session, kinds = full.session, full.kinds
    sizes, means, covariances, weights = _combinations(full)
    mean_sizes = {kind: float(np.sqrt(weights @ sizes[:, place] ** 2)) for place, kind in enumerate(kinds)}
    best = fit(full.nominal, session.loads, kinds, full.vector, sizes=mean_sizes)
    apart = means - weights @ means
    covariance = np.einsum("k,kvw->vw", weights, covariances) + np.einsum("k,kv,kw->vw", weights, apart, apart)
    return _with_scale_in_rigidity(replace(best, covariance=covariance))


def _combinations(full: Fit) -> tuple[Floats, Floats, Floats, Floats]:
    """Return all combinations of sizes (combinations, kinds), and their weights.

    Between the two, the means (combinations, entries) and covariances (combinations, entries, entries) of the vector.
    """
    session = full.session
    residuals = session.residuals(full.vector)
    whitening = residuals.whitening(full.errors)
    weighed = np.concatenate(whitening @ session.slopes(full.vector, full.kinds))
    shown = (whitening @ residuals.left_mm[..., None]).ravel() + weighed @ full.vector
    information, pull = weighed.T @ weighed, weighed.T @ shown
    sizes = np.array(list(product(SIZES, repeat=len(full.kinds))))
    closed = dict.fromkeys(session.kinds, 0.0)
    scales = np.array([session.about(closed | dict(zip(full.kinds, row, strict=True))) for row in sizes.tolist()])
    precision = np.eye(session.size) + scales[:, :, None] * information * scales[:, None, :]
    covariances = scales[:, :, None] * np.linalg.inv(precision) * scales[:, None, :]
    means = covariances @ pull
    log_weights = (means @ pull - np.linalg.slogdet(precision)[1]) / 2
    weights = np.exp(log_weights - log_weights.max())
    return sizes, means, covariances, weights / weights.sum()


def has_one_scale(found: Fit) -> bool:
    """Return whether rigidity scales all deflections as all gains together do: then loads show the product only."""
    kinds, slopes = found.session.kinds, found.session.slopes(found.vector, ("rigidity", "gain"))
    of_rigidity = slopes[..., kinds["rigidity"]].sum(axis=-1)
    differs = of_rigidity + RIGIDITY / GAIN * slopes[..., kinds["gain"]].sum(axis=-1)
    return bool(np.linalg.norm(differs) <= ALIKE * np.linalg.norm(of_rigidity))


def shares_of_scale(gain: Floats) -> Floats:
    """Return the weights (channels,) with which gains make the scale: their median.

    Where one sensor is off and the others are not, the median leaves it alone.
    """
    channels, shares = len(gain), np.zeros(len(gain))
    middle = np.argsort(gain)[(channels - 1) // 2 : channels // 2 + 1]
    shares[middle] = 1 / len(middle)
    return shares


def _with_scale_in_rigidity(found: Fit) -> Fit:
    """Return a fit whose rigidity holds what the gains have in common, if loads do not tell them apart.

    A rigidity that is off is more plausible than gains that are all off alike: by `RIGIDITY` to `GAIN` over the root of
    their number. The deflections stay the same.
    """
    if not has_one_scale(found):
        return found
    kinds = found.session.kinds
    gain, rigidity = kinds["gain"], kinds["rigidity"].start
    fold, shares = np.eye(found.session.size), shares_of_scale(found.vector[gain])
    fold[gain, gain] -= shares
    fold[rigidity, gain] = -GAIN / RIGIDITY * shares
    return replace(found, vector=fold @ found.vector, covariance=fold @ found.covariance @ fold.T)
