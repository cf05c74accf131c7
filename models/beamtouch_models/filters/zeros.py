"""Zeros that walk: follows the deflections at rest, and says how uncertain they are since the last rest. Numpy only.

A load is fast and a drift is slow, so the rate decides. Readings are taken in blocks. While nothing touches the beam,
the zero of each channel follows them as a Kalman filter does: its variance p grows with the time since the last rest,
and a block with the variance R moves it by p / (p + R) of the way. What all channels do together is warmth before it is
anything else, so most of the growth is common to all of them.

A block that leaves this uncertainty is a load. It stays one until the readings change by more than a drift does, and
are back within what zeros may have drifted meanwhile. A load that comes so slowly that it looks like a drift moves the
zeros no faster than twice the stated rate, and nothing moves them beyond a limit since the last tare.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.filtered import Filtered
from beamtouch_models.filters.hurry import Hurried, Hurry
from beamtouch_models.filters.readings import FloatArray
from beamtouch_models.filters.significance import chi_square_quantile
from beamtouch_models.filters.walk import MINUTE_S, OWN, TARED, Rested, Tracked, Walk

BLOCK_S, BLOCK_READINGS = 0.1, 4
"""A block is at least this time, this number of readings and the slowest period, so that ringing averages out."""
FALSE = 1e-6
"""Probability that noise ends a rest with a block."""
CALM = 4.0
"""Scatter within a block that noise explains, in its variance: of few readings it scatters much itself."""
SPEED = 2.0
"""Fastest motion of a zero, over the stated rate."""
LEASH = 4.0
"""Distance from such a motion that noise explains, in standard deviations of the zero."""
PROBATION_S, CREEPS_S = 5.0, 60.0
"""A rest that ends so soon with a step back, or with readings that creep back, may have been part of a slow lift. Then
its zero is taken back. What is hardly faster than a drift takes so long to show against the noise."""
LONGEST_S = 1e9
"""A longer time since the last rest, or an unknown one, makes no difference."""


class _Block(NamedTuple):
    mean_mm: FloatArray
    variance_mm2: FloatArray
    there: NDArray[np.bool_]
    """Channels that were good in all readings."""
    swings: bool = False
    """True if this is what the beam swings about."""


class _Zero(NamedTuple):
    """The zeros at the last rest."""

    at: int
    """Number of readings before it ended."""
    seen: NDArray[np.intp]
    """The same for the last rest in which each channel was good."""
    mm: FloatArray
    seen_mm2: FloatArray
    """Variances of the zeros when the channels were seen."""
    variance_mm2: FloatArray
    """Variances of the zeros at the end of the rest."""
    steady_mm: FloatArray
    """A zero that moves no faster than it may."""


class _Load(NamedTuple):
    """A load, which keeps the beam from its rest."""

    at: int = 0
    """Number of readings before the end of the first block that is like it."""
    first: _Block | None = None
    has_changed: bool = False
    """True if the readings have changed since then by more than a drift does."""


class Zeros:
    """The zeros of one surface. Any split of the stream of readings gives the same zeros.

    Parameters
    ----------
    walk
        The drift.
    rate_hz
        Readings per second.
    noise_mm, step_mm
        Standard deviation of a reading and step of the ADC, shape (channels,) or one number.
    slowest_period
        Period of the slowest motion of the beam, in readings; 0 if it is not known.
    channels
        Number of channels.
    rested
        The last rest before the first reading.
    """

    def __init__(
        self,
        walk: Walk,
        rate_hz: float,
        noise_mm: float | FloatArray,
        step_mm: float | FloatArray,
        slowest_period: float,
        channels: int,
        rested: Rested = TARED,
    ) -> None:
        self._walk, self._rate_hz, self._channels = walk, rate_hz, channels
        self._rested = rested
        self._size = max(BLOCK_READINGS, math.ceil(BLOCK_S * rate_hz), math.ceil(slowest_period))
        noise, step = (np.broadcast_to(np.asarray(value, np.float64), (channels,)) for value in (noise_mm, step_mm))
        self._single_mm2 = np.maximum(np.maximum(noise, step / 2), np.finfo(np.float64).tiny ** 0.25) ** 2
        self._mean_mm2 = np.maximum(noise**2, 1e-6 * self._single_mm2) / self._size + step**2 / 12
        # The mean of readings whose steps hide the noise stays where it is rounded to (Widrow & Kollar, 2008, ch. 4).
        hidden = np.exp(-np.square(2 * np.pi * noise / np.maximum(step, noise / 10 + np.finfo(np.float64).tiny)))
        self._rounded_mm2 = step**2 / 12 * hidden
        self._limits = [0.0, *(chi_square_quantile(number, FALSE) for number in range(1, channels + 1))]
        self.restart()

    def restart(self) -> None:
        """Know nothing but the last rest before the first reading."""
        rest_end = -round(min(self._rested.ago_s, LONGEST_S) * self._rate_hz)
        deviation_mm = self._walk.start_mm if self._rested.deviation_mm is None else self._rested.deviation_mm
        zero_mm = np.zeros(self._channels) if self._rested.zero_mm is None else np.array(self._rested.zero_mm)
        variance_mm2 = np.broadcast_to(np.square(deviation_mm), self._channels)
        self._read = 0
        """Number of readings so far, with those that are lost."""
        self._rest = _Zero(rest_end, np.full(self._channels, rest_end), zero_mm, variance_mm2, variance_mm2, zero_mm)
        self._before: tuple[int, _Zero] | None = None
        """The rest before the last load, and the number of readings up to when that load seemed to be gone."""
        self._load: _Load | None = None
        """None while the beam rests."""
        self._last: _Block | None = None
        """The block before this one, if it was calm, or the beam swung about a known rest."""
        self._hurry = Hurry(self._walk.rate_mm_per_min)
        self._begin()

    def _begin(self) -> None:
        self._rows: list[FloatArray] = []
        self._filled = 0

    @property
    def is_loaded(self) -> bool:
        """True if the readings left what drift explains, as far as whole blocks say."""
        return self._load is not None

    @property
    def hurried(self) -> Hurried | None:
        """The zero that drifts faster than is stated; None if none does."""
        return self._hurry.hurried

    @property
    def rested(self) -> Rested:
        """The last rest, before the next reading."""
        ago_s = (self._read - self._rest.at) / self._rate_hz
        deviation_mm = np.sqrt(self._rest.variance_mm2)
        return Rested(ago_s, tuple(self._rest.mm.tolist()), tuple(deviation_mm.tolist()))

    @property
    def zero_mm(self) -> FloatArray:
        """Zero of each channel after the last reading, shape (channels,)."""
        return self._rest.mm

    def track(
        self, values_mm: FloatArray, lost: Sequence[int] | None = None, filtered: Filtered | None = None
    ) -> Tracked:
        """Return the zeros of each reading.

        Parameters
        ----------
        values_mm
            Deflections from the last tare, shape (readings, channels), oldest first; NaN where a channel is not good.
        lost
            Number of readings lost before each, shape (readings,); None: none.
        filtered
            The means that the same readings gave, one each or the newest only; None: none. Where the beam swings, they
            say about what.
        """
        number = len(values_mm)
        zero, own = np.empty((2, number, self._channels))
        common = np.empty(number)
        gaps = [0] * number if lost is None else lost
        row = 0
        while row < number:
            # Up to the end of the block, or to the next gap.
            end = min(number, row + self._size - self._filled)
            end = next((reading for reading in range(row + 1, end) if gaps[reading]), end)
            self._skip(gaps[row])
            times = self._read - self._rest.at + np.arange(1, end - row + 1)
            zero[row:end] = self._rest.mm
            common[row:end] = self._walk.grown_mm(times / self._rate_hz)
            own[row:end] = np.sqrt(self._rest.variance_mm2 + (OWN * common[row:end, None]) ** 2)
            self._rows.append(values_mm[row:end])
            self._filled += end - row
            self._read += end - row
            if self._filled >= self._size:
                self._end_block(filtered, end - number)
            row = end
        return Tracked(zero, common, own)

    def _skip(self, lost: int) -> None:
        """Note lost readings. More than a block holds may have been a load that came and went."""
        self._read += lost
        if lost >= self._size:
            self._last = None
            self._begin()

    def _found(self, filtered: Filtered | None, behind: int) -> _Block | None:
        """Return the rest about which the beam swings as a block; None if that is not known. Arguments as below.

        Rests found in successive blocks share readings, so the variance is multiplied by the number of blocks in one.
        """
        row = -1 if filtered is None else len(filtered.found) + behind - 1
        if filtered is None or row < 0 or not filtered.found[row]:
            return None
        repeats = max(1.0, float(filtered.readings[row]) / self._size)
        variance_mm2 = repeats * np.diag(filtered.covariances_mm2(np.array([row]))[0])
        mean_mm, there = filtered.mean_mm[row], ~np.isnan(filtered.mean_mm[row])
        # What is less certain than a reading and than the zeros may hide a load, which would move them again and again.
        if (variance_mm2 > np.maximum(self._single_mm2, self._drifted_mm2(self._rest)))[there].any():
            return None
        return _Block(mean_mm, np.maximum(variance_mm2, self._mean_mm2), there, swings=True)

    def _end_block(self, filtered: Filtered | None, behind: int) -> None:
        """Take what a block says; if the beam swings, what it swings about.

        The block ends so many readings, at most 0, behind the newest mean.
        """
        rows = np.concatenate(self._rows)
        self._begin()
        mean = rows.sum(axis=0) / len(rows)
        apart = rows - mean
        scatter = (apart * apart).sum(axis=0) / (len(rows) - 1)
        there: NDArray[np.bool_] = ~np.isnan(mean)
        is_calm = there.any() and bool((scatter[there] <= CALM * self._single_mm2[there]).all())
        if not is_calm:
            rest = self._found(filtered, behind)
            if rest is not None:
                self._take(rest)
            self._last = rest
            return
        excess = np.where(scatter > 2 * self._single_mm2, scatter - self._single_mm2, 0.0)
        block = _Block(mean, self._mean_mm2 + excess, there)
        self._take(block)
        self._last = block

    def _take(self, block: _Block) -> None:
        """Take a block: of calm readings, or what the beam swings about."""
        if self._is_within(block, self._rest):
            if self._load is None or self._load.first is None:
                self._follow(block, self._rest)
            elif self._returns(block, self._load):
                if self._before is None or not self._is_soon(self._before[0], CREEPS_S):
                    self._doubt(self._rest)
                self._follow(block, self._rest)
        elif rest := self._steps_back_to(block):
            self._doubt(rest)  # a slow lift may go on, and look like a rest again
            self._follow(block, rest)
        else:
            self._hold(block)

    def _doubt(self, before: _Zero) -> None:
        """Keep the rest before a load for a while: the load may turn out not to be gone."""
        self._before = self._read, before

    def _hold(self, block: _Block) -> None:
        """Note a load. Its first block may hold the touch; a single one may be chance."""
        if self._load is None:
            self._load = _Load()
        elif self._load.first is None:
            self._load = _Load(self._read, block)
        else:
            self._load = self._followed(self._load, block)

    def _followed(self, load: _Load, block: _Block) -> _Load:
        """Return a load after another block."""
        if load.has_changed or load.first is None:
            return load
        drift_mm = SPEED * self._grown_mm(load.at)
        square, limit = self._compare(block, load.first.mean_mm, block.variance_mm2, drift_mm)
        return load._replace(has_changed=square > limit)

    def _returns(self, block: _Block, load: _Load) -> bool:
        """Return whether a load is gone: it has changed, and the beam lies still within what zeros may have drifted.

        A load that never changed was none, once so large a drift is usual.
        """
        self._load = load = self._followed(load, block)
        if load.has_changed:
            return self._repeats(block)
        square, _ = self._compare(block, self._rest.mm, self._rest.variance_mm2, self._grown_mm(self._rest.at))
        return square <= int(block.there.sum())

    def _steps_back_to(self, block: _Block) -> _Zero | None:
        """Return the rest before the last load, if that explains a block and the zeros since then were none."""
        if self._before is None:
            return None
        returned, rest = self._before
        there = block.there
        moved, step = (self._rest.mm - rest.mm)[there], (block.mean_mm - self._rest.mm)[there]
        is_soon = self._is_soon(returned, CREEPS_S if self._load is None else PROBATION_S)
        is_back = is_soon and float(moved @ step) < 0
        return rest if is_back and self._is_within(block, rest) and self._repeats(block) else None

    def _is_soon(self, after: int, seconds: float) -> bool:
        """Return whether no more than a time has passed since this number of readings."""
        return self._read - after <= seconds * self._rate_hz

    def _repeats(self, block: _Block) -> bool:
        """Return whether a block is like that before it. A beam that swings shows its rest over all its swings."""
        if block.swings:
            return True
        last = self._last
        if last is None:
            return False
        square, limit = self._compare(block._replace(there=block.there & last.there), last.mean_mm, last.variance_mm2)
        return square <= limit

    def _grown_mm(self, since: int) -> float:
        """Return the common drift since this number of readings."""
        return float(self._walk.grown_mm((self._read - since) / self._rate_hz))

    def _drifted_mm2(self, rest: _Zero) -> FloatArray:
        """Return the variance of each zero since a rest, shape (channels,)."""
        return rest.variance_mm2 + (1 + OWN**2) * self._grown_mm(rest.at) ** 2

    def _is_within(self, block: _Block, rest: _Zero) -> bool:
        """Return whether what zeros may have drifted since a rest explains a block."""
        if (np.abs(block.mean_mm[block.there]) > self._walk.max_mm).any():
            return False
        square, limit = self._compare(block, rest.mm, rest.variance_mm2, self._grown_mm(rest.at))
        return square <= limit

    def _compare(
        self, block: _Block, mean_mm: FloatArray, variance_mm2: FloatArray, common_mm: float = 0.0
    ) -> tuple[float, float]:
        """Return the squared distance of a block from a mean, in deviations, and what noise hardly ever exceeds.

        The mean has its own variance; between the two, zeros may have drifted by `common_mm`, and each by itself.
        """
        there = block.there
        apart_mm = (block.mean_mm - mean_mm)[there]
        weight = 1 / (block.variance_mm2 + variance_mm2 + (OWN * common_mm) ** 2)[there]
        # Sherman & Morrison: the inverse of a diagonal matrix plus common_mm^2 in every entry.
        together = common_mm**2 * float(weight @ apart_mm) ** 2 / (1 + common_mm**2 * float(weight.sum()))
        return float(weight @ apart_mm**2) - together, self._limits[int(there.sum())]

    def _follow(self, block: _Block, rest: _Zero) -> None:
        """Move the zeros of a rest to a block."""
        there, variance = block.there, self._drifted_mm2(rest)
        gain = np.where(there, variance / (variance + block.variance_mm2), 0.0)
        moved = rest.mm + gain * np.where(there, block.mean_mm - rest.mm, 0.0)
        reach = SPEED * self._walk.rate_mm_per_min / MINUTE_S * (self._read - rest.seen) / self._rate_hz
        # All or none: a load that comes slowly moves some channels faster than others. But one may have been out.
        way, was_there = moved - rest.steady_mm, rest.seen == rest.at
        share = reach / np.maximum(reach, np.abs(way))
        steady = rest.steady_mm + way * np.where(was_there, share[was_there].min(initial=1.0), share)
        seen = np.where(there, self._read, rest.seen)
        seen_mm2 = np.where(there, np.maximum(variance * (1 - gain), self._rounded_mm2), rest.seen_mm2)
        leash = LEASH * np.sqrt(seen_mm2)
        zero_mm = np.where(there, np.clip(moved, steady - leash, steady + leash), rest.mm)
        strains = bool((there & (zero_mm != moved)).any())
        seconds = 1 / self._rate_hz
        at_s, lasts_s = self._read * seconds, self._size * seconds
        self._hurry.add(at_s, lasts_s, block.mean_mm, np.sqrt(block.variance_mm2), strains=strains)
        out_mm = self._walk.grown_mm((self._read - seen) / self._rate_hz)
        self._rest = _Zero(self._read, seen, zero_mm, seen_mm2, seen_mm2 + (1 + OWN**2) * out_mm**2, steady)
        self._load = None
