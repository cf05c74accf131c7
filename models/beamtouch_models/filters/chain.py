"""Several filters in succession: the means of the readings, and the covariance of these means."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from beamtouch_models.filters import means
from beamtouch_models.filters.filtered import Filtered
from beamtouch_models.filters.growing import GrowingMean
from beamtouch_models.filters.means import FloatArray
from beamtouch_models.filters.scatter import Scatter

BLOCK_VALUES = 500_000
"""Longer inputs are filtered in parts, so that the windows of a part fit in memory."""
MIN_FILL = 0.75
"""Part of the averaging window that good readings must fill before a channel has a value.

The noise of that first value is at most 1.15 times that of a full window. A single reading would be noisier still, and
could make a beam at rest look touched.
"""
LOW_PASS_SPAN = 8
"""A low-pass spans this many times 1 / a readings: exp(-8) of a step remains after them, a sixth of the noise of a
reading if the step was 500 times that noise."""
LAG_READINGS = 2
"""Smallest number of newest readings that are compared with the mean, in multiples of `fewest`. Fewer scatter too much
to show a lag."""
MOST_COMPARED = 8
"""Newest readings of a growing mean whose scatter is tested. The mean itself shows slower motion."""


@dataclass(frozen=True)
class Stage:
    """One filter with its parameters."""

    memory: int
    """Number of rows of its state."""
    step: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
    """Takes a signal and a state; returns the filtered signal and the next state."""
    span: int = 1
    """Number of readings from which a value can be made; 1 if the filter averages nothing."""
    restarts: bool = False
    """Whether the mean restarts at a step, so that the span is that of the readings in it."""
    fresh: Callable[[int], FloatArray] | None = None
    """Returns the initial state for so many channels; None: rows of NaN."""
    lone_spike_mm: float | None = None
    """Distance of a lone spike from the median, if the filter leaves out spikes itself; None: it does not."""
    lag_readings: int | None = None
    """Fewest newest readings whose distance from the mean counts as its lag; None: the mean is too short to lag."""


def spike_stage(limit_mm: float) -> Stage:
    """Return `spike` as a stage."""
    return Stage(means.SPIKE_MEMORY, partial(means.spike, limit_mm=limit_mm))


def moving_average_stage(window: int, needed: int = 1) -> Stage:
    """Return `moving_average` as a stage."""
    return Stage(window - 1, partial(means.moving_average, window=window, needed=needed), window)


def filled(window: int) -> int:
    """Return how many good readings a window needs for a value."""
    return math.ceil(MIN_FILL * window)


def low_pass_stage(factor: float) -> Stage:
    """Return `low_pass` as a stage."""
    return Stage(means.LOW_PASS_MEMORY, partial(means.low_pass, factor=factor), math.ceil(LOW_PASS_SPAN / factor))


def adaptive_stage(window: int, step_mm: float) -> Stage:
    """Return `adaptive` as a stage."""
    return Stage(window, partial(means.adaptive, window=window, step_mm=step_mm), window, restarts=True)


def unit_of(noise_mm: float | FloatArray, step_mm: float | FloatArray, channels: int) -> FloatArray:
    """Return the deviation (channels,) that readings at rest reach: their noise, or half a step of the ADC."""
    unit: FloatArray = np.broadcast_to(np.maximum(noise_mm, np.abs(step_mm) / 2), (channels,))
    return unit


def growing_mean_stage(
    longest: int, unit_mm: FloatArray, spike_mm: float | None = None, fewest: int = 1, slowest_period: float = 0.0
) -> Stage:
    """Return a growing mean as a stage; it leaves out spikes itself. The parameters are those of `GrowingMean`."""
    growing = GrowingMean(longest, unit_mm, spike_mm, fewest, slowest_period)
    spike = math.inf if spike_mm is None else spike_mm
    span = min(longest, MOST_COMPARED)
    return Stage(
        longest,
        growing.step,
        span,
        restarts=True,
        fresh=growing.fresh,
        lone_spike_mm=spike,
        lag_readings=max(MOST_COMPARED, LAG_READINGS * fewest),
    )


class Chain:
    """Several filters in succession, and their states.

    Parameters
    ----------
    chosen
        The filters, in the order in which they apply. One of them may average; filters that replace readings come
        before it.
    channels
        Number of channels.
    noise_mm
        Standard deviation of a reading, of all channels or of each; None if it is not known.
    slowest_period
        Period of the slowest motion of the beam, in readings; 0 if it is not known.
    step_mm
        Step of the ADC, of all channels or of each; 0 if it is not known. Readings that take two neighbouring values
        deviate by up to half a step, however small the noise is, and that is no motion.
    """

    def __init__(
        self,
        chosen: tuple[Stage, ...],
        channels: int,
        noise_mm: float | FloatArray | None = None,
        slowest_period: float = 0.0,
        step_mm: float | FloatArray = 0.0,
    ) -> None:
        self._stages = chosen
        self._channels = channels
        self._noise_mm = None if noise_mm is None else np.broadcast_to(np.asarray(noise_mm, np.float64), (channels,))
        averaging = next((stage for stage in chosen if stage.span > 1), Stage(0, _unchanged))
        self._restarts = averaging.restarts
        self._scatter: Scatter | None = None
        if self._noise_mm is not None:
            usual_mm = unit_of(self._noise_mm, step_mm, channels)
            self._scatter = Scatter(
                averaging.span,
                slowest_period,
                usual_mm,
                restarts=averaging.restarts,
                spike_mm=averaging.lone_spike_mm,
                lag_readings=averaging.lag_readings,
            )
        longest = max([1, *(stage.memory for stage in chosen), self._scatter.memory if self._scatter else 0])
        self._block = max(1, BLOCK_VALUES // (longest * channels))
        self.restart()

    def restart(self) -> None:
        """Reset all states, so that no earlier value affects a later one."""
        self._states = [
            stage.fresh(self._channels) if stage.fresh else means.fresh(stage.memory, self._channels)
            for stage in self._stages
        ]
        if self._scatter:
            self._past = self._scatter.fresh(self._channels)

    def apply(self, values: FloatArray) -> Filtered:
        """Filter readings, shape (readings, channels), and keep the state after them."""
        starts = range(0, max(1, len(values)), self._block)
        parts = [self._apply(values[start : start + self._block]) for start in starts]
        if len(parts) == 1:
            return parts[0]
        return Filtered(
            np.concatenate([part.mean_mm for part in parts]),
            np.concatenate([part.relative_variance for part in parts]),
            self._noise_mm,
            np.concatenate([part.moves for part in parts]),
            np.concatenate([part.lags for part in parts]),
            np.concatenate([part.excess_mm2 for part in parts]),
        )

    def _apply(self, values: FloatArray) -> Filtered:
        signal = cleaned = unfiltered = means.signal_of(values)
        for index, stage in enumerate(self._stages):
            signal, self._states[index] = stage.step(signal, self._states[index])
            if stage.span == 1:
                cleaned = signal
        mean, variance = signal[:, 0], signal[:, 1]
        moves = lags = np.zeros(len(values), dtype=np.bool_)
        excess = np.zeros((0, self._channels, self._channels))
        if self._scatter and len(values):
            entered = values if cleaned is unfiltered else cleaned[:, 0]
            spans = self._spans(variance, self._scatter.span)
            moves, lags, excess, self._past = self._scatter.excess(values, entered, mean, variance, spans, self._past)
        return Filtered(mean, variance, self._noise_mm, moves, lags, excess)

    def _spans(self, variance: FloatArray, longest: int) -> list[int]:
        """Return the number of readings from which each mean is made."""
        if not self._restarts:
            return [longest] * len(variance)
        least = variance.min(axis=1)
        if np.isnan(least).any():
            least = np.where(np.isnan(variance), 1.0, variance).min(axis=1)
        spans: list[int] = np.minimum(np.ceil(1 / least - 1e-9), longest).astype(np.intp).tolist()
        return spans


def _unchanged(signal: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
    return signal, state
