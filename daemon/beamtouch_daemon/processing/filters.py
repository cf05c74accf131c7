"""The configured filters, a chain of those in `beamtouch_models.filters`, and the uncertainty of what they give."""

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.signal import Filter, GrowingMean, MovingAverage, NoFilter
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_models import filters
from beamtouch_models.filters import Chain, Filtered, FloatArray, Mean, Rest, Walk

PLAIN = 1.02
"""No covariance is stated while the variance is within this factor of that of a mean of the stated readings."""
DIGITS_BELOW_NOISE = 1e-4
"""Entries are rounded to this part of the variance of the noise, so that rounding never makes the matrix indefinite."""
FAINTEST_MM2 = 1e-300
"""Entries that are smaller are not rounded."""
SIGNIFICANT = 1e-12
"""Without noise, entries are rounded to this part of the largest one."""


def chain_of(surface: Surface) -> Chain:
    """Return the configured filters of a surface, with its noise, its steps and the period of its slowest motion."""
    mean, period = mean_of(surface.filter, surface.rate_hz), slowest_period(surface)
    return Chain(mean, len(surface.channels), surface.noise_mm, period, steps_mm(surface), surface.unseen_swing)


def rest_of(surface: Surface) -> Rest | None:
    """Return what notices that nothing happens.

    None if the noise is not known, as nothing then says what motion is; and for a filter other than the growing mean,
    which does not show a touch that came and went between two samples.
    """
    if surface.noise_mm is None or not isinstance(surface.filter, GrowingMean):
        return None
    unit_mm = filters.unit_of(surface.noise_mm, steps_mm(surface), len(surface.channels))
    return Rest(unit_mm, surface.filter.longest(surface.rate_hz), slowest_period(surface))


def slowest_period(surface: Surface) -> float:
    """Return the period of the slowest motion of a surface, in readings; 0 if it is not stated."""
    return (surface.slowest_period_ms or 0.0) * surface.rate_hz / 1e3


def walk_of(surface: Surface) -> Walk | None:
    """Return how the zeros of a surface walk; None if it does not track them."""
    tracking = surface.zero_tracking
    if tracking is None:
        return None
    return Walk(tracking.drift_um_per_min / 1e3, tracking.max_mm, surface.zero_drift_mm)


def steps_mm(surface: Surface) -> FloatArray:
    """Return the steps of the readings [mm], shape (channels,); 0 for a channel of fractional numbers: not known.

    A mean of n conversions scatters like a reading with steps that are sqrt(n) times smaller.
    """
    steps = Characteristic.of(surface).steepest / math.sqrt(surface.conversions)
    return np.where(surface.has_fractions, 0.0, steps)


def mean_of(settings: Filter, rate_hz: float) -> Mean:
    """Return the configured mean at a rate of the readings."""
    match settings:
        case NoFilter():
            return Mean(settings.kind, spike_mm=settings.spike_mm)
        case MovingAverage():
            return Mean(settings.kind, settings.window, spike_mm=settings.spike_mm)
        case GrowingMean():
            return Mean(settings.kind, settings.window, settings.longest(rate_hz), settings.spike_mm)


class Uncertainty(NamedTuple):
    """The uncertainty of a sample."""

    readings: int | None
    """Number of readings in it; None if no channel has a value, or if the noise of a reading is not known."""
    covariance_mm2: list[float] | None
    """Lower triangle by rows; None if it is no more than the noise of a mean of `readings`."""


UNKNOWN = Uncertainty(None, None)


def uncertainties(filtered: Filtered) -> list[Uncertainty]:
    """Return the uncertainty of each sample."""
    samples = len(filtered.mean_mm)
    if filtered.noise_mm is None or not samples:
        return [UNKNOWN] * samples
    variance = filtered.relative_variance
    # False for NaN; the usual case, in half the time.
    if not filtered.uncertain.any() and (least := variance.min()) == variance.max():
        return [Uncertainty(round(1 / least), None)] * samples
    number = np.rint(filtered.readings)  # NaN stays NaN
    differs = variance * number[:, np.newaxis] > PLAIN  # False for NaN
    results = [UNKNOWN if math.isnan(readings) else Uncertainty(int(readings), None) for readings in number.tolist()]
    stated = np.flatnonzero(filtered.uncertain | differs.any(axis=1))
    if len(stated):
        triangles = filtered.covariances_mm2(stated)[:, *_triangle(filtered.mean_mm.shape[1])]
        rounded = _rounded(triangles, filtered.noise_mm.min() ** 2 / number[stated])
        for index, triangle in zip(stated.tolist(), rounded.tolist(), strict=True):
            if results[index].readings is not None:
                results[index] = Uncertainty(results[index].readings, triangle)
    return results


@cache
def _triangle(channels: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the entries of a lower triangle."""
    return np.tril_indices(channels)


def _rounded(triangles: FloatArray, white_mm2: FloatArray) -> FloatArray:
    """Return triangles (samples, entries) with the fewest digits that keep the matrices positive.

    `white_mm2` (samples,) are the variances of their noise; NaN leaves a triangle as it is.
    """
    quantum = np.maximum(DIGITS_BELOW_NOISE * white_mm2, SIGNIFICANT * triangles.max(axis=1))
    scale = 10.0 ** -np.floor(np.log10(np.where(quantum > FAINTEST_MM2, quantum, 1.0)))[:, np.newaxis]
    rounded: FloatArray = np.where(scale > 1, np.rint(triangles * scale) / scale, triangles)
    return rounded
