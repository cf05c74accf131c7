"""Several filters in succession: the means of the readings, and the covariance of these means."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters import means
from beamtouch_models.filters.filtered import Filtered
from beamtouch_models.filters.look import Look
from beamtouch_models.filters.means import FloatArray
from beamtouch_models.filters.motion import Motion, Moves, Past
from beamtouch_models.filters.stages import Stage, unit_of


class State(NamedTuple):
    """What a chain knows of the readings before the next one; no array in it ever changes."""

    stages: tuple[FloatArray, ...]
    """Of each stage that steps."""
    looked: FloatArray
    past: Past | None
    """Of the search for motion; None without it."""


BLOCK_VALUES = 500_000
"""Longer inputs are filtered in parts, so that the windows of a part fit in memory."""


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
        self._stages, self._channels = chosen, channels
        self._noise_mm = None if noise_mm is None else np.broadcast_to(np.asarray(noise_mm, np.float64), (channels,))
        span, spike_mm = max([1, *(stage.span for stage in chosen)]), min([math.inf, *(one.spike_mm for one in chosen)])
        growing = next((stage.look for stage in chosen if stage.look), None)
        self._look, self._motion = growing, None
        if self._noise_mm is not None:
            unit_mm = unit_of(self._noise_mm, step_mm, channels)
            longest = max(2 * span, math.ceil(slowest_period))
            self._look = growing or Look(longest, unit_mm, spike_mm, 1, slowest_period)
            self._motion = Motion(
                self._look,
                span,
                grows=growing is not None,
                noise_mm=self._noise_mm,
                unit_mm=unit_mm,
                slowest_period=slowest_period,
            )
        self._longest = max([span, *(stage.memory for stage in chosen), self._motion.memory if self._motion else 1])
        self._block = max(1, BLOCK_VALUES // (self._longest * channels))
        self.restart()

    def restart(self) -> None:
        """Reset all states, so that no earlier value affects a later one."""
        self.state = State(
            tuple(means.fresh(stage.memory, self._channels) for stage in self._stages if stage.step),
            self._look.fresh(self._channels) if self._look else means.fresh(0, self._channels),
            self._motion.fresh(self._channels) if self._motion else None,
        )

    def apply(self, values: FloatArray, lost: Sequence[int] | None = None) -> Filtered:
        """Filter readings, and keep the state after them.

        What was known before a gap is as true after it, and what was not seen proves nothing: each lost reading is a
        row of NaN. Only a gap as long as the filters look back leaves nothing that is known, and they begin anew.

        Parameters
        ----------
        values
            The readings that came, shape (readings, channels).
        lost
            Number of readings lost before each of them, shape (readings,); None: none.
        """
        if lost is None or not any(lost):
            return self._in_blocks(values)
        skipped, parts = np.array(lost), []
        anew = np.flatnonzero(skipped >= self._longest)
        for start, end in pairwise(sorted({0, *anew.tolist(), len(values)})):
            if skipped[start] >= self._longest:
                self.restart()
                skipped[start] = 0
            rows, places = with_lost(values[start:end], skipped[start:end])
            parts.append(self._in_blocks(rows).at(places))
        return Filtered.joined(parts)

    def _in_blocks(self, values: FloatArray) -> Filtered:
        starts = range(0, max(1, len(values)), self._block)
        return Filtered.joined([self._apply(values[start : start + self._block]) for start in starts])

    def apply_at_rest(self, values: FloatArray, lost: Sequence[int]) -> Filtered:
        """Filter readings among which nothing happens; return the mean after the last one.

        It is that of `apply`, which has the parameters, and the means after the others count as equal to it. Only for a
        growing mean.
        """
        if max(lost) >= self._longest:
            return self.apply(values, lost).at(np.array([len(values) - 1]))
        rows, _ = with_lost(values, np.array(lost))
        return self._apply(rows, len(rows) - 1)

    def _apply(self, values: FloatArray, first: int = 0) -> Filtered:
        """Return the means after the readings from the `first` one on."""
        signal, stages, looked, past = means.signal_of(values), list(self.state.stages), *self.state[1:]
        seen = None
        if self._look and len(values):
            seen, looked = self._look.step(values, looked, first)
        for index, stage in enumerate(self._stages):
            if stage.step:
                signal, stages[index] = stage.step(signal, stages[index])
            elif seen:
                there = seen.number > 0
                signal = np.stack([seen.mean_mm, np.where(there, 1 / np.maximum(seen.number, 1), np.nan)], axis=1)
        mean, variance = signal[:, 0], signal[:, 1]
        if self._motion and past and seen:
            found, past = self._motion.of(values, mean, variance, seen, past)
        else:
            nothing = np.zeros(len(values), dtype=np.bool_)
            found = Moves(nothing, nothing, np.zeros((0, self._channels, self._channels)))
        self.state = State(tuple(stages), looked, past)
        return Filtered(mean, variance, self._noise_mm, *found)


def with_lost(values: FloatArray, lost: NDArray[np.intp]) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return readings with rows of NaN for those lost before each of them, and the places of the readings."""
    places = np.arange(len(values)) + np.cumsum(lost)
    rows = np.full((places[-1] + 1, values.shape[1]), np.nan)
    rows[places] = values
    return rows, places
