"""Noise of the readings of a beam at rest, the drift of their zeros, and the keys that state both. Pure.

A recording is divided into blocks. The scatter within blocks is noise, the difference between blocks is drift. Noise
that stays alike over several readings averages away more slowly than white noise. So the configured filter runs over
the recording, and the scatter of what it gives is measured too.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.signal import GrowingMean
from beamtouch_daemon.config.value_types import WHOLE
from beamtouch_daemon.measuring.at_rest import without_line
from beamtouch_daemon.processing import resolution, stuck
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.filters import mean_of
from beamtouch_daemon.processing.stuck import Runs
from beamtouch_models.filters import PERSISTS_S, Chain, FloatArray, Mean

MIN_READINGS = 500
INDEPENDENT = 100
"""Smallest numbers of readings, and of independent filtered values: these give the noise within 7 %."""
MIN_BLOCKS, MAX_BLOCKS = 5, 30
BLOCK_MEANS = 20
"""Number of independent filtered values that a block should hold."""
COLOURED = 1.2
"""Effective noise over that of a reading from which noise is not white. A short recording may give white noise 1.1."""
ROUNDED = 0.3
"""Largest variance of readings whose noise is hidden by the ADC's steps, in squared steps.

Readings that take two neighbouring values have a variance of up to 0.25, however small the noise is. With a noise of
half a step the variance is 0.33.
"""
GROWN = 50
"""Readings of a growing mean that show how the noise averages away."""
ZERO_SHARE = 0.2
"""Least drift of a zero, as a part of the noise, as in a scene: a recording shows only its own time."""
FEWEST_MINUTES = 20
"""Minutes of a recording from which on it says how fast zeros drift."""
STEPS_MATTER = 0.1
"""Steps are stated if their rounding is more than this part of the noise."""
HIDDEN = 0.02
"""Noise that is stated where the steps hide it, in steps: it is too small to average the rounding away."""
REPEATED = 2.0
"""Readings that repeat so often on average are read faster than they are measured; noise of a step makes it 1.5."""
RESOLVED = 0.01
"""Least step of fractional numbers, as a part of the noise. Between a thousand readings without steps, changes are
smaller."""
MIN_BITS, MAX_BITS = 6, 16
"""Values of `adc_bits` that a scene accepts."""
RUNS_DIFFER = 1.5
"""`stuck_after_ms` is stated for a channel whose counts may stay equal for this many times as long as noise says."""
MAX_STUCK_MS = 3_600_000.0
"""Largest `stuck_after_ms` that is stated: an hour."""
DIGITS = 3


@dataclass(frozen=True)
class ChannelNoise:
    """The noise of one channel."""

    channel: str
    noise_mm: float
    """Standard deviation of a reading, without drift."""
    correlated_readings: float
    """Number of readings that are worth one independent reading; about 1 for white noise."""
    effective_noise_mm: float
    """Noise of white readings whose filtered values would scatter as the measured ones do."""
    fast_noise_mm: float
    """Noise of white readings that differ from one to the next as much as the measured ones."""
    drift_mm: float
    """Standard deviation of the zero against the beginning or the end of the recording."""
    drift_mm_per_min: float | None
    """How fast the zero drifts, as a standard deviation; None for a recording that is too short to say."""
    step_mm: float
    """Step of the readings, or of the conversions in them if these hide the noise; 0 where floats show none."""
    is_rounded: bool
    """True if the steps hide the noise: then no mean of readings comes closer than the rounding."""
    longest_run: int
    """Largest number of equal counts in a row."""
    mean_run: float
    """Mean number of equal counts in a row."""
    readings: int
    """Number of readings in the recording."""

    @property
    def is_repeated(self) -> bool:
        """True if counts repeat more often than steps make them."""
        return not self.is_rounded and self.mean_run >= REPEATED

    @property
    def is_coloured(self) -> bool:
        """True if filtered values scatter clearly more than those of white readings."""
        return self.effective_noise_mm > COLOURED * self.noise_mm


@dataclass(frozen=True)
class Keys:
    """Values by key, rounded up, in the units of the keys."""

    daemon_noise_mm: float
    """`noise_mm` of the surface."""
    stuck_after_ms: dict[str, float]
    """`stuck_after_ms` by channel, where the noise would find a working channel stuck."""
    scene_noise_mm: float
    """`[sensors] noise_mm`: without the steps if `adc_bits` states them."""
    zero_drift_mm: float
    """`[sensors] zero_drift_mm`."""
    drift_um_per_min: float | None
    """`[environment] drift_um_per_min`, and that of `zero_tracking`; None for a recording that is too short."""
    adc_bits: int | None
    """`[sensors] adc_bits`, if the steps matter."""


def readings_needed(surface: Surface) -> int:
    """Return the smallest number of readings in a recording."""
    return max(MIN_READINGS, math.ceil(INDEPENDENT * _averaged(surface)))


def measure_noise(counts: FloatArray, surface: Surface) -> list[ChannelNoise]:
    """Return the noise of each channel.

    Parameters
    ----------
    counts : Counts at rest without missing ones, shape (readings, channels); at least `readings_needed`.
    surface : The configuration.
    """
    characteristic = Characteristic.of(surface)
    number = int(np.clip(len(counts) / (BLOCK_MEANS * _averaged(surface)), MIN_BLOCKS, MAX_BLOCKS))
    length = len(counts) // number
    counts = counts[: number * length]
    gaps = characteristic.gap(counts)
    residual = without_line(gaps)
    # Neighbouring blocks differ by noise, and hardly by drift (Allan, 1966). A block's mean takes its noise with it.
    of_block = np.mean(np.diff(_blocks(residual, number).mean(axis=1), axis=0) ** 2, axis=0) / 2
    variance = np.var(_blocks(residual, number), axis=1).mean(axis=0) + of_block
    effective = np.maximum(variance, _effective_mm2(residual, number, of_block, surface))
    fast = np.mean(np.diff(residual, axis=0) ** 2, axis=0) / 2
    means = _blocks(gaps, number).mean(axis=1)
    apart = ((means - means[0]) ** 2 + (means - means[-1]) ** 2).mean(axis=0) / 2
    drift = np.sqrt(np.maximum(apart - 2 * of_block * (1 - 1 / number), 0.0))
    rates = _drift_mm_per_min(gaps, of_block * length, surface.rate_hz)
    shown = resolution.steps_shown(counts, surface)
    runs = Runs.of(surface).lengths(counts)
    channels = []
    for index, channel in enumerate(surface.channels):
        slope = float(characteristic.steepest[index])
        if surface.has_fractions[index]:
            is_step = RESOLVED * math.sqrt(variance[index]) <= shown[index] * slope < math.inf
            fine = coarse = float(shown[index]) if is_step else 0.0
        else:
            fine = float(shown[index]) if math.isfinite(shown[index]) else WHOLE
            coarse = max(WHOLE, fine * surface.conversions)
        is_rounded = bool(variance[index] * surface.conversions <= ROUNDED * (coarse * slope) ** 2)
        channels.append(
            ChannelNoise(
                channel.name,
                noise_mm=math.sqrt(variance[index]),
                correlated_readings=float(of_block[index] * length / variance[index]) if variance[index] else 1.0,
                effective_noise_mm=math.sqrt(effective[index]),
                fast_noise_mm=math.sqrt(fast[index]),
                drift_mm=float(drift[index]),
                drift_mm_per_min=None if rates is None else float(rates[index]),
                step_mm=slope * (coarse if is_rounded else fine),
                is_rounded=is_rounded,
                longest_run=int(runs[:, index].max()),
                mean_run=len(counts) / np.count_nonzero(runs[:, index] == 1),
                readings=len(counts),
            )
        )
    return channels


def keys_of(channels: Sequence[ChannelNoise], surface: Surface) -> Keys:
    """Return the keys that state the noise of all channels, which is that of the noisiest one.

    A mean of readings has the stated variance, noise squared over the number of readings, in the configured filter. The
    rounding of an ADC that is coarser than the noise stays in every mean: a scene states it by `adc_bits` and a smaller
    noise. The daemon does not know the steps of fractional numbers. Their noise is half a step at least, as readings
    that take two values would be motion to the filter.
    """
    step = max(channel.step_mm for channel in channels)
    rounding = step / math.sqrt(12)
    loud = [channel.effective_noise_mm for channel in channels if not channel.is_rounded or channel.is_coloured]
    noise = max(loud) if loud else math.hypot(HIDDEN * step, rounding) / math.sqrt(surface.conversions)
    unknown = [channel.step_mm for channel, is_float in zip(channels, surface.has_fractions, strict=True) if is_float]
    noise = max(noise, max(unknown, default=0.0) / 2)
    rates = [channel.drift_mm_per_min for channel in channels if channel.drift_mm_per_min is not None]
    # What is followed at each rest is no drift since the last tare, but for the time of an ordinary contact.
    followed = [rate * PERSISTS_S / 60 for rate in rates]
    drift = max(ZERO_SHARE * noise, *(followed or (channel.drift_mm for channel in channels)))
    bits = _bits(surface, step) if rounding > STEPS_MATTER * noise and not unknown else None
    sensor = math.sqrt(max(noise**2 - rounding**2, 0.0)) if loud else HIDDEN * step
    if any(channel.is_rounded for channel in channels) and (loud or bits is None):
        # A scene would take such noise to average the rounding away, but it does not. The tare is rounded too.
        drift = math.hypot(drift, math.sqrt(2) * rounding)
    return Keys(
        daemon_noise_mm=round_up(noise),
        stuck_after_ms=_stuck_after_ms(channels, noise, surface),
        scene_noise_mm=round_up(noise if bits is None else sensor),
        zero_drift_mm=round_up(drift),
        drift_um_per_min=round_up(1e3 * max(rates)) if rates else None,
        adc_bits=bits,
    )


def round_up(value: float) -> float:
    """Return the value with three digits, never less than it."""
    if value == 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - DIGITS + 1)
    return float(f"{math.ceil(value / unit * (1 - 1e-9)) * unit:.{DIGITS}g}")


def _averaged(surface: Surface) -> float:
    """Return the number of independent readings whose mean is as precise as a filtered value at rest."""
    return float(_mean_at_rest(surface).window)


def _mean_at_rest(surface: Surface) -> Mean:
    """Return the configured mean; at rest, a growing mean is a moving average, of which a part shows the noise."""
    if isinstance(surface.filter, GrowingMean):
        return Mean("moving-average", min(surface.filter.longest(surface.rate_hz), GROWN))
    return mean_of(surface.filter, surface.rate_hz)


def _effective_mm2(residual: FloatArray, number: int, of_block: FloatArray, surface: Surface) -> FloatArray:
    """Return the variance of white readings whose filtered values scatter as much, shape (channels,)."""
    filtered = Chain(_mean_at_rest(surface), len(surface.channels)).apply(residual)
    relative = filtered.relative_variance
    settled = int((relative == np.nanmin(relative)).all(axis=1).argmax())  # the window is full
    values = filtered.mean_mm.copy()
    values[:settled] = np.nan
    scatter = np.nanvar(_blocks(values, number), axis=1).mean(axis=0) + of_block
    effective: FloatArray = scatter / np.nanmean(relative[settled:], axis=0)
    return effective


def _drift_mm_per_min(gap_mm: FloatArray, of_reading_mm2: FloatArray, rate_hz: float) -> FloatArray | None:
    """Return how far zeros (channels,) drift in a minute, as standard deviations; None for too short a recording.

    `of_reading_mm2` is the variance of independent readings whose means scatter as much.
    """
    minute = round(60 * rate_hz)
    number = len(gap_mm) // minute
    if number < FEWEST_MINUTES:
        return None
    moved = np.diff(_blocks(gap_mm[: number * minute], number).mean(axis=1), axis=0)
    rates: FloatArray = np.sqrt(np.maximum((moved**2).mean(axis=0) - 2 * of_reading_mm2 / minute, 0.0))
    return rates


def _blocks(values: FloatArray, number: int) -> FloatArray:
    return values.reshape(number, -1, values.shape[1])


def _bits(surface: Surface, step_mm: float) -> int | None:
    """Return the largest number of bits whose steps over the linear range are no smaller than the measured ones.

    In a scene the linear range takes the middle 80 % of the ADC's scale.
    """
    low, high = surface.channels[0].range_mm
    bits = math.floor(math.log2((high - low) / (0.8 * step_mm) + 1) + 1e-6)
    return min(bits, MAX_BITS) if bits >= MIN_BITS else None


def _stuck_after_ms(channels: Sequence[ChannelNoise], noise_mm: float, surface: Surface) -> dict[str, float]:
    """Return the time for which counts may stay equal, by channel, where the stated noise allows much less."""
    times = {}
    for channel, step_mm in zip(channels, stuck.steps_mm(surface, noise_mm).tolist(), strict=True):
        stated, own = stuck.longest_run(noise_mm / step_mm, surface.rate_hz), _longest_run(channel, surface)
        if own > RUNS_DIFFER * stated:
            times[channel.channel] = min(round_up(1e3 * min(own, MAX_STUCK_MS) / surface.rate_hz), MAX_STUCK_MS)
    return times


def _longest_run(channel: ChannelNoise, surface: Surface) -> float:
    """Return the longest run of equal counts that a working channel may have; inf if it may never end.

    A module that is read faster than it measures repeats itself. A run that comes about once in a recording stands for
    one that is much longer and never comes.
    """
    if channel.is_rounded:
        return math.inf
    repeated = channel.longest_run * math.log(stuck.CHANCE) / math.log(1 / channel.readings)
    by_steps = stuck.longest_run(channel.fast_noise_mm / channel.step_mm, surface.rate_hz) if channel.step_mm else 0.0
    return max(repeated, by_steps)
