"""Stuck channels: counts that have not changed for longer than noise allows.

Let the noise be Gaussian with a standard deviation of s counts. A value in the middle of a count then reads as that
count with probability q = erf(0.5 / (s sqrt(2))), and any other value with a lower probability. So n equal readings in
a row have a probability of at most q^n, and a run longer than n = ln(1e-12) / ln(q) is not noise. Means of several
conversions have fractions and repeat less often, so the same n is safe for them too.

The type of a fractional number (f32, f64) does not say how large a count is. It is taken to be as large as the noise:
an ADC whose steps are larger hides the noise, and `beamtouch-daemon noise` then states a longer time.
"""

import math
from typing import Self

import numpy as np

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing import resolution
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_models.filters import FloatArray

CHANCE = 1e-12
"""Probability that noise alone makes a channel look stuck."""
MAX_RUN_S = 10.0
"""If the noise is so small that longer runs than this are normal, the channel is not judged by its noise."""

ROUNDING = 1 / math.sqrt(12)
"""Standard deviation of rounding to whole counts [counts]; Widrow & Kollar, Quantization Noise, 2008, sec. 1.2."""


def longest_runs(surface: Surface) -> FloatArray:
    """Return the longest normal run of equal counts of each channel, shape (channels,); inf if it is not judged.

    Channels with `stuck_after_ms` are judged by that time, the others by the noise of a reading, if it is known.
    """
    noise_mm = surface.noise_mm or 0.0
    return np.array(
        [
            longest_run(noise_mm / step_mm, surface.rate_hz)
            if channel.stuck_after_ms is None
            else math.ceil(channel.stuck_after_ms * surface.rate_hz / 1e3)
            for channel, step_mm in zip(surface.channels, steps_mm(surface, noise_mm).tolist(), strict=True)
        ]
    )


def steps_mm(surface: Surface, noise_mm: float) -> FloatArray:
    """Return the steps by which runs are judged with this noise of a reading [mm], shape (channels,).

    They are those where the characteristic is steepest: there the noise in counts is smallest.
    """
    count_mm = Characteristic.of(surface).steepest
    finest_mm = 2 * resolution.tolerance(surface) * count_mm  # equal counts lie up to the tolerance on either side
    return np.where(surface.has_fractions, np.maximum(noise_mm, finest_mm), count_mm)


def longest_run(noise_counts: float, rate_hz: float) -> float:
    """Return the longest run of equal counts that the noise of a reading [counts] allows; inf if it gives no limit.

    The noise of a reading includes that of rounding to whole counts, which alone changes no count.
    """
    if noise_counts <= ROUNDING:
        return math.inf
    before_rounding = math.sqrt(noise_counts - ROUNDING) * math.sqrt(noise_counts + ROUNDING)
    repeat = math.erf(0.5 / (before_rounding * math.sqrt(2)))
    if not 0 < repeat < 1:
        return math.inf
    run = math.ceil(math.log(CHANCE) / math.log(repeat))
    return run if run <= MAX_RUN_S * rate_hz else math.inf


class Runs:
    """The runs of equal counts of all channels. Any split of the stream of readings gives the same lengths.

    `tolerance` (channels,) is the largest change from one count to the next with which they are equal.
    """

    def __init__(self, tolerance: FloatArray) -> None:
        self._tolerance = tolerance
        self._last = np.full(len(tolerance), np.nan)
        """The last count of each channel that was not missing."""
        self._length = np.zeros(len(tolerance))

    @classmethod
    def of(cls, surface: Surface) -> Self:
        """Return the runs of a surface, before its first reading."""
        return cls(resolution.tolerance(surface))

    def lengths(self, counts: FloatArray) -> FloatArray:
        """Return the length of the run that ends with each reading, shape (readings, channels) as the counts.

        A missing count (NaN) neither extends a run nor ends it.
        """
        rows = np.concatenate([self._last[np.newaxis], counts])
        if len(counts) and not np.isnan(rows.sum()):  # the usual case, in half the time
            held, arrived = rows, np.arange(1.0, len(rows))[:, np.newaxis]
            begins = np.abs(rows[1:] - rows[:-1]) > self._tolerance
        else:
            there = ~np.isnan(rows)
            latest = np.maximum.accumulate(np.where(there, np.arange(len(rows))[:, np.newaxis], 0))
            held = np.take_along_axis(rows, latest, axis=0)  # each count, or the last one before it that was there
            arrived = np.cumsum(there[1:], axis=0)
            is_equal = np.abs(counts - held[:-1]) <= self._tolerance  # False for the first count, after NaN
            begins = there[1:] & ~is_equal
        lengths: FloatArray = arrived - np.maximum.accumulate(np.where(begins, arrived - 1.0, -self._length), axis=0)
        self._last, self._length = held[-1], np.concatenate([self._length[np.newaxis], lengths])[-1]
        return lengths
