"""The look back on readings against plain sums over them: where they changed, and whether that was a step."""

import math
from itertools import pairwise

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray
from beamtouch_models.filters.change_detector import windows_of
from beamtouch_models.filters.readings import Stream, Sums, lone_spikes, windows
from beamtouch_models.filters.splits import best_split, is_calm, is_sharp, is_step

NAN = math.nan


def sums_of(values: FloatArray) -> Sums:
    """Return the sums of the means whose newest reading is the last one, or the last but one; NaN is missing."""
    counted = np.stack([np.nan_to_num(values), ~np.isnan(values)], axis=1)
    stream = Stream.fresh(3, values.shape[1]).add(counted[:-1])
    before = stream.before[[stream.end - 2, stream.end - 1]]
    return Sums(stream.before, before + counted[-2:], np.array([stream.end - 1, stream.end]))


def readings(seed: int, rows: int, channels: int = 3) -> FloatArray:
    """Return noise with some readings missing in one channel."""
    values = np.random.default_rng(seed).standard_normal((rows, channels))
    values[[3, 4, rows // 2], 1] = NAN
    return values


def parts(values: FloatArray, end: int, *sizes: int) -> list[FloatArray]:
    """Return successive parts of the readings before `end`, oldest first, of these sizes."""
    edges = end - np.cumsum([0, *sizes[::-1]])[::-1]
    return [values[first:last] for first, last in pairwise(edges)]


def contrast(before: FloatArray, after: FloatArray) -> float:
    """Return how far the means of two parts are apart, in deviations, squared."""
    count = [(~np.isnan(part)).sum(axis=0) for part in (before, after)]
    mean = [
        np.nansum(part, axis=0) / np.maximum(number, 1) for part, number in zip((before, after), count, strict=True)
    ]
    weight = count[0] * count[1] / np.maximum(count[0] + count[1], 1)
    return float((weight * (mean[1] - mean[0]) ** 2).sum())


def test_sums_since_an_age_are_those_of_the_readings_since_then() -> None:
    values = readings(1, 20)
    sums = sums_of(values)
    assert not sums._replace(starts=sums.starts + 1).since(np.zeros((2, 3), np.intp)).any()
    since = sums.since(np.array([[1, 5, 0, 12], [2, 3, 19, 7]]))
    for row, (end, ages) in enumerate(((19, (1, 5, 0, 12)), (20, (2, 3, 19, 7)))):
        for place, age in enumerate(ages):
            part = values[end - age : end]
            assert since[row, place, 0] == pytest.approx(np.nansum(part, axis=0))
            assert since[row, place, 1].tolist() == (~np.isnan(part)).sum(axis=0).tolist()
    values, number = sums.of(np.array([1])).each(np.array([[10, 6, 0]]))
    assert number[0, 0].tolist() == [4.0, 3.0, 4.0]
    assert number[0, 1].tolist() == [6.0, 6.0, 6.0]


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("rows", "shortest"), [(9, 1), (30, 4), (47, 1)])
def test_a_window_is_split_where_its_two_sides_differ_most(seed: int, rows: int, shortest: int) -> None:
    values = readings(seed, 60)
    values[-rows // 2 :] += np.array([0.4, -0.3, 0.2])
    found = best_split(sums_of(values), np.array([shortest, shortest]), np.array([rows, rows - 1]))
    for split, end, window in zip(found.tolist(), (59, 60), (rows, rows - 1), strict=True):
        contrasts = [contrast(*parts(values, end, window - size, size)) for size in range(shortest, window)]
        assert split == shortest + int(np.argmax(contrasts))


@pytest.mark.parametrize("size", [3, 49, 140, 500, 901, 1170])
def test_a_long_window_is_split_at_its_step_to_the_reading(size: int) -> None:
    values = np.random.default_rng(size).standard_normal((1300, 2))
    values[-size:] += [12.0, -15.0]
    assert best_split(sums_of(values), np.array([1, 2]), np.array([1200, 1190])).tolist() == [size - 1, size]


def test_a_sharp_change_is_one_between_two_readings() -> None:
    values = readings(2, 40)
    values[-7:] += np.array([3.0, -4.0, 5.0])
    square = float(((values[-7] - values[-8]) ** 2).sum())
    for factor, is_above in ((0.499, True), (0.501, False)):
        assert is_sharp(sums_of(values), np.array([6, 7]), factor * square).tolist() == [is_above] * 2
    # Of a channel without one of the readings nothing is known.
    values[-8, 0] = NAN
    square -= 0.0 if math.isnan(square) else float((np.nan_to_num(values[-7, 0] - values[-8, 0])) ** 2)
    rest = float(((values[-7, 1:] - values[-8, 1:]) ** 2).sum())
    for factor, is_above in ((0.499, True), (0.501, False)):
        assert is_sharp(sums_of(values), np.array([6, 7]), factor * rest).tolist() == [is_above] * 2


def test_readings_before_a_touch_are_calm_if_they_scatter_little_about_their_mean() -> None:
    values = np.random.default_rng(4).standard_normal((40, 3)) + np.array([50.0, -60.0, 70.0])
    before = values[40 - 7 - 5 : 40 - 7]
    scatter = float(((before - before.mean(axis=0)) ** 2).sum())
    limits = np.array([NAN, NAN, NAN, scatter])
    assert is_calm(sums_of(values), np.array([6, 7]), 5, limits * 1.001).tolist() == [True, True]
    assert is_calm(sums_of(values), np.array([6, 7]), 5, limits * 0.999).tolist() == [False, False]
    # A channel that has none of them does not count.
    values[28:33, 1] = NAN
    few = float(((before - before.mean(axis=0))[:, [0, 2]] ** 2).sum())
    limits = np.array([NAN, NAN, few, NAN])
    assert is_calm(sums_of(values), np.array([6, 7]), 5, limits * 1.001).tolist() == [True, True]
    assert is_calm(sums_of(values), np.array([6, 7]), 5, limits * 0.999).tolist() == [False, False]
    # One that has some of them may swing beyond its range.
    values[30, 2] = NAN
    assert is_calm(sums_of(values), np.array([6, 7]), 5, np.full(4, 1e9)).tolist() == [False, False]
    values[28:33] = NAN
    assert is_calm(sums_of(values), np.array([6, 7]), 5, np.full(4, 1e9)).tolist() == [False, False]


def explained(values: FloatArray, shape: FloatArray) -> float:
    """Return the square that a regression on a shape takes off the readings, beyond their mean."""
    total = 0.0
    for column in values[:, :3].T:
        there = ~np.isnan(column)
        away, known = shape[there] - shape[there].mean(), column[there]
        total += float(away @ known) ** 2 / float(away @ away)
    return total


@pytest.mark.parametrize("slope", [0.0, 0.2, 0.6])
@pytest.mark.parametrize("seed", range(3))
def test_a_step_explains_more_than_a_slope_by_a_share_and_clearly(slope: float, seed: int) -> None:
    values = readings(seed, 44)
    values[-24:] += slope * np.arange(24)[:, np.newaxis] * np.array([0.3, 0.2, -0.1])
    values[-8:] += (1 - slope) * np.array([2.0, -3.0, 1.5])
    values = np.column_stack([values, np.full(44, NAN)])  # a channel that is out
    # Sums of 16 readings are the readings.
    window = values[-16:]
    by_step, by_slope = explained(window, np.repeat([0.0, 1.0], 8)), explained(window, np.arange(16.0))
    more, sums = by_step - by_slope, sums_of(values).of(np.array([1]))
    for clearly, is_clear in ((0.999, True), (1.001, False)):
        expected = is_clear and more > 0.12 * by_step
        assert is_step(sums, np.array([8]), clearly * more).tolist() == [expected]
    assert is_step(sums, np.array([8]), 0.0).tolist() == [more > 0.12 * by_step]


@pytest.mark.parametrize(("bend", "is_one"), [(0.0, False), (0.3, False), (0.7, True), (1.0, True)])
def test_what_is_more_of_a_slope_than_of_a_step_is_none_however_clear(bend: float, is_one: bool) -> None:
    """A slope explains three quarters of a step, of which a share is left."""
    along = np.arange(160.0)
    values = (1 - bend) * 1000 * (along - 79.5) / 160 + bend * 1000 * (along >= 80)
    assert is_step(sums_of(np.stack([values, 0 * values], axis=1)).of(np.array([1])), np.array([80]), 1.0) == [is_one]
    # A ramp that begins in the middle is none either.
    ramp = np.maximum(along - 80, 0.0)[:, np.newaxis]
    assert is_step(sums_of(ramp).of(np.array([1])), np.array([80]), 1.0).tolist() == [False]


@pytest.mark.parametrize("longest", [1, 2, 9, 200, 4000])
def test_windows_grow_to_the_longest_by_a_third_or_less(longest: int) -> None:
    lengths = windows_of(longest)
    assert (lengths[0], lengths[-1]) == (1, longest)
    for shorter, longer in pairwise(lengths[:-1]):
        assert longer == max(shorter + 1, math.floor(1.3 * shorter))


def test_a_stream_forgets_old_readings_and_its_sums_stay_exact() -> None:
    stream, kept = Stream.fresh(5, 1), 5
    every: list[int] = []
    for value in (2**48, 7, 2**49, 3, 2**49, 11, 2**48, 5, 13, 17, 19):
        every.append(value)
        stream = stream.add(np.array([[[value], [1.0]]], dtype=np.float64))
        for age in range(1, min(kept, len(every) + 1)):
            since = stream.before[stream.end - 1] - stream.before[stream.end - 1 - age]
            assert since.ravel().tolist() == [sum(every[-age:]), age]
        assert stream.before.max() <= 2**52


def test_a_stream_keeps_what_is_looked_back_on_and_seldom_copies_it() -> None:
    stream, copies = Stream.fresh(40, 2), 0
    for _ in range(200):
        before = stream.before
        stream = stream.add(np.ones((1, 2, 2)))
        copies += stream.before is not before
        assert len(stream.before) < 1.5 * 40
    assert copies < 25


def test_the_windows_of_the_last_rows_end_with_them() -> None:
    assert windows(np.arange(10, 30), 4, 3).tolist() == [[24, 25, 26, 27], [25, 26, 27, 28], [26, 27, 28, 29]]


def test_a_lone_reading_far_from_its_neighbours_is_a_spike_and_the_newest_one_is_doubtful() -> None:
    values = np.zeros((12, 2))
    values[:, 1] = 0.25 * np.arange(12)
    values[4, 0], values[7:9, 0], values[11, 1] = 3.0, 3.0, -5.0
    doubtful, spikes = lone_spikes(values, 2.0)
    assert np.argwhere(spikes).tolist() == [[4, 0]]
    # The second of two readings elsewhere confirms the first one.
    assert np.flatnonzero(doubtful).tolist() == [4, 7, 9, 11]
    for limit in (3.0, math.inf):
        doubtful, spikes = lone_spikes(values[:10], limit)
        assert not spikes.any()
        assert not doubtful.any()
    doubtful, spikes = lone_spikes(values[:10], 2.999)
    assert np.argwhere(spikes).tolist() == [[4, 0]]
    # Where the median is not known, nothing is a spike.
    values[3, 0] = NAN
    assert not lone_spikes(values, 2.0)[1].any()
