"""Calibration: recorded loads turn a model into one of the real surface.

Self-calibration makes a model again for its surface by the same `rebuilt`.
"""

from dataclasses import dataclass, replace

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy import limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.building.measure import measure
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.calibration.choice import averaged_fit
from beamtouch_models.design.calibration.doubts import common_in_words, doubts
from beamtouch_models.design.calibration.fit import Fit, fit
from beamtouch_models.design.calibration.mistaken import MistakenLoad, mistaken
from beamtouch_models.design.calibration.nominal_surface import POSITION_MM, NominalSurface
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.calibration.session import DRIFTING, Session
from beamtouch_models.design.calibration.swapped import swapped
from beamtouch_models.design.calibration.unlabelled import measure_remaining
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.estimators.estimator import Estimator, estimator_of
from beamtouch_models.design.estimators.onnx_graph import to_bytes, with_force_error, with_linear_input
from beamtouch_models.design.placement.placing import Aim
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.design.scene.tables import MAX_GAIN_PERCENT
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.design.sweeps import Fraction, Progress, silent
from beamtouch_models.design.world import World
from beamtouch_models.errors import ModelFileError, NotGoodEnoughError
from beamtouch_models.names import ESTIMATORS
from beamtouch_models.places import distances_mm, in_words
from beamtouch_models.runtime.departures import Calibration, Departures
from beamtouch_models.runtime.loading import ModelFile
from beamtouch_models.runtime.metadata import Metadata

MAX_LEFT = 0.1
"""Largest error of a fit, over the deflections that the scene predicts, and over the length.

Above it, the recording is of another surface.
"""
MOVED = 0.01
"""Deflection, in noises of a sample, below which a load moves no sensor."""
UNRELATED = "Check that model, sensors, positions and forces belong together"
WORSE = 1.05
"""Factor by which the error of single samples may grow. Where a model is already right, the errors of the recording
decide whether a fit locates its loads a little better or a little worse."""


@dataclass(frozen=True)
class CheckedFit:
    """A fit to consistent loads that is better than the given model."""

    fit: Fit
    before_mm: Floats
    """(loads,) position error of the given model."""
    after_mm: Floats
    """(loads,) position error of a fit without the load."""
    sure: tuple[str, ...]
    """Kinds of mistakes that all loads share and that surely are there; the fit may have others, perhaps."""


@dataclass(frozen=True)
class Calibrated(CheckedFit):
    """A model of the real surface, with the fit and its errors."""

    content: bytes
    metadata: Metadata
    limit_mm: float
    """Mean error of the best estimate for these loads at the noise of a sample."""


def calibrate(
    model: ModelFile,
    loads: Loads,
    progress: Progress,
    mounting_mm: float = POSITION_MM,
    effort: Effort = USUAL,
) -> Calibrated:
    """Fit a model to recorded loads and rebuild it; sensors stand where they should but for `mounting_mm`.

    The fit takes all loads; `effort` is that of the measurements on the new model.

    Raises
    ------
    RecordingError
        A load contradicts the others, or channels or ends of the beam are swapped; the message names them.
    NotGoodEnoughError
        The fit locates left-out loads worse than the given model does, or explains too little of the recording.
    """
    metadata, checked = model.metadata, checked_fit(model, loads, progress, mounting_mm)
    departures, before_mm, after_mm = checked.fit.departures, checked.before_mm, checked.after_mm
    gain, zero_mm, force_error = left_open(metadata, checked.fit)
    prior = checked.fit.nominal.prior_with(departures).with_floor(gain, zero_mm)
    calibration = Calibration(
        departures=departures,
        fitted=[kind for kind in checked.fit.kinds if kind in checked.fit.nominal.kinds],
        loads=len(loads.number),
        residual_mm=float(np.hypot(_unexplained_mm(checked.fit), checked.fit.prediction_mm)),
        error_before_mm=float(before_mm.mean()),
        error_after_mm=float(after_mm.mean()),
        force_error=force_error,
    )
    content, fresh = rebuilt(metadata, prior, calibration, progress, effort)
    best_mm = limit_mm(prior, loads, metadata.seed)
    return Calibrated(checked.fit, before_mm, after_mm, checked.sure, content, fresh, best_mm)


def left_open(metadata: Metadata, fit: Fit) -> tuple[Floats, Floats, float]:
    """Return what a fit to loads leaves open: errors of gains and zeros (channels,), and of all forces together.

    The gains take the place of those of the scene, which the fit has measured. Departures move deflections along with
    the force: as gains, what they leave open is small for a weak contact.
    """
    nominal, scene_mm = fit.nominal, resolve_model(metadata).readings.floor_mm
    size, offset = nominal.size, nominal.kinds["offset"]
    covariance = fit.covariance[:size, :size].copy()
    # The next tare takes the zeros of the recording away.
    covariance[offset], covariance[:, offset] = 0.0, 0.0
    noise_mm = np.full(nominal.prior.channels, np.hypot(metadata.noise.sample_mm, scene_mm))
    remaining = measure_remaining(nominal, fit.vector[:size], covariance, noise_mm)
    # Until then, they are off by what drifted between the tare and the recording, and by what shows to drift during it.
    drift, shown = fit.session.kinds[DRIFTING], fit.vector.copy()
    shown[drift] = np.sqrt(np.maximum(shown[drift] ** 2 - fit.spread[drift] ** 2, 0.0))
    drifted_mm = np.abs(fit.session.drift_mm(shown)).max(axis=0)
    zero_mm = np.hypot(np.hypot(scene_mm, _unexplained_mm(fit)), fit.departures.offset_mm)
    force_error = remaining.force_error if nominal.prior.force_range.is_open else 0.0
    return np.minimum(remaining.floor, MAX_GAIN_PERCENT / 100), np.hypot(zero_mm, drifted_mm), force_error


