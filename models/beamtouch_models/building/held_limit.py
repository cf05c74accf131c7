"""The check of a finished estimator that is to be at the accuracy limit: a model that is not is never written."""

import numpy as np

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import ratio_of
from beamtouch_models.errors import NotGoodEnoughError, SceneError
from beamtouch_models.estimators.estimator import Estimator
from beamtouch_models.export import to_bytes
from beamtouch_models.session import runner

MIN_NOISE, MAX_NOISE = 1e-6, 1e3
"""Noise of a sample over the largest deflection. Float32, in which a model takes its samples, resolves 6e-8; and with
a thousand times the deflection a sample tells nothing."""
MIN_DEFLECTION_MM, MAX_DEFLECTION_MM = 1e-9, 1e9
"""Largest deflection of a beam that sensors measure, with room: squares of it are numbers in float32."""
DRAWS = 1000
MAX_RATIO, MIN_COVERAGE = 1.2, 0.9
"""Bounds of the mean error over the limit, and of the share of positions in intervals that state 95 %."""
SURE = 4.0
"""Standard errors by which a bound must be missed."""


def check_scale(noise_mm: float, max_deflection_mm: float) -> None:
    """Refuse a deflection, or a noise of a sample beside it, that no model can carry; raises SceneError."""
    if not MIN_DEFLECTION_MM <= max_deflection_mm <= MAX_DEFLECTION_MM:
        message = (
            f"beam: the largest deflection is {max_deflection_mm:.3g} mm, which no sensor measures; check its "
            "length and rigidity, and contact.force_n"
        )
        raise SceneError(message)
    if noise_mm > MAX_NOISE * max_deflection_mm:
        message = (
            f"sensors: a sample's noise of {noise_mm:.3g} mm hides the largest deflection, {max_deflection_mm:.3g} mm; "
            "take better sensors or a softer beam"
        )
        raise SceneError(message)
    if noise_mm < MIN_NOISE * max_deflection_mm:
        message = (
            f"sensors: a sample's noise of {noise_mm:.3g} mm is less than 1e-4 % of the largest deflection, "
            f"{max_deflection_mm:.3g} mm, more than a model's float32 can carry; state the noise of a real sensor"
        )
        raise SceneError(message)


def check_held(made: Estimator, prior: Prior, seed: int) -> None:
    """Refuse a model that answers no numbers, and a posterior that misses the limit or whose intervals hold too little.

    Raises
    ------
    NotGoodEnoughError
        An answer is not finite, or the mean error or the coverage misses its bound by more than chance.
    """
    drawn = limit.draw(prior, DRAWS, seed)
    deflection = prior.stated(drawn.deflection_mm).astype(np.float32)
    answers = runner(to_bytes(made.graph))(deflection, np.ones(deflection.shape, np.bool_))
    if not all(np.isfinite(values).all() for values in answers.values()):
        message = "nothing was written: some of the model's answers are no numbers; check the scene for odd values"
        raise NotGoodEnoughError(message)
    if made.name != "posterior":  # the other estimators are trained and promise no limit
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
        f"nothing was written: with {prior.noise_mm:.3g} mm of noise the model's error is {ratio.value:.3g} times the "
        f"accuracy limit, and its 95 % intervals hold {coverage:.1%} of positions; state a larger noise"
    )
    raise NotGoodEnoughError(message)
