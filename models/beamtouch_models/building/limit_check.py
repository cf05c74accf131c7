"""The check of a built model: it is refused if its error or its coverage misses the accuracy limit."""

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import ratio_of
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.estimators.estimator import Estimator
from beamtouch_models.export import to_bytes
from beamtouch_models.session import runner

DRAWS = 1000
MAX_RATIO, MIN_COVERAGE = 1.2, 0.9
"""Largest mean error over the limit, and smallest share of positions inside their 95 % intervals."""
SURE = 4.0
"""Number of standard errors by which a bound must be missed."""


def check_at_limit(made: Estimator, prior: Prior, seed: int) -> None:
    """Refuse a model with answers that are not finite, and a posterior that misses the limit or its coverage.

    Raises
    ------
    NotGoodEnoughError
        An answer is not finite, or the mean error or the coverage misses its bound beyond chance.
    """
    drawn = limit.draw(prior, DRAWS, seed)
    deflection = prior.measured(drawn.deflection_mm)
    answers = runner(to_bytes(made.graph))(deflection, prior.whitening(deflection))
    if not all(np.isfinite(values).all() for values in answers.values()):
        message = "nothing was written: some answers of the model are not finite; check the scene for extreme values"
        raise NotGoodEnoughError(message)
    if made.name != "posterior":  # the other estimators are trained and may miss the limit
        return
    error = np.abs(answers["position_mm"].astype(np.float64) - drawn.position_mm)
    best = np.abs(limit.posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm)
    ratio = ratio_of(error, best)
    low, high = answers["position_low_mm"], answers["position_high_mm"]
    coverage = float(((low <= drawn.position_mm) & (drawn.position_mm <= high)).mean())
    spread = (MIN_COVERAGE * (1 - MIN_COVERAGE) / DRAWS) ** 0.5
    if ratio.value - SURE * ratio.standard_error <= MAX_RATIO and coverage + SURE * spread >= MIN_COVERAGE:
        return
    message = (
        f"nothing was written: with {digits(prior.noise_mm, 3)} mm of noise the model's error is "
        f"{digits(ratio.value, 3)} times the accuracy limit, and {coverage:.1%} of positions lie in their 95 % "
        "intervals; state a larger noise"
    )
    raise NotGoodEnoughError(message)
