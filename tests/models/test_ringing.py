"""A beam that rings: the filter says where it will rest, and how surely; at rest nothing changes."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.stats import chi2

from beamtouch_models.filters import Chain, Filtered, FloatArray, Mean
from beamtouch_models.filters.filtered import Found
from beamtouch_models.filters.ringing import Followed, Ringing
from beamtouch_models.filters.search import Whole, carried, sought
from beamtouch_models.filters.sinusoids import Band, Poles, fit, refine, seek

CHANNELS = 4
PERIOD = 20.0
"""Of the slowest motion, in readings."""
MEAN = Mean("growing-mean", 4, 200, 6.0)
LOAD = np.array([150.0, 400.0, 380.0, 200.0])
"""Deflection of a touch, in units of the noise."""
BENT = np.array([9.0, 5.0, -5.0, -9.0])
"""Of the second mode."""
FREQUENCIES, DECAY = (0.22, 0.12), 0.02
"""Of two modes, in periods a reading; the second is an alias. Their decay a reading."""


def noise(readings: int, seed: int) -> FloatArray:
    return np.random.default_rng(seed).standard_normal((readings, CHANNELS))


def rung(since: FloatArray) -> FloatArray:
    """Return what ringing adds to a load of 1 that came at 0, shape (readings, channels)."""
    later = np.maximum(since, 0.0)[:, np.newaxis]
    swings = [np.exp(-DECAY * later) * np.cos(2 * np.pi * frequency * later) for frequency in FREQUENCIES]
    rings: FloatArray = -1.0 * (since >= 0)[:, np.newaxis] * (swings[0] * LOAD + swings[1] * BENT)
    return rings


def touched(readings: int, at: float) -> FloatArray:
    """Return the deflection under a sudden force."""
    since = np.arange(float(readings)) - at
    bent: FloatArray = (since >= 0)[:, np.newaxis] * LOAD + rung(since)
    return bent


def lifted(readings: int, at: float) -> FloatArray:
    """Return the deflection after one has gone."""
    since = np.arange(float(readings)) - at
    bent: FloatArray = (since < 0)[:, np.newaxis] * LOAD - rung(since)
    return bent


def chain() -> Chain:
    return Chain(MEAN, CHANNELS, 1.0, PERIOD, unseen_swing=0.01)


def errors(filtered: Filtered, truth: FloatArray, at: Sequence[int]) -> FloatArray:
    """Return distances from the truth at some readings."""
    far: FloatArray = np.sqrt(((filtered.mean_mm[at] - truth) ** 2).sum(axis=1))
    return far


def squares(filtered: Filtered, truth: FloatArray, at: int) -> float:
    """Return the square of the distance from the truth, in terms of the covariance."""
    apart = filtered.mean_mm[at] - truth
    return float(apart @ np.linalg.solve(filtered.covariance_mm2[at], apart))


@pytest.mark.parametrize("lost", [0.0, 0.1, 0.3])
def test_after_a_sudden_force_the_rest_is_known_while_the_beam_swings(lost: float) -> None:
    far, held = [], []
    for seed in range(12):
        values, rng = touched(160, 100.3) + noise(160, seed), np.random.default_rng(seed)
        came = rng.random(160) >= lost
        came[[120, 140]] = True
        gaps = (np.diff(np.flatnonzero(came), prepend=-1) - 1).tolist()
        filtered = chain().apply(values[came], gaps)
        at = np.searchsorted(np.flatnonzero(came), [120, 140]).tolist()
        far.append(errors(filtered, LOAD, at))
        held += [squares(filtered, LOAD, one) < chi2.ppf(0.99, CHANNELS) for one in at]
    # A plain mean of as many readings is off by 20; the swing is still of 400.
    assert np.median(far, axis=0)[0] < 8 + 30 * lost
    assert np.median(far, axis=0)[1] < 3
    assert np.mean(held) > 0.9


def test_readings_that_are_not_taken_evenly_are_followed_by_their_own_times() -> None:
    far: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(10):
        times = np.arange(160) + np.random.default_rng(100 + seed).uniform(-0.1, 0.1, 160)
        since = times - 100.3
        values = (since >= 0)[:, np.newaxis] * LOAD + rung(since) + noise(160, seed)
        for known, distances in far.items():
            filtered = chain().apply(values, times=(times + 5e6).tolist() if known else None)
            distances.extend(errors(filtered, LOAD, [130]).tolist())
            assert squares(filtered, LOAD, 130) < chi2.ppf(0.9999, CHANNELS)
    assert np.median(far[True]) < 5
    assert np.median(far[False]) > 4 * np.median(far[True])


def test_readings_lost_from_a_burst_with_times_leave_the_fit_as_it_is() -> None:
    values, came = touched(200, 100.3) + noise(200, 9), np.ones(200, np.bool_)
    came[[130, 141, 142, 155]] = False
    at = np.flatnonzero(came)
    gaps = (np.diff(at, prepend=-1) - 1).tolist()
    counted = chain().apply(values[came], gaps)
    timed = chain().apply(values[came], gaps, (at + 5e6).tolist())
    np.testing.assert_allclose(timed.mean_mm, counted.mean_mm, rtol=1e-6, atol=1e-3)


def test_at_rest_nothing_changes() -> None:
    values = np.concatenate([noise(300, 1), LOAD / 40 + noise(300, 2)])
    without = chain()
    without._ringing = None
    followed, plain = chain().apply(values), without.apply(values)
    np.testing.assert_array_equal(followed.mean_mm, plain.mean_mm)
    np.testing.assert_array_equal(followed.excess_mm2, plain.excess_mm2)


def test_any_split_of_the_stream_gives_the_same_bits_also_if_a_state_is_taken_back() -> None:
    values = np.concatenate([touched(160, 60.4), lifted(160, 30.7)]) + noise(320, 3)
    values[150, 2] = np.nan
    whole = chain().apply(values)
    split, parts, at = chain(), [], 0
    for size in [1, 2, 7, 1, 30, 1, 1, 50, 3] * 10:
        before = split.state
        split.apply(values[at : at + size])
        split.state = before
        parts.append(split.apply(values[at : at + size]))
        at += size
        if at >= len(values):
            break
    joined = Filtered.joined(parts)
    np.testing.assert_array_equal(joined.mean_mm, whole.mean_mm)
    np.testing.assert_array_equal(joined.excess_mm2, whole.excess_mm2)


@pytest.mark.parametrize(
    ("readings", "excess_mm2", "missing", "replaced"),
    [
        # The mean has 0.25 x (4 + 1) mm^2 of noise and 6 of motion: 7.25 in all.
        (10, (3.3, 3.4), (), True),  # with 0.1 x (4 + 1) mm^2 of noise: 7.2
        (10, (3.4, 3.4), (), False),
        (2, (2.3, 2.4), (), True),
        (2, (2.4, 2.4), (), False),
        (10, (3.3, 3.4), (1,), False),  # the mean has a channel more
    ],
)
def test_a_rest_replaces_a_mean_that_moves_where_the_sum_of_its_variances_is_less(
    readings: int, excess_mm2: tuple[float, float], missing: tuple[int, ...], replaced: bool
) -> None:
    rest_mm = np.array([7.0, 8.0])
    rest_mm[list(missing)] = np.nan
    moving = np.array([False, True, True])
    means = Filtered(
        np.arange(6.0).reshape(3, 2),
        np.full((3, 2), 0.25),
        np.array([2.0, 1.0]),
        moving,
        ~moving,
        np.stack([np.eye(2), np.diag([1.0, 2.0]), np.diag([2.0, 4.0])]),
        np.zeros(3, np.bool_),
    )
    after = means.replaced([(2, Found(rest_mm, readings, np.diag(excess_mm2)))])
    assert after.found.tolist() == [False, False, replaced]
    assert after.mean_mm.tolist() == [[0.0, 1.0], [2.0, 3.0], [7.0, 8.0] if replaced else [4.0, 5.0]]
    assert after.covariance_mm2[:2] == pytest.approx(means.covariance_mm2[:2])
    noise_mm2, beyond_mm2 = np.diag([4.0, 1.0]), np.diag(excess_mm2 if replaced else (2.0, 4.0))
    assert after.covariance_mm2[2] == pytest.approx(noise_mm2 * (1 / readings if replaced else 0.25) + beyond_mm2)


def test_after_each_search_in_vain_a_row_more_passes_up_to_eight() -> None:
    """Nothing swings in white noise that is a hundred times that of readings."""
    followed: Followed | None = None
    ringing, searches = Ringing(PERIOD, np.ones(CHANNELS), np.ones(CHANNELS), 0.01), list[int]()
    for row, reading in enumerate(100 * noise(60, 2)):
        _, followed = ringing.follow(followed, np.array([float(row)]), reading[np.newaxis], [True])
        assert followed is not None
        assert followed.fit is None
        searches += [row] * (followed.failures > len(searches))
    assert np.diff(searches).tolist() == [2, 3, 4, 5, 6, 7, 8, 9, 9]


def test_a_touch_of_a_beam_that_still_rings_from_a_lift_is_seen_within_some_readings() -> None:
    later = []
    for seed in range(8):
        values = lifted(160, 40.6) + touched(160, 90.2) * 0.5 + noise(160, seed)
        filtered = chain().apply(values)
        seen = [squares(filtered, np.zeros(CHANNELS), at) > chi2.ppf(1 - 1e-6, CHANNELS) for at in range(160)]
        assert not any(seen[70:91])
        later.append(seen[91:].index(True))
    assert np.median(later) <= 8


def test_a_spike_neither_ends_nor_bends_the_fit() -> None:
    values = touched(180, 60.4) + noise(180, 4)
    values[130, 1] += 300
    at = list(range(132, 160))
    assert errors(chain().apply(values), LOAD, at).max() < 6


def test_a_channel_beyond_its_range_at_the_turning_points_is_followed_where_it_is_within() -> None:
    values = touched(180, 60.4) + noise(180, 5)
    values[values[:, 1] > 700, 1] = np.nan
    assert np.isnan(values[60:100, 1]).any()
    filtered = chain().apply(values)
    there = [at for at in range(100, 160) if not np.isnan(values[at]).any()]
    assert np.median(errors(filtered, LOAD, there)) < 6
    held = [squares(filtered, LOAD, at) < chi2.ppf(0.999, CHANNELS) for at in there]
    assert np.mean(held) > 0.9


@pytest.mark.parametrize("readings", [6, 20, 60])
def test_a_load_that_grows_is_not_taken_for_a_swing(readings: int) -> None:
    held = []
    for seed in range(6):
        grown = np.clip((np.arange(200) - 100.4) / readings, 0, 1)[:, np.newaxis] * LOAD
        filtered = chain().apply(grown + noise(200, seed))
        held += [squares(filtered, grown[at], at) < chi2.ppf(0.999, CHANNELS) for at in range(103, 150)]
    assert np.mean(held) > 0.95


def test_a_load_that_grows_is_not_taken_for_a_swing_as_fast_as_readings_unevenly_apart() -> None:
    false = 0
    for seed in range(30):
        times = np.arange(180.0) + 0.05 * np.random.default_rng([seed, 1]).standard_normal(180)
        grown = (1 - np.exp(-np.maximum(times - 100.4, 0.0) / 8))[:, np.newaxis] * LOAD
        filtered = chain().apply(grown + noise(180, seed), None, times.tolist())
        false += sum(bool(filtered.found[at]) and squares(filtered, grown[at], at) > 25 for at in range(103, 150))
    assert false <= 6, "readings in 30 plays"


def test_a_fit_finds_poles_and_the_spread_of_its_constant_is_as_stated() -> None:
    times, found, deviations = np.arange(-39.0, 1.0), [], []
    clean = LOAD + np.exp(-DECAY * times)[:, np.newaxis] * (
        np.cos(2 * np.pi * FREQUENCIES[0] * times)[:, np.newaxis] * LOAD / 4
        + np.sin(2 * np.pi * FREQUENCIES[1] * times)[:, np.newaxis] * BENT
    )
    for seed in range(60):
        values = clean + noise(40, seed)
        best = fit(times, values, Poles.none(), Band(0.3), slopes=False)
        for _ in range(2):
            best = refine(times, values, seek(best, times, values, Band(0.3)), Band(0.3), slopes=False, steps=4)
        assert sorted(best.poles.frequency / (2 * np.pi)) == pytest.approx(sorted(FREQUENCIES), abs=0.01)
        found.append(best.constant - LOAD)
        deviations.append(np.sqrt(np.diag(best.covariance)))
    assert np.std(found, axis=0) == pytest.approx(np.mean(deviations, axis=0), rel=0.35)


@pytest.mark.parametrize("readings", [8, 12, 20])
def test_of_twenty_frequencies_the_one_that_is_sought_leaves_least_in_a_fit_by_least_squares(readings: int) -> None:
    times, band = np.arange(1.0 - readings, 1.0), Band(0.05)

    def left(frequency: float) -> float:
        waves = np.stack([np.ones(readings), np.cos(frequency * times), np.sin(frequency * times)], axis=1)
        return float(np.square(values - waves @ np.linalg.lstsq(waves, values)[0]).sum())

    for seed in range(10):
        phase, mode = np.random.default_rng(seed).uniform(0, 6, size=(2, 1, CHANNELS))
        values = 50 * np.cos(0.2 * (1 + mode[0, 0]) * times[:, np.newaxis] + phase) + noise(readings, seed)
        (found,) = seek(fit(times, values, Poles.none(), band, slopes=False), times, values, band).frequency
        assert left(found) == pytest.approx(min(map(left, np.linspace(band.lowest, 0.99 * np.pi, 20))), rel=1e-3)


@pytest.mark.parametrize(("usual", "lowest"), [(3.8, 1.9), (4.9, 0.94), (5.7, 1.95)])
def test_readings_so_far_apart_that_every_swing_may_be_a_load_show_none(usual: float, lowest: float) -> None:
    """As of a line so slow that a reading comes only in every fourth or fifth slot, and never when it is due."""
    gaps = np.random.default_rng(1).uniform(0.7, 1.3, 40) * usual
    times = np.cumsum(gaps) - gaps.sum()
    values = noise(40, 2) + 5 * np.sin(times)[:, np.newaxis]
    band = Band.of(times, lowest)
    assert band.seem_still(np.linspace(band.lowest, band.highest, 400)).all()
    without = fit(times, values, Poles.none(), band, slopes=False)
    assert not len(seek(without, times, values, band).frequency)
    assert sought(Whole(times, values, band)) is None
    assert carried(without, Whole(times, values, band), checks=True) is None


@pytest.mark.parametrize(("apart", "each"), [(0.05, 1), (0.2, 1), (0.3, 5)])
def test_readings_unevenly_apart_show_a_swing_faster_than_half_their_rate(apart: float, each: int) -> None:
    """At a high rate, the filter takes the mean of `each` so many readings, and the swing is too fast for these."""
    far, unaware, held = [], [], []
    for seed in range(12):
        times = np.arange(160.0 * each) + apart * np.random.default_rng([seed, 1]).standard_normal(160 * each)
        later = np.maximum(times / each - 100.3, 0.0)[:, np.newaxis]
        swings = np.cos(2 * np.pi * FREQUENCIES[0] * later) * LOAD + np.cos(2 * np.pi * 0.88 * later) * 3 * BENT
        bent = (later > 0) * LOAD - (later > 0) * np.exp(-DECAY * later) * swings
        values = bent + noise(160 * each, seed)
        aware, unaware_of_times = (Chain(MEAN, CHANNELS, 1.0, PERIOD * each, unseen_swing=0.01) for _ in range(2))
        filtered, guessed = aware.apply(values, None, times.tolist()), unaware_of_times.apply(values)
        at = [118 * each, 130 * each]
        far.append(errors(filtered, LOAD, at))
        unaware.append(errors(guessed, LOAD, at))
        held += [squares(filtered, LOAD, one) < chi2.ppf(0.99, CHANNELS) for one in at]
    assert np.median(far) < 4
    assert np.median(unaware) > 3 * np.median(far)
    assert np.mean(held) > 0.9


def test_a_touch_of_a_beam_that_rings_is_known_before_its_own_swings_are() -> None:
    held = []
    for seed in range(12):
        bent = lifted(200, 100.4) + touched(200, 150.2 + seed / 12)
        filtered = chain().apply(bent + noise(200, seed))
        for at in range(152, 156):
            mean, covariance = filtered.mean_mm[at], filtered.covariance_mm2[at]
            if np.sqrt(np.trace(covariance)) < 0.3 * np.linalg.norm(mean):
                # Its size is not yet what it will be, but its shape is.
                unlike = mean - LOAD * (LOAD @ mean) / (LOAD @ LOAD)
                held.append(unlike @ np.linalg.solve(covariance, unlike) < chi2.ppf(0.99, CHANNELS - 1))
                break
    assert len(held) >= 11, "of 12 that are known within four readings"
    assert np.mean(held) > 0.9
