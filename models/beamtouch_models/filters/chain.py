"""The filter of readings: spikes left out, means of the others, and the covariance of these means."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.change_detector import ChangeDetector
from beamtouch_models.filters.filtered import Filtered
from beamtouch_models.filters.motion import Motion, Past, Taken
from beamtouch_models.filters.readings import BEFORE, FloatArray, Stream, Sums, lone_spikes
from beamtouch_models.filters.ringing import UNSEEN_SWING, Followed, Ringing

MIN_MM = 2.0**-30
"""Readings without noise are compared with this, so that rounding errors are neither a change nor motion."""
FINE = 2.0**16
"""Readings are rounded to this part of their noise, so that sums of them are exact however a stream is split."""
MIN_FILL = 0.5
"""Part of the averaging window that good readings must fill before a channel has a value.

The noise of that first value is at most 1.4 times that of a full window. A single reading would be noisier still, and
could make a beam at rest look touched; a larger part would leave no value where a third of the readings is lost.
"""
MAX_COMPARED = 8
"""Newest readings of a growing mean whose scatter is tested. The mean itself shows slower motion."""
BLOCK_READINGS, BLOCK_VALUES = 128, 500_000
"""Longer inputs are filtered in parts, so that what is computed of a part fits in a processor's cache, and its windows
in memory."""
ROUNDING = 1e-6
"""Part of a reading by which a time may fall short of a whole number of readings, as it was rounded."""


@dataclass(frozen=True)
class Mean:
    """The mean that is taken of readings."""

    kind: Literal["none", "moving-average", "growing-mean"] = "none"
    window: int = 1
    """Number of readings in a moving average, or the fewest in a growing mean."""
    longest: int = 1
    """Largest number of readings in a growing mean."""
    spike_mm: float | None = None
    """Distance of a spike from the median of three readings; None: all readings count."""

    @property
    def grows(self) -> bool:
        """True if the mean is of the readings that agree."""
        return self.kind == "growing-mean"

    @property
    def most(self) -> int:
        """Largest number of readings in a mean."""
        return self.longest if self.grows else self.window if self.kind == "moving-average" else 1


class State(NamedTuple):
    """The memory of a chain: the readings before the next one."""

    stream: Stream
    """Sums of all readings but the newest one, in parts of the noise."""
    readings: FloatArray
    """The last readings as they came, shape (rows, channels)."""
    begun: int
    """Number of readings so far."""
    past: Past | None
    """Of the search for motion; None without it."""
    followed: Followed | None
    """Of the swings of a beam that moves; None of one that does not."""


class Chain:
    """The filter of one surface, and its state.

    Parameters
    ----------
    mean
        The mean that is taken.
    channels
        Number of channels.
    noise_mm
        Standard deviation of a reading, of all channels or of each; None if it is not known.
    slowest_period
        Period of the slowest motion of the beam, in readings; 0 if it is not known.
    step_mm
        Step of the ADC, of all channels or of each; 0 if it is not known. Readings that take two neighbouring values
        deviate by up to half a step, however small the noise is, and that is no motion.
    unseen_swing
        Swing of the beam that readings do not show, over that which they show.
    """

    def __init__(
        self,
        mean: Mean,
        channels: int,
        noise_mm: float | FloatArray | None = None,
        slowest_period: float = 0.0,
        step_mm: float | FloatArray = 0.0,
        unseen_swing: float = UNSEEN_SWING,
    ) -> None:
        self._mean, self._channels = mean, channels
        self._noise_mm = None if noise_mm is None else np.broadcast_to(np.asarray(noise_mm, np.float64), (channels,))
        unit_mm = np.maximum(unit_of(0.0 if noise_mm is None else noise_mm, step_mm, channels), MIN_MM)
        self._quantum_mm = unit_mm / FINE
        self._spike_mm = math.inf if mean.spike_mm is None else mean.spike_mm
        self._needed = math.ceil(MIN_FILL * mean.most) if mean.kind == "moving-average" else 1
        self._detector, self._motion, self._ringing, memory = None, None, None, BEFORE
        if mean.grows or self._noise_mm is not None:
            longest = mean.most if mean.grows else max(2 * mean.most, math.ceil(slowest_period))
            fewest = mean.window if mean.grows else 1
            self._detector = ChangeDetector(channels, longest, fewest, slowest_period, FINE)
        if self._detector and self._noise_mm is not None:
            span = min(mean.most, MAX_COMPARED) if mean.grows else mean.most
            self._motion = Motion(
                self._detector,
                span,
                grows=mean.grows,
                noise_mm=self._noise_mm,
                unit_mm=unit_mm,
                slowest_period=slowest_period,
            )
            memory = max(memory, self._motion.memory)
            if mean.grows and slowest_period > 0:
                self._ringing = Ringing(slowest_period, self._noise_mm, unit_mm, unseen_swing)
        self._memory = memory
        self._longest = max(mean.most, memory)
        self._kept = max(mean.most + 2, self._detector.rows if self._detector else 0)
        self._block = max(1, min(BLOCK_READINGS, BLOCK_VALUES // (memory * channels)))
        self.restart()

    def restart(self) -> None:
        """Reset all states, so that no earlier value affects a later one."""
        self.state = State(
            Stream.fresh(self._kept, self._channels),
            np.full((self._memory, self._channels), np.nan),
            0,
            self._motion.fresh() if self._motion else None,
            None,
        )

    def apply(
        self, values: FloatArray, lost: Sequence[int] | None = None, times: Sequence[float] | None = None
    ) -> Filtered:
        """Filter readings, and keep the state after them.

        What was known before a gap is as true after it, and what was not seen proves nothing: each lost reading is a
        row of NaN. Only a gap as long as the filter looks back leaves nothing that is known; a longer one is like it.

        Parameters
        ----------
        values
            The readings that came, shape (readings, channels).
        lost
            Number of readings lost before each of them, shape (readings,); None: none.
        times
            When they were taken, in readings since any time that stays the same, shape (readings,); None: evenly. Only
            the swings of a beam that rings need them; NaN where the time is not known well enough for that.
        """
        rows, places = values, None
        if lost is not None and any(lost):
            rows, places = self._with_lost(values, lost)
        taken = self.state.begun + np.arange(len(rows), dtype=np.float64)
        if times is not None:
            taken[slice(None) if places is None else places] = times
        parts = (slice(start, start + self._block) for start in range(0, max(1, len(rows)), self._block))
        filtered = Filtered.joined([self._apply(rows[part], taken[part]) for part in parts])
        return filtered if places is None else filtered.at(places)

    def apply_at_rest(self, values: FloatArray, lost: Sequence[int]) -> Filtered:
        """Filter readings among which nothing happens; return the mean after the last one.

        It is that of `apply`, which has the parameters, and the means after the others count as equal to it. Only for a
        growing mean.
        """
        rows, _ = self._with_lost(values, lost)
        return self._apply(rows, np.full(len(rows), math.nan), len(rows) - 1)

    def _apply(self, values: FloatArray, times: FloatArray, first: int = 0) -> Filtered:
        """Return the means after the readings from the `first` one on; `times` (readings,) are when they were taken."""
        stream, before, begun, past, followed = self.state
        readings, begun = np.concatenate([before, values]), begun + len(values)
        held, spikes = lone_spikes(readings, self._spike_mm)
        counted = self._counted(readings[self._memory - 1 :])
        settled, newest, doubtful = counted[:-1], counted[1 + first :], held[self._memory + first :]
        if spikes.any():
            settled = np.where(spikes[self._memory - 1 : -1, np.newaxis], 0.0, settled)
        stream = stream.add(settled)
        # A doubtful reading waits for the next one, in all channels: a step moves them together.
        until = stream.before[stream.end - len(newest) : stream.end] + newest * ~doubtful[:, np.newaxis, np.newaxis]
        sums = Sums(stream.before, until, np.arange(stream.end - len(newest), stream.end) + 1 - doubtful)
        seen = self._detector.at(sums) if self._detector else None
        sizes = seen.sizes if seen and self._mean.grows else np.full(len(newest), self._mean.most)
        total, number = np.moveaxis(sums.since(sizes[:, np.newaxis])[:, 0], 1, 0)
        there = (number >= self._needed) & (newest[:, 1] > 0)
        number = np.maximum(number, 1)
        mean = np.where(there, total / number * self._quantum_mm, np.nan)
        variance = np.where(there, 1 / number, np.nan)
        if self._motion and past and seen:
            seen = seen._replace(lags=seen.lags * self._quantum_mm)
            taken = Taken(readings, begun, spikes, doubtful, mean, variance, seen)
            filtered, past = self._motion.of(taken, past, first)
            if self._ringing:
                filtered, followed = self._settled(self._ringing, filtered, values[first:], times[first:], followed)
        else:
            nothing = np.zeros(len(mean), dtype=np.bool_)
            exact = np.zeros((0, self._channels, self._channels))
            filtered = Filtered(mean, variance, self._noise_mm, nothing, nothing, exact, nothing)
        self.state = State(stream, readings[len(values) :], begun, past, followed)
        return filtered

    def _settled(
        self, ringing: Ringing, filtered: Filtered, readings: FloatArray, times: FloatArray, followed: Followed | None
    ) -> tuple[Filtered, Followed | None]:
        """Return the means, those of a beam that rings replaced by where it will rest, and what is known after them."""
        if followed is None and not filtered.moves.any():
            return filtered, None
        rests, followed = ringing.follow(followed, times, readings, filtered.moves.tolist())
        return (filtered.replaced(rests) if rests else filtered), followed

    def _with_lost(self, values: FloatArray, lost: Sequence[int]) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return readings with rows of NaN for those lost before each of them, and the places of the readings."""
        places = np.arange(len(values)) + np.cumsum(np.minimum(lost, self._longest))
        rows = np.full((places[-1] + 1, values.shape[1]), np.nan)
        rows[places] = values
        return rows, places

    def _counted(self, values: FloatArray) -> FloatArray:
        """Return values (rows, channels) in parts of the noise, and their number: 0 for one that is missing."""
        counted = np.empty((len(values), 2, values.shape[1]))
        there = counted[:, 1] = ~np.isnan(values)
        counted[:, 0] = np.rint(np.where(there, values, 0.0) / self._quantum_mm)
        return counted


def unit_of(noise_mm: float | FloatArray, step_mm: float | FloatArray, channels: int) -> FloatArray:
    """Return the deviation (channels,) that readings at rest reach: their noise, or half a step of the ADC."""
    unit: FloatArray = np.broadcast_to(np.maximum(noise_mm, np.abs(step_mm) / 2), (channels,))
    return unit


def readings_within(time_ms: float, rate_hz: float) -> int:
    """Return how many readings fit in a time."""
    return math.floor(time_ms * rate_hz / 1e3 + ROUNDING)
