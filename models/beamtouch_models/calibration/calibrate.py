"""From recorded loads to a model of the real surface."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamtouch_models import limit
from beamtouch_models.calibration.fit import Fit, Theory, fit, supported_fit
from beamtouch_models.calibration.loads import Loads, LoadsError
from beamtouch_models.estimators.estimator import Estimator, Name, estimator_of
from beamtouch_models.estimators.onnx_graph import with_linear_input
from beamtouch_models.export import to_bytes
from beamtouch_models.measured import measured
from beamtouch_models.model_prior import physics_of
from beamtouch_models.modelfile import Calibration, Departures, Metadata, ModelFile
from beamtouch_models.prior import Prior

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

MISTAKEN = 6.0
"""A load is mistaken if, left out, it is this many times as far off as the loads are on the median."""
FAR_NOISES = 8.0
"""And at least so many times the noise of a sample."""


@dataclass(frozen=True)
class Calibrated:
    """A model of the real surface, and how it was found."""

    content: bytes
    metadata: Metadata
    fit: Fit
    before_mm: Array
    """(loads,) position error of the given model."""
    after_mm: Array
    """(loads,) position error of a fit without the load."""
    limit_mm: float
    """Mean error of the best estimate for such loads with the noise of a sample."""
    mistaken: tuple[int, ...]
    """Loads that fit nothing and were left out, by their number in the file."""


def calibrate(model: ModelFile, loads: Loads, progress: Progress) -> Calibrated:
    """Fit a model to recorded loads and make it anew.

    Raises
    ------
    LoadsError
        More than one load fits nothing, or the fit is no better than the model was.
    """
    metadata = model.metadata
    theory = Theory.of(physics_of(metadata), metadata)
    loads, mistaken = _without_mistaken(theory, loads, progress)
    found = supported_fit(theory, loads, lambda done: progress("fitting", 0.3 + 0.2 * done))
    before = _errors_of_model(model, loads)
    after = np.empty(len(loads.number))
    for index in range(len(after)):
        progress("leaving out one load after the other", 0.5 + 0.2 * index / len(after))
        after[index] = _error_without(theory, loads, found, index)
    if found.kinds and after.mean() > before.mean():
        message = (
            f"left out one by one, loads are located to {after.mean():.3g} mm by a fit, to {before.mean():.3g} mm "
            "by the model as it is; keep it, or record more loads over the whole beam"
        )
        raise LoadsError(message)
    prior = _calibrated_prior(theory, found)
    made = _made(metadata, prior, found.departures, lambda done: progress("making the estimator", 0.7 + 0.1 * done))
    progress("measuring the accuracy against the limit", 0.85)
    calibration = Calibration(
        departures=found.departures,
        fitted=list(found.kinds),
        loads=len(loads.number),
        unexplained_mm=_unexplained_mm(found),
        error_before_mm=float(before.mean()),
        error_after_mm=float(after.mean()),
    )
    fields = measured(made, prior, metadata.seed)
    fresh = metadata.model_copy(
        update={
            "min_channels": made.min_channels,
            "contact_threshold": fields.contact_threshold,
            "accuracy": fields.accuracy,
            "golden": fields.golden,
            "calibration": calibration,
        }
    )
    best = _limit_mm(prior, loads, metadata.seed)
    return Calibrated(to_bytes(made.graph, fresh), fresh, found, before, after, best, mistaken)


def _without_mistaken(theory: Theory, loads: Loads, progress: Progress) -> tuple[Loads, tuple[int, ...]]:
    """Leave out a load that fits nothing; raises LoadsError where there are more."""
    mistaken: list[int] = []
    while True:
        progress("looking for loads that do not fit", 0.1 + 0.1 * len(mistaken))
        every = fit(theory, loads, tuple(theory.kinds))
        off = np.sqrt(np.nanmean(every.left_out_mm**2, axis=1))
        worst = int(off.argmax())
        if off[worst] < max(MISTAKEN * float(np.median(off)), FAR_NOISES * theory.prior.noise_mm):
            return loads, tuple(mistaken)
        mistaken.append(int(loads.number[worst]))
        if len(mistaken) > 1:
            message = f"loads {mistaken[0]} and {mistaken[1]} do not fit the others; check their positions and forces"
            raise LoadsError(message)
        loads = loads.without(worst)


def _unexplained_mm(found: Fit) -> float:
    """What a prediction is off by beyond the noise of the recording; it widens the intervals."""
    return float(max(found.unexplained_mm, found.error_mm if found.kinds else 0.0))


def _calibrated_prior(theory: Theory, found: Fit) -> Prior:
    prior = theory.prior_with(found.departures)
    return replace(prior, noise_mm=float(np.hypot(prior.noise_mm, _unexplained_mm(found))))


def _made(metadata: Metadata, prior: Prior, departures: Departures, progress: Callable[[float], None]) -> Estimator:
    name: Name = metadata.estimator  # type: ignore[assignment]  # a file of another name would not have been built
    with_force = "force_n" in metadata.golden.answers
    made = estimator_of(name, prior, with_force=with_force, seed=metadata.seed, progress=progress)
    graph = with_linear_input(made.graph, np.array(departures.offset_mm), departures.curve_per_mm)
    return replace(made, graph=graph)


def _errors_of_model(model: ModelFile, loads: Loads) -> Array:
    valid = np.isfinite(loads.stated_mm)
    answers = model.estimate(np.nan_to_num(loads.stated_mm).astype(np.float32), valid)
    return np.abs(answers["position_mm"].astype(np.float64) - loads.position_mm)


def _error_without(theory: Theory, loads: Loads, found: Fit, index: int) -> float:
    """Position error of a load by the posterior of a fit without it."""
    rest = fit(theory, loads.without(index), found.kinds, found.vector)
    departures = rest.departures
    prior = _calibrated_prior(theory, rest)
    stated = loads.stated_mm[index]
    valid = np.isfinite(stated)
    reading = stated - np.array(departures.offset_mm)
    linear = (reading + departures.curve_per_mm * reading**2)[valid]
    seen = prior.without(*np.flatnonzero(~valid).tolist())
    return float(abs(limit.posterior_median_mm(seen, linear[None])[0] - loads.position_mm[index]))


def _limit_mm(prior: Prior, loads: Loads, seed: int, draws: int = 400) -> float:
    """Mean error of the best estimate for samples of these loads."""
    rng = np.random.default_rng(seed)
    clean = loads.force_n[:, None] * prior.influence_at(loads.position_mm)
    noise = rng.normal(scale=prior.noise_mm, size=(draws, *clean.shape))
    readings = (clean + noise).reshape(-1, prior.channels)
    off = limit.posterior_median_mm(prior, readings).reshape(draws, -1) - loads.position_mm
    return float(np.abs(off).mean())
