"""Calibration: recorded loads turn a model into one of the real surface."""

from dataclasses import dataclass, replace

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.fit import Fit, fit, supported_fit
from beamtouch_models.calibration.loads import Loads, LoadsError
from beamtouch_models.calibration.mistaken import Suspect, mistaken, swapped
from beamtouch_models.calibration.rebuilt import rebuilt
from beamtouch_models.calibration.theory import Theory
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.loading import ModelFile
from beamtouch_models.metadata import Calibration, Departures, Metadata
from beamtouch_models.progress import Progress
from beamtouch_models.surface import Surface, prior_of_model


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


MAX_LEFT = 0.1
"""Largest error of a fit, over the deflections that the scene predicts, and over the length.

Above it, the recording is of another surface.
"""
WORSE = 1.05
"""Factor by which the error of single samples may grow. Where a model is already right, the errors of the recording
decide whether a fit locates its loads a little better or a little worse."""


@dataclass(frozen=True)
class Calibrated:
    """A model of the real surface, with the fit and its errors."""

    content: bytes
    metadata: Metadata
    fit: Fit
    before_mm: Floats
    """(loads,) position error of the given model."""
    after_mm: Floats
    """(loads,) position error of a fit without the load."""
    limit_mm: float
    """Mean error of the best estimate for these loads at the noise of a sample."""


@dataclass(frozen=True)
class Checked:
    """A fit to consistent loads that is better than the given model."""

    fit: Fit
    before_mm: Floats
    after_mm: Floats


def checked_fit(model: ModelFile, loads: Loads, progress: Progress) -> Checked:
    """Fit the departures of a model's surface to recorded loads; raises as `calibrate`."""
    theory = Theory.of(model.metadata)
    swap = swapped(theory, loads, [channel.name for channel in model.metadata.layout])
    if swap:
        raise LoadsError(swap)
    suspects = mistaken(theory, loads, lambda done: progress("looking for loads that do not fit", 0.3 * done))
    if suspects:
        raise LoadsError(_contradiction(loads, suspects))
    found = supported_fit(theory, loads, lambda done: progress("fitting", 0.3 + 0.2 * done))
    expected_mm = theory.measured_mm(np.zeros(theory.size), loads)[np.isfinite(loads.measured_mm)]
    if not np.any(expected_mm):
        message = "nothing was written: by this model, none of the loads moves a sensor; record loads elsewhere"
        raise NotGoodEnoughError(message)
    left = found.error_mm / float(np.sqrt((expected_mm**2).mean()))
    if not left <= MAX_LEFT:
        raise NotGoodEnoughError(_another_surface(f"leaves {left:.0%} of the expected deflections unexplained"))
    before = errors_of_model(model.metadata, loads)
    after = np.empty(len(loads.number))
    for index in range(len(after)):
        progress("leaving out one load at a time", 0.5 + 0.2 * index / len(after))
        after[index] = error_without(theory, loads, found, index)
    # A single sample has this error in addition, and the loads themselves stand a little off.
    best = float(np.hypot(limit_mm(theory.prior, loads, model.metadata.seed, draws=100), loads.errors.placing_mm))
    if not after.mean() <= max(MAX_LEFT * model.metadata.length_mm, best):
        raise NotGoodEnoughError(_another_surface(f"locates left-out loads to {digits(after.mean(), 3)} mm"))
    # A fit without departures is right only if the scene itself locates well.
    worse = np.hypot(after.mean(), best) > WORSE * np.hypot(before.mean(), best)
    if worse or (not found.kinds and not after.mean() <= best):
        raise NotGoodEnoughError(_worse(loads, before, after))
    return Checked(found, before, after)


def calibrate(model: ModelFile, loads: Loads, progress: Progress) -> Calibrated:
    """Fit a model to recorded loads and rebuild it.

    Raises
    ------
    LoadsError
        A load contradicts the others, or channels or ends of the beam are swapped; the message names them.
    NotGoodEnoughError
        The fit locates left-out loads worse than the given model does, or explains too little of the recording.
    """
    metadata = model.metadata
    checked = checked_fit(model, loads, progress)
    found, before, after = checked.fit, checked.before_mm, checked.after_mm
    theory = found.theory
    prior = _calibrated_prior(metadata, theory, found)
    calibration = Calibration(
        departures=found.departures,
        fitted=list(found.kinds),
        loads=len(loads.number),
        residual_mm=_residual_mm(found),
        error_before_mm=float(before.mean()),
        error_after_mm=float(after.mean()),
    )
    content, fresh = rebuilt(metadata, prior, calibration, progress)
    best = limit_mm(prior, loads, metadata.seed)
    return Calibrated(content, fresh, found, before, after, best)


def _contradiction(loads: Loads, suspects: tuple[Suspect, ...]) -> str:
    """Return the message that names the loads that contradict the others, and where the others place them."""
    told = []
    for one in suspects:
        start, end = loads.lines[one.index]
        told.append(
            f"load {loads.number[one.index]} (lines {start} to {end}) says {loads.position_mm[one.index]:g} mm and "
            f"{loads.force_n[one.index]:g} N, but the other loads place it at {digits(one.position_mm, 4)} mm with "
            f"{digits(one.force_n, 3)} N"
        )
    alternatives = not all(one.certain for one in suspects)
    what = "either load may be wrong: " if alternatives and len(suspects) > 1 else ""
    numbers = " ".join(f"--leave-out {loads.number[one.index]}" for one in suspects)
    end = "record more loads to find out which" if what else f"correct it, or use {numbers}"
    return f"{what}{'; '.join(told)}; {end}; nothing was written"


def _another_surface(shown: str) -> str:
    """Return the message that a recording is not of this surface; `shown` says what the best fit does."""
    return (
        f"nothing was written: the recording does not fit this model's surface. The best fit {shown}. "
        "Check that model, sensors, positions and forces belong together, and record again"
    )


def _worse(loads: Loads, before: Floats, after: Floats) -> str:
    worst = int(after.argmax())
    return (
        "nothing was written: a model fitted to these loads would be worse. A fit locates left-out loads to "
        f"{digits(after.mean(), 4)} mm, the given model to {digits(before.mean(), 4)} mm. The largest error is that "
        f"of load {loads.number[worst]} (lines {loads.lines[worst, 0]} to {loads.lines[worst, 1]}), "
        f"{digits(after[worst], 3)} mm. Keep the model, or check the loads and record more over the whole beam"
    )


def _residual_mm(found: Fit) -> float:
    """Return the error of a prediction beyond the noise of the recording; it widens the intervals."""
    return float(np.hypot(found.residual_mm, found.prediction_mm))


def _calibrated_prior(metadata: Metadata, theory: Theory, found: Fit) -> Prior:
    prior, floor = theory.prior_with(found.departures), metadata.floor
    # The floor of the scene comes with the model; what the fit leaves unexplained does not average away either.
    zero_mm = np.hypot(Surface.of_model(metadata).readings.floor_mm, _residual_mm(found))
    # The offsets are what the zeros drifted between the tare and the recording, and the next tare takes them away.
    return replace(prior, gain=np.array(floor.gain), zero_mm=np.hypot(zero_mm, found.departures.offset_mm))
