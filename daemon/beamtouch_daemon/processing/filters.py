"""The configured filters, a chain of those in `beamtouch_models.filters`, and the uncertainty of what they give."""

import math
from typing import NamedTuple

import numpy as np

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.signal import Filter, GrowingMean, MovingAverage
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_models import filters
from beamtouch_models.filters import Chain, Filtered, FloatArray, Rest, Stage

PLAIN = (0.9, 1.02)
"""No covariance is stated while the variance is within these factors of that of a mean of the stated readings."""
DIGITS_BELOW_NOISE = 1e-4
"""Entries are rounded to this part of the variance of the noise, so that rounding never makes the matrix indefinite."""
MAX_DIGITS = 300
"""Beyond it, entries are not rounded."""
SIGNIFICANT = 1e-12
"""Without noise, entries are rounded to this part of the largest one."""


def chain_of(surface: Surface) -> Chain:
    """Return the configured filters of a surface, with its noise, its steps and the period of its slowest motion."""
    channels, steps = len(surface.channels), steps_mm(surface)
    unit_mm = filters.unit_of(surface.noise_mm or 0.0, steps, channels)
    period = (surface.slowest_period_ms or 0.0) * surface.rate_hz / 1e3
    chosen = stages(surface.filter, surface.rate_hz, unit_mm, period)
    return Chain(chosen, channels, surface.noise_mm, period, steps)


def rest_of(surface: Surface) -> Rest | None:
    """Return what notices that nothing happens.

    None if the noise is not known, as nothing then says what motion is; and for a filter other than the growing mean,
    which does not show a touch that came and went between two samples.
    """
    if surface.noise_mm is None or not isinstance(surface.filter, GrowingMean):
        return None
    unit_mm = filters.unit_of(surface.noise_mm, steps_mm(surface), len(surface.channels))
    period = (surface.slowest_period_ms or 0.0) * surface.rate_hz / 1e3
    return Rest(unit_mm, surface.filter.longest(surface.rate_hz), period)


def steps_mm(surface: Surface) -> FloatArray:
    """Return the steps of the readings [mm], shape (channels,); 0 for a channel whose counts are fractional numbers.

    A mean of n conversions scatters like a reading with steps that are sqrt(n) times smaller.
    """
    steps = Characteristic.of(surface.channels).steepest / math.sqrt(surface.conversions)
    return np.where(surface.has_fractions, 0.0, steps)


def stages(settings: Filter, rate_hz: float, unit_mm: FloatArray, slowest_period: float = 0.0) -> tuple[Stage, ...]:
    """Return the configured filters, in the order in which they apply.

    `unit_mm` is the noise of each channel, and `slowest_period` that of the beam, in readings.
    """
    mean = settings if isinstance(settings, MovingAverage | GrowingMean) else None
    return filters.chosen_stages(
        mean.kind if mean else "none",
        window=mean.window if mean else 1,
        longest=settings.longest(rate_hz) if isinstance(settings, GrowingMean) else 1,
        spike_mm=settings.spike_mm,
        unit_mm=unit_mm,
        slowest_period=slowest_period,
    )


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
    if not filtered.uncertain.any() and variance.min() == variance.max():
        readings = math.floor(1 / variance[0, 0] + 1e-6)
        if PLAIN[0] <= variance[0, 0] * readings <= PLAIN[1]:
            return [Uncertainty(readings, None)] * samples
    # The median that replaces a spike may be noisier than a reading. Then the covariance says so.
    number = np.maximum(np.floor(filtered.readings + 1e-6), 1.0)  # NaN stays NaN
    relative = variance * number[:, np.newaxis]
    differs = (relative < PLAIN[0]) | (relative > PLAIN[1])  # False for NaN
    results = [UNKNOWN if math.isnan(readings) else Uncertainty(int(readings), None) for readings in number.tolist()]
    stated = np.flatnonzero(filtered.uncertain | differs.any(axis=1))
    if len(stated):
        row, column = np.tril_indices(filtered.mean_mm.shape[1])
        triangles, least = filtered.covariances_mm2(stated)[:, row, column], float(filtered.noise_mm.min())
        for index, triangle in zip(stated.tolist(), triangles, strict=True):
            readings = results[index].readings
            if readings is not None:
                results[index] = Uncertainty(readings, _rounded(triangle, least**2 / readings))
    return results


def _rounded(triangle: FloatArray, white_mm2: float) -> list[float]:
    """Return a triangle with the fewest digits that keep the matrix positive; `white_mm2` is its noise variance."""
    quantum = max(DIGITS_BELOW_NOISE * white_mm2, SIGNIFICANT * float(triangle.max()))
    digits = -math.floor(math.log10(quantum)) if quantum > 0 else 0
    values: list[float] = (np.round(triangle, digits) if 0 < digits < MAX_DIGITS else triangle).tolist()
    return values
