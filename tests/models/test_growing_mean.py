"""The growing mean: all readings since the load last changed, and never those before."""

import numpy as np
import pytest
from scipy.stats import chi2

from beamtouch_models.filters import Chain, Filtered, FloatArray, Mean

LONGEST = 200
CHANNELS = 4
SPIKE = 6.0
PERIOD = 20.0
"""Of the slowest motion, in readings."""
ALONG = np.array([0.3, 0.6, 0.6, 0.4])
ACROSS = np.array([0.8, -0.3, -0.3, 0.4])
"""Directions of a load and of its motion."""


def noise(readings: int, seed: int, times: int | None = None) -> FloatArray:
    shape = (readings, CHANNELS) if times is None else (times, readings, CHANNELS)
    return np.random.default_rng(seed).standard_normal(shape)


def grown(
    values: FloatArray, longest: int = LONGEST, period: float = 0.0, spike: float | None = SPIKE, fewest: int = 1
) -> Filtered:
    """Filter readings in units of their noise."""
    channels = values.shape[1]
    return Chain(Mean("growing-mean", fewest, longest, spike), channels, 1.0, period).apply(values)


def without(dead: int | None, values: FloatArray) -> FloatArray:
    """Return readings without those of a channel that has died."""
    values[:, [] if dead is None else [dead]] = np.nan
    return values


def stepped(size: float, readings: int, at: int) -> FloatArray:
    """Return a step of a size, in units of the noise over all channels."""
    there = (np.arange(readings) >= at).astype(np.float64)
    step: FloatArray = size * there[:, np.newaxis] * ALONG / np.linalg.norm(ALONG)
    return step


@pytest.mark.parametrize("size", [10.0, pytest.param(1e6, marks=pytest.mark.soak)])
def test_after_a_touch_all_readings_since_it_count_and_the_error_is_that_of_their_mean(size: float) -> None:
    truth = stepped(size, 401, 200)
    filtered = [grown(truth + one) for one in noise(401, 2, 50)]
    readings = np.array([one.readings for one in filtered])
    assert np.median(readings[:, 199]) == 200
    # The first reading waits for the second, as it may be a spike.
    for later in (1, 2, 5, 20, 100, 199):
        assert np.median(readings[:, 200 + later]) == later + 1
        assert (readings[:, 200 + later] <= later + 1).all()
    errors = np.array([((one.mean_mm - truth) ** 2).sum(axis=1) * one.readings for one in filtered])
    share = np.mean(errors < chi2.ppf(0.95, CHANNELS), axis=0)
    assert share[:200].mean() > 0.93
    assert share[203:].mean() > 0.92
    assert share[201:203].mean() > 0.85


@pytest.mark.promise(
    "docs/explanation/speed-or-accuracy.md",
    "While the load moves, the mean is short, but has at least `window` readings",
)
@pytest.mark.parametrize("speed", [0.03, 0.3, 3.0])
def test_while_a_load_moves_the_mean_lags_less_than_its_noise_and_it_grows_again_once_it_lies(speed: float) -> None:
    way = np.clip(np.arange(900) - 300, 0, 300)[:, np.newaxis] * speed * ACROSS / np.linalg.norm(ACROSS)
    filtered = [grown(way + one) for one in noise(900, 5, 12)]
    normalised = np.array([((one.mean_mm - way) ** 2).sum(axis=1) * one.readings for one in filtered])
    held = normalised < chi2.ppf(0.95, CHANNELS)
    moving, lying = slice(450, 600), slice(605, 800)
    assert held[:, moving].mean() > 0.85
    assert held[:, lying].mean() > 0.85
    assert np.median([one.readings[-1] for one in filtered]) == LONGEST


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "The newest one waits for the next one, as it may be a touch.",
)
def test_a_lone_spike_is_left_out_of_its_channel_and_delays_the_others_by_one_reading() -> None:
    values = noise(100, 6)
    values[60, 1] += 40
    filtered = grown(values)
    assert (1 / filtered.relative_variance[59:62]).round().tolist() == [[60] * 4, [60] * 4, [62, 61, 62, 62]]
    good = np.delete(values[:62, 1], 60).mean()
    assert filtered.mean_mm[61, 1] == pytest.approx(good, abs=1e-4)
    np.testing.assert_array_equal(filtered.mean_mm[60], filtered.mean_mm[59])
    assert filtered.moves[60]


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Longest time that a mean spans. It bounds `readings` of the samples.",
)
@pytest.mark.parametrize("longest", [1, 2, 3, pytest.param(10_000, marks=pytest.mark.soak)])
def test_a_mean_grows_to_its_longest_and_no_further(longest: int) -> None:
    readings = min(2 * longest + 10, 10_050)
    filtered = grown(1e-3 * noise(readings, 10), longest)
    assert filtered.readings[-1] == pytest.approx(longest)
    assert filtered.readings[0] == 1


