"""Position errors of recorded loads, by the given model and by a fit, beside the best estimate for such loads."""

from dataclasses import replace

import numpy as np

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.fit import Fit, fit
from beamtouch_models.calibration.loads import Loads
from beamtouch_models.calibration.theory import Theory
from beamtouch_models.metadata import Departures, Metadata
from beamtouch_models.surface import prior_of_model


def errors_of_model(metadata: Metadata, loads: Loads) -> Floats:
    """Return the position errors (loads,) of the given model."""
    departures = None if metadata.calibration is None else metadata.calibration.departures
    prior = prior_of_model(metadata)
    return np.array([_error(prior, departures, loads, index) for index in range(len(loads.number))])


def error_without(theory: Theory, loads: Loads, found: Fit, index: int) -> float:
    """Return the position error of a load by a fit without it."""
    departures = fit(theory, loads.without(index), found.kinds, found.vector).departures
    return _error(theory.prior_with(departures), departures, loads, index)


def _error(prior: Prior, departures: Departures | None, loads: Loads, index: int) -> float:
    """Return the position error of a load, located from the mean of its samples.

    The noise is that of the mean, without the floor. With that of a single sample, a weak load would be drawn towards
    the middle of the range, which can hide an error of the surface.
    """
    reading = loads.measured_mm[index]
    valid = np.isfinite(reading)
    if departures is not None:
        reading = departures.linear_mm(reading)
    noise_mm = float(loads.deviation_mm[index][valid].mean())
    exact = replace(prior, noise_mm=noise_mm, gain=0.0, zero_mm=0.0, uncertain_at=None)
    seen = exact.without(*np.flatnonzero(~valid).tolist())
    return float(abs(limit.posterior_median_mm(seen, reading[valid][None])[0] - loads.position_mm[index]))


def limit_mm(prior: Prior, loads: Loads, seed: int, draws: int = 400) -> float:
    """Return the mean error of the best estimate for samples of these loads."""
    rng = np.random.default_rng(seed)
    clean = loads.force_n[:, None] * prior.influence_at(loads.position_mm)
    noise = rng.normal(size=(draws, *clean.shape)) * prior.deviation_mm(clean)
    readings = (clean + noise).reshape(-1, prior.channels)
    off = limit.posterior_median_mm(prior, readings).reshape(draws, -1) - loads.position_mm
    return float(np.abs(off).mean())