def _unexplained_mm(fit: Fit) -> float:
    """Return what a fit leaves unexplained of the deflections of its loads, beyond noise."""
    bends_mm = fit.session.bends_mm(fit.vector)
    return float(np.hypot(fit.errors.residual_mm, np.sqrt(np.nanmean(bends_mm**2))))


def checked_fit(model: ModelFile, loads: Loads, progress: Progress, mounting_mm: float = POSITION_MM) -> CheckedFit:
    """Fit the departures of a model's surface to recorded loads; raises as `calibrate`."""
    nominal = replace(NominalSurface.of(model.metadata), mounting_mm=mounting_mm)
    names = [channel.name for channel in model.metadata.layout]
    swap = swapped(nominal, loads, names)
    if swap:
        raise RecordingError(swap)
    doubt = doubts(nominal, loads, names)
    if doubt.refusal:
        raise RecordingError(doubt.refusal)
    mistaken_loads = mistaken(nominal, loads, lambda done: progress("looking for loads that do not fit", 0.3 * done))
    if mistaken_loads:
        raise RecordingError(_contradiction(loads, mistaken_loads))
    progress("fitting", 0.4)
    fitted = averaged_fit(fit(nominal, loads, (*Session(nominal, loads).usual_kinds, *doubt.kinds)))
    expected_mm = nominal.curve(np.zeros(nominal.size)).measured_mm(loads.place_mm, loads.force_n)
    expected_mm = expected_mm[np.isfinite(loads.measured_mm)]
    if not np.abs(expected_mm).max() > MOVED * nominal.prior.errors.noise_mm:
        raise NotGoodEnoughError(
            "nothing was written: by this model, none of the loads moves a sensor; record loads elsewhere"
        )
    unexplained = fitted.error_mm / float(np.sqrt((expected_mm**2).mean()))
    if not unexplained <= MAX_LEFT:
        hint = _scale_hint(loads.measured_mm[np.isfinite(loads.measured_mm)], expected_mm)
        raise NotGoodEnoughError(
            _another_surface(f"leaves {unexplained:.0%} of the expected deflections unexplained", hint)
        )
    before = _errors_mm(
        prior_of_model(model.metadata), model.metadata.departures, fitted.session.as_of_surface(fitted.vector)
    )
    after = np.empty(len(loads.number))
    for index in range(len(after)):
        progress("leaving out one load at a time", 0.5 + 0.2 * index / len(after))
        others = fit(nominal, loads.without(index), fitted.kinds, fitted.vector, sizes=fitted.sizes)
        load = Session(nominal, loads[[index]]).as_of_surface(others.vector)
        after[index] = _errors_mm(nominal.prior_with(others.departures), others.departures, load)[0]
    # A single sample has this error in addition, and the loads themselves stand a little off.
    best = float(np.hypot(limit_mm(nominal.prior, loads, model.metadata.seed, draws=100), loads.errors.placing_mm))
    if not after.mean() <= max(MAX_LEFT * model.metadata.diagonal_mm, best):
        raise NotGoodEnoughError(_another_surface(f"locates left-out loads to {digits(after.mean(), 3)} mm"))
    if np.hypot(after.mean(), best) > WORSE * np.hypot(before.mean(), best):
        raise NotGoodEnoughError(
            "; ".join([_worse(loads, before, after), *common_in_words(fitted, doubt.sure).values()])
        )
    return CheckedFit(fitted, before, after, doubt.sure)


def _errors_mm(prior: Prior, departures: Departures, loads: Loads) -> Floats:
    """Return the position errors (loads,) of loads that are located from the means of their samples.

    The noise is that of the mean, without the floor. With that of a single sample, a weak load would be drawn towards
    the middle of the range, which can hide an error of the surface.
    """
    errors = np.empty(len(loads.number))
    for index, (measured, deviation) in enumerate(zip(loads.measured_mm, loads.deviation_mm, strict=True)):
        valid = np.isfinite(measured)
        noise_mm = float(deviation[valid].mean())
        exact = prior.with_noise_alone(noise_mm)
        linear_mm = departures.linear_mm(measured)[valid][None]
        found_mm = limit.posterior_places_mm(exact.without(*np.flatnonzero(~valid).tolist()), linear_mm)[0]
        errors[index] = distances_mm(found_mm - loads.place_mm[index])
    return errors