def test_sums_stay_exact_however_large_and_however_many_the_readings_were() -> None:
    mean = Mean("growing-mean", longest=20)
    chain = Chain(mean, 1, step_mm=2.0)
    for _ in range(10):
        chain.apply(np.full((10_000, 1), 1e8))
    new = Chain(mean, 1, step_mm=2.0)
    after = np.full((60, 1), 0.1)
    np.testing.assert_array_equal(chain.apply(after).mean_mm[-20:], new.apply(after).mean_mm[-20:])


@pytest.mark.promise(
    "docs/explanation/speed-or-accuracy.md",
    "It carries the note `unsteady` until readings agree for a quarter of the beam's slowest period",
)
@pytest.mark.parametrize("dead", [None, 2])
def test_a_touch_of_a_calm_beam_is_as_sure_as_a_reading_until_a_quarter_of_the_period_agrees(dead: int | None) -> None:
    filtered = grown(without(dead, stepped(100, 300, 200) + noise(300, 11)), period=PERIOD)
    covariance = filtered.covariance_mm2
    there = np.diag([float(channel != dead) for channel in range(CHANNELS)])
    assert filtered.moves[200:204].all()
    assert not filtered.moves[204:230].any()
    for readings in (2, 3, 4):
        np.testing.assert_allclose(covariance[199 + readings], there * (1 + 1 / readings), atol=1e-9)
    np.testing.assert_allclose(covariance[204], there / 5)


@pytest.mark.promise(
    "docs/explanation/speed-or-accuracy.md",
    "After a touch so small that noise may hide the swings, they must agree for a whole period.",
)
def test_a_touch_so_small_that_its_swing_hides_in_the_noise_is_at_rest_after_a_whole_period() -> None:
    since = np.arange(300) - 199.5
    swing = np.where(since > 0, 1 - np.cos(2 * np.pi * since / PERIOD), 0.0)[:, np.newaxis]
    claims, early = 0, slice(202, 200 + int(PERIOD))
    for one in noise(300, 13, 60):
        filtered = grown(stepped(3, 300, 0) * swing + one, period=PERIOD)
        shown = filtered.mean_mm[early] @ ALONG > 3 * np.linalg.norm(ALONG)
        claims += int((shown & ~filtered.moves[early]).sum())
    assert claims < 0.02 * 60 * PERIOD


@pytest.mark.parametrize("dead", [None, 2])
@pytest.mark.parametrize("period", [6.3, 9.1, 20.0])
def test_turning_points_of_a_swing_of_few_readings_are_no_touch(period: float, dead: int | None) -> None:
    time = np.arange(400)
    for seed, swing in enumerate((4.0, 8.0, 16.0, 50.0)):
        phase = np.random.default_rng(seed).uniform(0, 2 * np.pi)
        swings = swing * np.sin(2 * np.pi * time / period + phase)[:, np.newaxis] * ALONG / ALONG.max()
        found = grown(without(dead, swings + noise(400, seed)), 100, period, spike=None, fewest=5)
        # Only since a touch is a mean of fewer.
        assert (found.readings[50:] >= 5).all()


def test_a_doubtful_reading_after_a_touch_leaves_it_open_whether_the_beam_rings() -> None:
    values = stepped(100, 203, 200) + noise(203, 25)
    values[202] -= values[201] / 2
    filtered = grown(values, period=PERIOD)
    along = ALONG / np.linalg.norm(ALONG)
    np.testing.assert_allclose(filtered.readings[201:], 2)
    assert along @ filtered.covariance_mm2[201] @ along < 2
    assert along @ filtered.covariance_mm2[202] @ along > 50**2


