"""Noise of the readings of a beam at rest: their scatter, its correlation in time, and the drift of their zeros.

A recording is divided into blocks. The scatter within blocks is noise, the difference between blocks is drift. Noise
that stays alike over several readings averages away more slowly than white noise. So the configured filter runs over
the recording, and the scatter of what it gives is measured too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_daemon.config.places import encoding_of
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.signal import GrowingMean
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.correlations import summed_correlations, without_line
from beamtouch_daemon.processing.filters import stages
from beamtouch_models.filters import Chain, FloatArray, Stage, moving_average_stage

MIN_READINGS = 500
INDEPENDENT = 100
"""Smallest numbers of readings, and of independent filtered values: these give the noise within 7 %."""
MIN_BLOCKS, MAX_BLOCKS = 5, 30
BLOCK_MEANS = 20
"""Number of independent readings, and of independent filtered values, that a block should hold."""
COLOURED = 1.2
"""Effective noise over that of a reading from which noise is not white. A short recording may give white noise 1.1."""
ROUNDED = 0.3
"""Largest variance of readings whose noise is hidden by the ADC's steps, in squared steps.

Readings that take two neighbouring values have a variance of up to 0.25, however small the noise is. With a noise of
half a step the variance is 0.33.
"""
GROWN = 50
"""Readings of a growing mean that show how the noise averages away."""


@dataclass(frozen=True)
class ChannelNoise:
    """The noise of one channel."""

    channel: str
    noise_mm: float
    """Standard deviation of a reading, without drift."""
    correlated_readings: float
    """Number of readings that are worth one independent reading; 1 for white noise."""
    effective_noise_mm: float
    """Noise of white readings whose filtered values would scatter as the measured ones do."""
    fast_noise_mm: float
    """Noise of white readings that differ from one to the next as much as the measured ones."""
    drift_mm: float
    """Standard deviation of the zero against the beginning or the end of the recording."""
    step_mm: float
    """Step of the readings, or of the conversions in them if these hide the noise; 0 for fractional numbers."""
    is_rounded: bool
    """Whether the ADC's steps hide the noise: then no mean of readings comes closer than its rounding."""

    @property
    def is_coloured(self) -> bool:
        """Whether filtered values scatter clearly more than those of white readings."""
        return self.effective_noise_mm > COLOURED * self.noise_mm


def averaged(surface: Surface) -> float:
    """Return the number of independent readings whose mean is as precise as a filtered value at rest."""
    chosen = _at_rest(surface)
    rows = max(stage.span + stage.memory for stage in chosen) if chosen else 1
    return float(1 / np.nanmin(Chain(chosen, 1).apply(np.zeros((rows, 1))).relative_variance))


def _at_rest(surface: Surface) -> tuple[Stage, ...]:
    """Return the configured filters; at rest, a growing mean is a moving average, of which a part shows the noise."""
    if isinstance(surface.filter, GrowingMean):
        return (moving_average_stage(min(surface.filter.longest(surface.rate_hz), GROWN)),)
    return stages(surface.filter, surface.rate_hz, np.ones(len(surface.channels)))


def readings_needed(surface: Surface) -> int:
    """Return the smallest number of readings in a recording."""
    return max(MIN_READINGS, math.ceil(INDEPENDENT * averaged(surface)))


def measured(counts: FloatArray, surface: Surface) -> list[ChannelNoise]:
    """Return the noise of each channel.

    Parameters
    ----------
    counts
        Counts at rest without missing ones, shape (readings, channels); at least `readings_needed`.
    surface
        The configuration.
    """
    characteristic = Characteristic.of(surface.channels)
    number = _blocks_for(without_line(characteristic.gap(counts)), averaged(surface))
    length = len(counts) // number
    counts = counts[: number * length]
    gaps = characteristic.gap(counts)
    residual = without_line(gaps)
    summed, own = summed_correlations(_blocks(residual, number))
    # The mean of a block takes its own noise out of the block.
    of_block = summed / length
    variance = own + of_block
    effective = np.maximum(variance, _effective_mm2(residual, number, of_block, surface))
    fast = np.mean(np.diff(residual, axis=0) ** 2, axis=0) / 2
    drift = _drift_mm(_blocks(gaps, number).mean(axis=1), of_block)
    made = []
    for index, channel in enumerate(surface.channels):
        fine, coarse = _steps(counts[:, index], surface, index)
        slope = float(characteristic.steepest[index])
        is_rounded = bool(variance[index] * surface.conversions <= ROUNDED * (coarse * slope) ** 2)
        made.append(
            ChannelNoise(
                channel.name,
                noise_mm=math.sqrt(variance[index]),
                correlated_readings=float(summed[index] / variance[index]) if variance[index] else 1.0,
                effective_noise_mm=math.sqrt(effective[index]),
                fast_noise_mm=math.sqrt(fast[index]),
                drift_mm=float(drift[index]),
                step_mm=slope * (coarse if is_rounded else fine),
                is_rounded=is_rounded,
            )
        )
    return made


def _effective_mm2(residual: FloatArray, number: int, of_block: FloatArray, surface: Surface) -> FloatArray:
    """Return the variance of white readings whose filtered values scatter as much, shape (channels,).

    Parameters
    ----------
    residual
        Gaps without their trend [mm], shape (readings, channels).
    number
        Number of blocks in it.
    of_block
        Variance of the mean of a block [mm^2], shape (channels,).
    surface
        The configuration.
    """
    filtered = Chain(_at_rest(surface), len(surface.channels)).apply(residual)
    relative = filtered.relative_variance
    settled = int(np.flatnonzero(relative[:, 0] <= 1.01 * np.nanmin(relative[:, 0]))[0])
    values = filtered.mean_mm.copy()
    values[:settled] = np.nan
    scatter = np.nanvar(_blocks(values, number), axis=1).mean(axis=0) + of_block
    effective: FloatArray = scatter / relative[settled:].mean(axis=0)
    return effective


def _blocks_for(residual: FloatArray, window: float) -> int:
    """Return the number of blocks that are long against the filter's window and the correlation of the noise."""
    summed, own = summed_correlations(_blocks(residual, 1))
    alike = float(np.divide(summed, own, out=np.ones_like(own), where=own > 0).max())
    return int(np.clip(len(residual) / (BLOCK_MEANS * max(window, alike)), MIN_BLOCKS, MAX_BLOCKS))


def _blocks(values: FloatArray, number: int) -> FloatArray:
    return values.reshape(number, -1, values.shape[1])


def _drift_mm(means: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the standard deviation of a zero against the first and the last one, shape (channels,).

    Parameters
    ----------
    means
        Means of blocks [mm], shape (blocks, channels).
    variance
        Variance of their noise [mm^2], shape (channels,).
    """
    apart = ((means - means[0]) ** 2 + (means - means[-1]) ** 2).mean(axis=0) / 2
    drift: FloatArray = np.sqrt(np.maximum(apart - 2 * variance * (1 - 1 / len(means)), 0.0))
    return drift


def _steps(counts: FloatArray, surface: Surface, index: int) -> tuple[float, float]:
    """Return the step of a reading and that of a conversion in it, in counts; zeros for fractional numbers."""
    if encoding_of(surface.source, surface.channels[index]) == "f32":
        return 0.0, 0.0
    found: Sequence[float] = np.diff(np.unique(counts)).tolist()
    fine = min(found, default=1.0)
    return fine, max(1.0, fine * surface.conversions)
