"""The look at the newest readings against Lepski's rule in plain loops: what agrees, what drifts, and what lags."""

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray
from beamtouch_models.filters.change_detector import ChangeDetector, windows_of
from beamtouch_models.filters.readings import Stream, Sums
from beamtouch_models.filters.significance import chi_square_quantile
from beamtouch_models.filters.splits import is_step

UNIT, CHANNELS = 32.0, 3
NAN = math.nan


class Look:
    """What is seen of readings (rows, channels), in units of their noise; NaN is missing."""

    def __init__(self, readings: FloatArray, longest: int, fewest: int, period: float) -> None:
        self.readings, self.longest, self.fewest = readings, longest, min(fewest, longest)
        self.still, self.before = math.ceil(period / 4), max(2, math.ceil(period))

    def mean(self, newest: int, without: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return means and numbers of the newest readings, by channel, without some of the very newest ones."""
        end = len(self.readings) - without
        part = self.readings[max(end - newest + without, 0) : end]
        number = (~np.isnan(part)).sum(axis=0).astype(np.float64)
        return np.nansum(part, axis=0) / np.maximum(number, 1), number

    def apart(self, few: int, many: int) -> list[tuple[float, float]]:
        """Return by how much the means of few and of many of the newest readings differ, and its variance."""
        (mean, number), (of_all, in_all) = self.mean(few), self.mean(many)
        found = [(NAN, NAN)] * CHANNELS
        for channel in np.flatnonzero((number > 0) & (number < in_all)):
            variance = 1 / number[channel] - 1 / in_all[channel]
            found[channel] = float(mean[channel] - of_all[channel]), float(variance)
        return found

    def differs(self, window: int, shorter: int) -> bool:
        """Return whether some of the readings of a window differ from all."""
        newest = [2**power for power in range(20) if 2**power <= self.longest]
        parts = [*newest, shorter, window - 1, window - 4]
        limit = chi_square_quantile(CHANNELS, 0.001 / len(parts))
        squares = [np.nansum([apart**2 / variance for apart, variance in self.apart(part, window)]) for part in parts]
        return bool(max(squares) > limit)

    def split(self, window: int, shorter: int) -> int:
        """Return since when the readings of a window differ most from those before."""
        contrasts = {}
        for since in range(max(1, shorter // 2), window):
            (after, many), (before, few) = self.mean(since), self.mean(window, since)
            contrasts[since] = float((few * many / np.maximum(few + many, 1) * (after - before) ** 2).sum())
        return max(contrasts, key=contrasts.__getitem__)

    def is_sharp(self, since: int) -> bool:
        jump = self.readings[-since] - self.readings[-since - 1]
        return float(np.nansum(jump**2)) > 2 * chi_square_quantile(CHANNELS, 1e-6)

    def is_touched(self, since: int) -> bool:
        """Return whether a sharp change was a touch of a beam that lay still, of which few readings are known."""
        before = self.readings[:-since][-self.before :]
        there = ~np.isnan(before)
        if not 1 < since < max(self.fewest, self.still) or (there.any(axis=0) != there.all(axis=0)).any():
            return False
        scatter = float(np.nansum((before - before.mean(axis=0)) ** 2))
        return scatter < chi_square_quantile(int(there.all(axis=0).sum()) * (self.before - 1), 0.001)

    def lag(self, size: int, *, drifts: bool) -> FloatArray:
        """Return what noise does not explain of the distance of a mean from the newest readings."""
        least = max(8, 2 * self.fewest)
        best, square = np.zeros(CHANNELS), 0.0
        for number in (least, 2 * least, 4 * least):
            apart = self.apart(size, 2 * size) if drifts else self.apart(number, size)
            known = [(-far if drifts else far, of) if 0 < of < 1 else (0.0, 1.0) for far, of in apart]
            more = sum(far**2 / of for far, of in known)
            if more > square:
                best, square = np.array([far for far, _ in known]), more
        limit = chi_square_quantile(CHANNELS, 0.1)
        share = math.sqrt(max(0.0, 1 - limit / square)) if square else 0.0
        return best * share * ((size - 1) / size if drifts else 1.0)

    def seen(self, is_step: bool) -> tuple[int, int, bool, bool, float, FloatArray]:
        """Return all of `Seen`; whether a slow change is a step is said."""
        windows = [0, *windows_of(self.longest)]
        found = (pair for pair in pairwise(windows) if self.differs(pair[1], pair[0]))
        shorter, window = next(found, (0, 0))
        if not window:
            return self.longest, self.longest, False, False, 0.0, self.lag(self.longest, drifts=False)
        since = self.split(window, shorter)
        sharp = self.is_sharp(since)
        touched = sharp and self.is_touched(since)
        rests = sharp or (since >= self.fewest and is_step)
        size = since if rests else math.ceil(since / 4)
        few = size < self.fewest and not touched
        size, drifts = self.fewest if few else size, not rests or few
        (after, _), (before, there) = self.mean(since), self.mean(2 * since, since)
        jump = float(((after - before) ** 2).sum())
        return since, size, bool(drifts and there.any()), touched, jump, self.lag(size, drifts=drifts)


def stepped(seed: int) -> FloatArray:
    """Return a load that comes at once, and slides off after some time, with single readings that are lost."""
    random, at = np.random.default_rng(seed), np.arange(150)[:, np.newaxis]
    way = random.normal(size=CHANNELS)
    values = random.standard_normal((150, CHANNELS))
    values += 9.0 * (at >= 70) * way / np.linalg.norm(way)
    values += np.clip((at - 105) / 4, 0, 5 + 4 * seed) * way[::-1]
    values[[31, 68, 74, 100], 1] = NAN
    values[90:93] = NAN
    return values


def swinging(seed: int) -> FloatArray:
    """Return a beam that begins to swing slowly, one of whose channels is out, and is touched later."""
    random, at = np.random.default_rng(seed), np.arange(150)[:, np.newaxis]
    values = random.standard_normal((150, CHANNELS)) + 2.5 * np.sin(np.maximum(at - 60, 0) / 6) * [1.0, -0.6, 0.4]
    values += 20.0 * (at >= 120) * [1.0, 0.5, 0.7]
    values[30:, 2] = NAN
    return values


@pytest.mark.parametrize("play", [stepped, swinging])
@pytest.mark.parametrize(("longest", "fewest", "period"), [(60, 4, 13.0), (100, 1, 0.0), (37, 6, 30.3), (3, 5, 6.0)])
def test_what_is_seen_of_the_newest_readings_is_what_plain_loops_find(
    play: Callable[[int], FloatArray], longest: int, fewest: int, period: float
) -> None:
    values = np.rint(UNIT * play(2)) / UNIT
    detector = ChangeDetector(CHANNELS, longest, fewest, period, UNIT)
    assert detector.still == math.ceil(period / 4)
    counted = np.stack([np.nan_to_num(UNIT * values), ~np.isnan(values)], axis=1)
    stream = Stream.fresh(detector.rows, CHANNELS).add(counted)
    ends = np.array([*range(62, 150, 14), 70, 71, 73, 75, 105, 107, 108, 120, 121, 122, 124])
    sums = Sums(stream.before, stream.before[stream.end - 150 + ends], stream.end - 150 + ends)
    seen = detector.at(sums)
    for row, end in enumerate(ends.tolist()):
        look = Look(values[: end + 1], longest, fewest, period)
        since = np.minimum(seen.since[row], end)
        step = is_step(sums.of(np.array([row])), np.array([since]), UNIT**2 * chi_square_quantile(CHANNELS, 0.001))
        expected = look.seen(bool(step[0]))
        assert (seen.since[row], seen.sizes[row], seen.drifts[row], seen.touched[row]) == expected[:4]
        assert seen.jumps[row] == pytest.approx(expected[4])
        assert seen.lags[row] / UNIT == pytest.approx(expected[5])