def test_a_touch_in_a_gap_is_no_motion_once_enough_has_been_seen() -> None:
    values = stepped(100, 260, 200) + noise(260, 27)
    values[200:220] = np.nan
    filtered = grown(values, period=PERIOD, fewest=4)
    assert filtered.moves[220:224].all()
    assert not filtered.moves[228:].any()


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "A load that lay still before a gap keeps its mean after it",
)
def test_a_gap_forgets_nothing_that_is_still_true() -> None:
    values, came = stepped(0, 260, 0) + noise(260, 28), np.ones(260, np.bool_)
    came[150:170] = False
    chain = Chain(Mean("growing-mean", longest=LONGEST, spike_mm=SPIKE), CHANNELS, 1.0)
    lost = np.diff(np.flatnonzero(came), prepend=-1) - 1
    filtered = chain.apply(values[came], lost.tolist())
    # The first reading after the gap is in a mean with all those before it.
    assert filtered.readings[149:151] == pytest.approx([150, 151])


@pytest.mark.parametrize(
    "mean", [Mean("growing-mean", longest=LONGEST), Mean("moving-average", 4), Mean(spike_mm=SPIKE)]
)
def test_after_a_gap_of_any_length_the_filter_is_as_after_one_that_it_does_not_look_back_over(mean: Mean) -> None:
    values = noise(40, 30)
    long, longer = (
        Chain(mean, CHANNELS, 1.0, PERIOD).apply(values, [0] * 20 + [lost] + [0] * 19) for lost in (10_000, 10**15)
    )
    np.testing.assert_array_equal(longer.mean_mm, long.mean_mm)
    np.testing.assert_array_equal(longer.readings, long.readings)


@pytest.mark.parametrize("lost", [0, 3])
@pytest.mark.parametrize("spike_at", [None, 419])
def test_a_mean_of_readings_at_rest_is_the_last_of_all_and_a_touch_after_them_is_seen_alike(
    spike_at: int | None, lost: int
) -> None:
    values = stepped(100, 520, 470) + noise(520, 29)
    if spike_at is not None:
        values[spike_at] += 50  # the newest reading of a block: it waits for the next one
    each, few = (Chain(Mean("growing-mean", 1, LONGEST, SPIKE), CHANNELS, 1.0, PERIOD) for _ in "ab")
    for start in range(0, 460, 20):
        block, skipped = values[start : start + 20], [0] * 7 + [lost] + [0] * 12
        whole, newest = each.apply(block, skipped), few.apply_at_rest(block, skipped)
        for name in ("mean_mm", "relative_variance", "moves", "lags"):
            np.testing.assert_array_equal(getattr(newest, name), getattr(whole, name)[-1:])
    touched, seen = each.apply(values[460:]), few.apply(values[460:])
    np.testing.assert_array_equal(seen.mean_mm, touched.mean_mm)
    np.testing.assert_array_equal(seen.moves, touched.moves)
    stated, expected = (np.sqrt(np.diagonal(one.covariance_mm2, axis1=1, axis2=2)) for one in (seen, touched))
    np.testing.assert_allclose(stated, expected, rtol=0.02)


@pytest.mark.parametrize("longest", [1, 4, 40])
def test_a_mean_that_is_shorter_than_what_proves_rest_comes_to_rest(longest: int) -> None:
    assert grown(noise(2000, 26), longest, period=200.0).moves[500:].mean() < 0.01


@pytest.mark.parametrize("fewest", [4, 20])
def test_at_rest_a_mean_is_seldom_cut_or_lags_and_hardly_ever_by_the_noise_of_its_fewest_readings(fewest: int) -> None:
    filtered = [grown(one, period=5.0 * fewest, fewest=fewest) for one in noise(1000, 22, 10)]
    assert np.mean([one.readings[LONGEST:] < LONGEST for one in filtered]) < 0.01
    assert np.mean([one.lags[LONGEST:] for one in filtered]) < 0.3
    traces = np.concatenate([np.trace(one.covariance_mm2[LONGEST:], axis1=1, axis2=2) for one in filtered])
    moves = np.concatenate([one.moves[LONGEST:] for one in filtered])
    assert (traces[~moves] > 1.5 * CHANNELS / fewest).mean() < 0.002


def test_readings_of_unknown_noise_are_averaged_since_they_last_changed() -> None:
    values = np.repeat([0.0, 1.0], [50, 5])[:, np.newaxis]
    filtered = Chain(Mean("growing-mean", 4, 200), 1).apply(values)
    assert filtered.mean_mm[[49, -1], 0].tolist() == [0.0, 1.0]
