"""Stuck channels: counts that have not changed for longer than noise allows.

Of a value in the middle of a count, with Gaussian noise of s counts, a reading gives that count with the chance
q = erf(0.5 / (s sqrt(2))); of any other value with less. So n equal readings in a row come about by chance with q^n at
most, and a run longer than n = ln(1e-12) / ln(q) is not noise. Counts with a fraction, from readings that are means of
several conversions, repeat less often than whole ones, so the same n is on the safe side.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_daemon.config.signal import Channel

FloatArray = NDArray[np.float64]

CHANCE = 1e-12
"""The chance of a run that noise makes and that is taken for a stuck channel."""
LONGEST_S = 10.0
"""If noise allows longer runs than this, as it is small beside a count, a channel is not judged by it."""

ROUNDING = 1 / math.sqrt(12)
"""Standard deviation of rounding to whole counts [counts]; Widrow & Kollar, Quantization Noise, 2008, sec. 1.2."""


def longest_runs(
    channels: Sequence[Channel], steepest_mm: FloatArray, noise_mm: float | None, rate_hz: float
) -> FloatArray:
    """Return how many equal counts in a row each channel may give, shape (channels,); inf where it is not judged.

    Parameters
    ----------
    channels
        Those with `stuck_after_ms` are judged by it.
    steepest_mm
        The largest change of the gap with one count [mm], shape (channels,): where the noise is the fewest counts.
    noise_mm
        Standard deviation of one reading [mm], None if unknown.
    rate_hz
        Readings per second.
    """
    return np.array(
        [
            longest_run(0.0 if noise_mm is None else noise_mm / step, rate_hz)
            if channel.stuck_after_ms is None
            else max(1.0, math.ceil(channel.stuck_after_ms * rate_hz / 1e3))
            for channel, step in zip(channels, steepest_mm.tolist(), strict=True)
        ]
    )


def longest_run(noise_counts: float, rate_hz: float) -> float:
    """Return how many equal counts in a row the noise of a reading [counts] allows; inf where nothing can be said.

    The noise of a reading contains that of rounding to whole counts, which by itself makes no count change.
    """
    if noise_counts <= ROUNDING:
        return math.inf
    before_rounding = math.sqrt(noise_counts - ROUNDING) * math.sqrt(noise_counts + ROUNDING)
    repeat = math.erf(0.5 / (before_rounding * math.sqrt(2)))
    if not 0 < repeat < 1:
        return math.inf
    run = math.ceil(math.log(CHANCE) / math.log(repeat))
    return run if run <= LONGEST_S * rate_hz else math.inf


def fresh(channels: int) -> FloatArray:
    """Return the state of `runs` that has seen nothing."""
    return np.stack([np.full(channels, np.nan), np.zeros(channels)])


def runs(counts: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how many equal counts in a row each reading ends, itself included, and the state after them.

    A missing count, NaN, neither adds to a run nor ends it. It is the same for any split of the stream.

    Parameters
    ----------
    counts
        Shape (readings, channels), oldest first.
    state
        Shape (2, channels): the last count that was there, and the length of the run it ended.
    """
    rows = np.concatenate([state[:1], counts])
    there = ~np.isnan(rows)
    latest = np.maximum.accumulate(np.where(there, np.arange(len(rows))[:, np.newaxis], 0))
    held = np.take_along_axis(rows, latest, axis=0)  # each count, or the last one before it that was there
    arrived = np.cumsum(there[1:], axis=0)
    begins = there[1:] & (counts != held[:-1])
    before = np.maximum.accumulate(np.where(begins, arrived - 1.0, -state[1]), axis=0)
    lengths = arrived - before
    return lengths, np.stack([held[-1], np.concatenate([state[1:], lengths])[-1]])