def limit_mm(prior: Prior, loads: Loads, seed: int, draws: int = 400) -> float:
    """Return the mean error of the best estimate for samples of these loads."""
    rng = np.random.default_rng(seed)
    clean = loads.force_n[:, None] * prior.influence_at(loads.place_mm)
    noise = rng.normal(size=(draws, *clean.shape)) * prior.errors.deviation_mm(clean)
    readings = np.concatenate(clean + noise)
    found_mm = limit.posterior_places_mm(prior, readings).reshape(draws, *loads.place_mm.shape)
    return float(distances_mm(found_mm - loads.place_mm).mean())


def _contradiction(loads: Loads, mistaken_loads: tuple[MistakenLoad, ...]) -> str:
    """Return the message that names the loads that contradict the others, and where the others place them."""
    told = [
        f"{loads.in_words(load.index)} says {in_words(loads.place_mm[load.index])} mm "
        f"and {loads.force_n[load.index]:g} N, but the other loads place it at {_to_four_digits(load)} mm with "
        f"{digits(load.force_n, 3)} N"
        for load in mistaken_loads
    ]
    alternatives = not all(load.certain for load in mistaken_loads)
    what = "either load may be wrong: " if alternatives and len(mistaken_loads) > 1 else ""
    numbers = " ".join(f"--leave-out {loads.number[load.index]}" for load in mistaken_loads)
    end = "record more loads to find out which" if what else f"correct it, or use {numbers}"
    return f"{what}{'; '.join(told)}; {end}; nothing was written"


def _to_four_digits(load: MistakenLoad) -> str:
    """Return the place of a load, as `places.in_words` has it."""
    numbers = [digits(float(number), 4) for number in load.place_mm]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"


def _another_surface(shown: str, hint: str = UNRELATED) -> str:
    """Return the message that a recording is not of this surface; `shown` says what the best fit does."""
    return (
        f"nothing was written: the recording does not fit this model's surface. The best fit {shown}. "
        f"{hint}, and record again"
    )


def _scale_hint(measured_mm: Floats, expected_mm: Floats) -> str:
    """Return the advice on deflections (samples,) that a fit does not explain; they may all be wrong by a factor."""
    factor = float(measured_mm @ expected_mm) / float(expected_mm @ expected_mm)
    rest = np.linalg.norm(measured_mm - factor * expected_mm)
    if not rest <= MAX_LEFT * np.linalg.norm(measured_mm):
        return UNRELATED
    if factor < 0:
        cause = "a deflection is positive in the direction of the load, so check the signs"
    else:
        cause = "check the units of deflections and forces (1 kg weighs 9.81 N), and the beam's dimensions"
    return f"All deflections are {digits(factor, 2)} times what the model expects: {cause}"


def _worse(loads: Loads, before: Floats, after: Floats) -> str:
    worst = int(after.argmax())
    return (
        "nothing was written: a model fitted to these loads would be worse. A fit locates left-out loads to "
        f"{digits(after.mean(), 4)} mm, the given model to {digits(before.mean(), 4)} mm. The largest error is that "
        f"of {loads.in_words(worst)}, {digits(after[worst], 3)} mm. Keep the model, or check the loads and record more "
        f"over the whole {'beam' if loads.place_mm.shape[1] == 1 else 'plate'}"
    )


def rebuilt(
    metadata: Metadata, prior: Prior, calibration: Calibration, progress: Progress, effort: Effort = USUAL
) -> tuple[bytes, Metadata]:
    """Return the file of a model with another prior, and its metadata; the prior holds the departures.

    Raises
    ------
    ModelFileError
        This version does not have the model's estimator.
    """
    made = remade(metadata, prior, calibration, lambda done: progress("making the estimator", 0.7 + 0.1 * done), effort)
    progress("measuring the accuracy against the limit", 0.85)
    surface = resolve_model(metadata)
    noise_mm, departures = surface.readings.sensor_mm, calibration.departures
    world = World.of(surface.scene, metadata.sensor, metadata.layout_mm, noise_mm, departures)
    aim = Aim(metadata.placed.criterion, metadata.placed.failed_percent, effort=effort)
    fields = measure(made, prior, surface, world, metadata.seed, aim)
    fresh = metadata.model_copy(update={**vars(fields), "calibration": calibration})
    return to_bytes(made.graph, fresh), fresh


def remade(
    metadata: Metadata,
    prior: Prior,
    calibration: Calibration,
    progress: Fraction = silent,
    effort: Effort = USUAL,
) -> Estimator:
    """Return the estimator of a model for another prior; raises as `rebuilt`."""
    name = next((known for known in ESTIMATORS if known == metadata.estimator), None)
    if name is None:
        raise ModelFileError(f"this version has no estimator {metadata.estimator!r}; build the model again")
    with_force = "force_n" in metadata.golden.answers
    min_noise_mm = metadata.filter.min_noise_mm(metadata.noise)
    made = estimator_of(
        name,
        prior,
        min_noise_mm=min_noise_mm,
        with_force=with_force,
        seed=metadata.seed,
        progress=progress,
        effort=effort,
    )
    departures = calibration.departures
    graph = with_linear_input(made.graph, np.array(departures.offset_mm), departures.curve_per_mm)
    return replace(made, graph=with_force_error(graph, calibration.force_error))
