"""Zeros that walk, block by block, against the statistics of whole covariances."""

import math

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.filters import Filtered, Rested, Walk, Zeros
from beamtouch_models.filters.significance import chi_square_quantile

NAN = math.nan
RATE_HZ, BLOCK = 50.0, 5
"""A tenth of a second."""
WALK = Walk(rate_mm_per_min=0.06, max_mm=0.5, start_mm=0.002)
NOISE_MM = np.array([0.004, 0.007, 0.005])
ZERO_MM, DEVIATION_MM = (0.012, -0.02, 0.005), (0.003, 0.006, 0.002)
WAY = np.array([1.0, -0.7, 2.0])


def zeros(ago_s: float = 0.0, walk: Walk = WALK, step_mm: float = 0.0) -> Zeros:
    return Zeros(walk, RATE_HZ, NOISE_MM, step_mm, 0.0, 3, Rested(ago_s, ZERO_MM, DEVIATION_MM))


def blocks(*mm: Floats) -> Floats:
    """Return blocks of readings that do not scatter."""
    return np.repeat(mm, BLOCK, axis=0)


def grown_mm(seconds: float, speed: float = 1.0) -> float:
    """Return the common drift; each zero drifts half as much by itself."""
    return speed * 0.001 * math.sqrt(seconds * max(seconds, 10.0))


def square(apart: Floats, variance: Floats, common_mm: float) -> float:
    """Return the squared distance in deviations; NaN is a channel that is out."""
    there = ~np.isnan(apart)
    covariance = np.diag(variance + (common_mm / 2) ** 2) + common_mm**2
    return float(apart[there] @ np.linalg.solve(covariance[np.ix_(there, there)], apart[there]))


@pytest.mark.parametrize("out", [[], [1], [0, 2]])
@pytest.mark.parametrize("ago_s", [3.0, 47.0])
def test_a_block_is_a_load_if_neither_noise_nor_the_drift_since_the_last_rest_explains_it(
    ago_s: float, out: list[int]
) -> None:
    way = WAY.copy()
    way[out] = NAN
    limit = chi_square_quantile(3 - len(out), 1e-6)
    far = square(way, np.square(DEVIATION_MM) + NOISE_MM**2 / BLOCK, grown_mm(ago_s + 0.1))
    for factor, is_load in ((0.999, False), (1.001, True)):
        tracking = zeros(ago_s)
        tracking.track(blocks(ZERO_MM + way * math.sqrt(factor * limit / far)))
        assert tracking.is_loaded is is_load


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_what_is_beyond_the_limit_from_the_tare_is_a_load_though_a_drift_could_be_as_large(sign: float) -> None:
    for part, is_load in ((0.999, False), (1.001, True)):
        tracking = Zeros(WALK, RATE_HZ, 0.005, 0.0, 0.0, 2, Rested(math.inf))
        tracking.track(blocks(np.array([NAN, sign * part * 0.5])))
        assert tracking.is_loaded is is_load


def test_zeros_and_their_variances_are_those_of_a_random_walk_given_all_blocks() -> None:
    tracking, out = zeros(2.0), {(1, 0), (2, 0), (2, 1)}
    ends_s, lost = (2.1, 2.2, 2.44, 2.54), (0, 0, 7, 0)
    seen = np.array(ZERO_MM) + 1e-3 * np.array([[1.2, 3.0, -1.5], [-2.0, 1.0, 0.8], [0.5, -2.0, 2.5], [2.0, 0.5, 0.3]])
    for number, (mean_mm, gap) in enumerate(zip(seen, lost, strict=True)):
        mean_mm[[channel for block, channel in out if block == number]] = NAN
        tracking.track(blocks(mean_mm), [gap, *[0] * (BLOCK - 1)])
    for channel in range(3):
        there = [number for number in range(4) if (number, channel) not in out]
        ends, walked_mm2 = np.array(ends_s)[there], 1e-6 * 10 * (1 + 0.5**2)
        spread_mm2 = DEVIATION_MM[channel] ** 2 + walked_mm2 * np.minimum.outer(ends, ends)
        with_noise = spread_mm2 + np.eye(len(there)) * NOISE_MM[channel] ** 2 / BLOCK
        gain = np.linalg.solve(with_noise, spread_mm2[-1])
        expected_mm = ZERO_MM[channel] + gain @ (seen[there, channel] - ZERO_MM[channel])
        assert tracking.zero_mm[channel] == pytest.approx(expected_mm, abs=1e-9)
        variance_mm2 = spread_mm2[-1, -1] - gain @ spread_mm2[-1]
        assert tracking.rested.deviation_mm is not None
        assert tracking.rested.deviation_mm[channel] == pytest.approx(math.sqrt(variance_mm2))
    assert tracking.rested.ago_s == 0.0
    before_mm, deviation_mm = tracking.zero_mm, np.array(tracking.rested.deviation_mm)
    tracked = tracking.track(blocks(seen[-1])[:3])
    assert tracking.rested.ago_s == pytest.approx(3 / RATE_HZ)
    for reading in range(3):
        common_mm = grown_mm((reading + 1) / RATE_HZ)
        assert tracked.common_mm[reading] == pytest.approx(common_mm)
        assert tracked.own_mm[reading] == pytest.approx(np.hypot(deviation_mm, common_mm / 2))
        assert tracked.zero_mm[reading].tolist() == before_mm.tolist()


@pytest.mark.parametrize(
    ("ratio", "excess", "is_calm"),
    [(1.99, 0.0, True), (2.01, 1.01, True), (3.99, 2.99, True), (4.01, 0.0, False)],
)
@pytest.mark.parametrize(("step_mm", "reading_mm"), [(0.0, 0.007), (0.03, 0.015)])
def test_a_block_that_scatters_twice_as_much_as_its_noise_weighs_less_and_one_four_times_as_much_none(
    ratio: float, excess: float, is_calm: bool, step_mm: float, reading_mm: float
) -> None:
    rows = blocks(ZERO_MM + np.array([0.001, 0.009, -0.001]))
    pattern = np.array([1.0, -2.0, 0.5, 1.5, -1.0])
    rows[:, 1] += pattern * reading_mm * math.sqrt(ratio / pattern.var(ddof=1))
    tracking = zeros(step_mm=step_mm)
    tracking.track(rows)
    prior_mm2 = 0.006**2 + 1.25 * grown_mm(0.1) ** 2
    block_mm2 = 0.007**2 / BLOCK + step_mm**2 / 12 + excess * reading_mm**2
    gain = prior_mm2 / (prior_mm2 + block_mm2) if is_calm else 0.0
    assert tracking.zero_mm[1] - ZERO_MM[1] == pytest.approx(gain * 0.009, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize(
    ("rate_hz", "slowest_period", "readings"), [(200.0, 0.0, 20), (25.0, 0.0, 4), (44.0, 0.0, 5), (50.0, 7.3, 8)]
)
def test_a_block_is_a_tenth_of_a_second_four_readings_and_a_period_at_least(
    rate_hz: float, slowest_period: float, readings: int
) -> None:
    tracking = Zeros(WALK, rate_hz, 0.004, 0.0, slowest_period, 1)
    tracking.track(np.full((readings - 1, 1), 0.001))
    assert tracking.zero_mm.tolist() == [0.0]
    tracking.track(np.full((1, 1), 0.001))
    assert tracking.zero_mm[0] > 0


@pytest.mark.parametrize(("lost", "block_mm"), [(4, 0.0016), (5, 0.004)])
def test_a_gap_as_long_as_a_block_begins_it_anew(lost: int, block_mm: float) -> None:
    tracking = Zeros(WALK, RATE_HZ, 0.02, 0.0, 0.0, 1, Rested(0.0, None, (1.0,)))
    tracking.track(np.zeros((3, 1)))
    tracking.track(np.full((2, 1), 0.004), [lost, 0])
    if lost >= BLOCK:
        assert tracking.zero_mm.tolist() == [0.0]
        tracking.track(np.full((3, 1), 0.004))
    assert tracking.zero_mm == pytest.approx([block_mm], rel=1e-3)


def test_a_load_is_gone_with_the_second_block_that_is_back() -> None:
    load, rest = np.array([0.2, 0.4, 0.1]), np.array(ZERO_MM)
    for gap, is_loaded in ((0, False), (4, False), (5, True)):
        tracking = zeros()
        for block, expected in ((rest, False), (load, True), (load, True), (rest, True)):
            tracking.track(blocks(block))
            assert tracking.is_loaded is expected
        # A longer gap may have held another load.
        tracking.track(blocks(rest), [gap, *[0] * (BLOCK - 1)])
        assert tracking.is_loaded is is_loaded
        # A single block elsewhere may be chance.
        tracking = zeros()
        tracking.track(blocks(rest, load, rest))
        assert not tracking.is_loaded


def test_a_load_that_stays_is_one_until_a_drift_is_usually_as_large() -> None:
    apart = np.array([0.06, 0.02, 0.045])
    tracking, later = Zeros(WALK, 4.0, NOISE_MM, 0.0, 0.0, 3, Rested(0.0, ZERO_MM, DEVIATION_MM)), list[float]()
    while tracking.is_loaded or not later:
        later.append(len(later) + 1.0)  # a block of four readings
        tracking.track(np.tile(ZERO_MM + apart, (4, 1)))
    squares = [square(apart, np.square(DEVIATION_MM), grown_mm(at_s)) for at_s in later]
    with_noise = [square(apart, np.square(DEVIATION_MM) + NOISE_MM**2 / 4, grown_mm(at_s)) for at_s in later]
    assert later[-1] > 30
    assert with_noise[-2] > 3 >= with_noise[-1]
    assert squares[-1] > with_noise[-1]


@pytest.mark.parametrize("out", [[], [1]])
def test_a_load_has_changed_if_neither_noise_nor_twice_the_drift_since_it_came_explains_it(out: list[int]) -> None:
    uncertain = Rested(0.0, ZERO_MM, (0.05, 0.05, 0.05))
    way = np.array([1.0, -0.7, 1.3])
    way[out] = NAN
    limit = chi_square_quantile(3 - len(out), 1e-6)
    # The load comes with the second of two blocks; one of them may hold the touch.
    far = square(way, np.full(3, 0.05**2) + NOISE_MM**2 / BLOCK, grown_mm(0.3))
    change = square(way, 2 * NOISE_MM**2 / BLOCK, grown_mm(0.1, speed=2.0))
    for factor, is_gone in ((0.999, False), (1.001, True)):
        back = math.sqrt(factor * limit / change)
        tracking = Zeros(WALK, RATE_HZ, NOISE_MM, 0.0, 0.0, 3, uncertain)
        begins = ZERO_MM + way * (math.sqrt(limit / far) + 0.5 * back)
        ends = begins - way * back
        tracking.track(blocks(begins, begins))
        assert tracking.is_loaded
        tracking.track(blocks(ends))
        assert tracking.is_loaded
        tracking.track(blocks(ends))
        assert tracking.is_loaded is not is_gone


def test_a_zero_that_was_out_moves_as_far_as_its_own_time_allows_and_alone() -> None:
    walk = Walk(rate_mm_per_min=0.6, max_mm=10.0, start_mm=1e-4)
    tracking = Zeros(walk, RATE_HZ, 0.001, 0.0, 0.0, 2)
    tracking.track(blocks(np.zeros(2)))
    for _ in range(10):
        tracking.track(blocks(np.array([0.0, NAN])))
    tracking.track(blocks(np.array([0.002, 0.1])))
    # Twice the rate is 0.02 mm a second; noise explains four deviations more.
    prior_mm2 = 1.25 * (0.1 * 10 * 1.1) * 1e-3
    block_mm2 = 0.001**2 / BLOCK
    leash_mm = 4 * math.sqrt(prior_mm2 * block_mm2 / (prior_mm2 + block_mm2))
    assert tracking.zero_mm[1] == pytest.approx(0.02 * 1.1 + leash_mm, rel=1e-3)
    assert 0.0019 < tracking.zero_mm[0] < 0.002


@pytest.mark.parametrize(("noise_mm", "step_mm"), [(0.0, 0.02), (0.003, 0.02), (0.005, 0.02)])
def test_a_mean_of_rounded_readings_is_no_surer_than_what_their_noise_leaves_of_the_step(
    noise_mm: float, step_mm: float
) -> None:
    """The characteristic function of the noise at one turn a step."""
    walk = Walk(rate_mm_per_min=1e-9, max_mm=1.0, start_mm=0.01)
    tracking = Zeros(walk, RATE_HZ, noise_mm, step_mm, 0.0, 1)
    for _ in range(100):
        tracking.track(np.zeros((BLOCK, 1)))
    left = math.exp(-0.5 * (2 * math.pi * noise_mm / step_mm) ** 2)
    assert tracking.rested.deviation_mm == pytest.approx([step_mm / math.sqrt(12) * left], rel=1e-3)


def ringing(found_at: int, readings: float, excess_mm2: tuple[float, float], rows: int) -> Filtered:
    """Return means of which one is what the beam swings about."""
    found = np.arange(rows) == found_at
    mean_mm = np.where(found[:, None], [0.003, -0.002], [0.7, 0.8])
    share, excess = np.full((rows, 2), 1 / readings), np.tile(np.diag(excess_mm2), (rows, 1, 1))
    return Filtered(mean_mm, share, np.array([0.004, 0.006]), ~np.zeros(rows, bool), found, excess, found)


@pytest.mark.parametrize(
    ("readings", "excess_mm2", "variance_mm2"),
    [
        # Rests of longer means than a block share readings.
        (10.0, (1e-6, 2e-6), (2 * (1.6e-5 / 10 + 1e-6), 2 * (3.6e-5 / 10 + 2e-6))),
        (3.0, (1e-6, 2e-6), (1.6e-5 / 3 + 1e-6, 3.6e-5 / 3 + 2e-6)),
        # None is surer than the mean of a block.
        (8.0, (-1.5e-6, 2e-6), (1.6e-5 / 5, 1.6 * (3.6e-5 / 8 + 2e-6))),
        # What is less sure than a reading, and than the zeros, says nothing.
        (1.0, (0.0, 0.0), (1.6e-5, 3.6e-5)),
        (1.0, (0.0, 1e-7), None),
        (1.0, (1e-7, 0.0), None),
    ],
)
def test_what_a_beam_swings_about_moves_the_zeros_as_a_block_does(
    readings: float, excess_mm2: tuple[float, float], variance_mm2: tuple[float, float] | None
) -> None:
    start_mm = 0.001
    walk = Walk(rate_mm_per_min=1e-6, max_mm=1.0, start_mm=start_mm)
    swings = np.array([3.0, -2.0, 2.5, -3.0, 1.0, 5.0, 5.0])[:, None] * np.array([0.1, 0.2])
    for rows, found_at, is_known in ((7, 4, True), (7, 6, False), (3, 0, True), (2, 1, False)):
        tracking = Zeros(walk, RATE_HZ, np.array([0.004, 0.006]), 0.0, 0.0, 2)
        tracking.track(swings, None, ringing(found_at, readings, excess_mm2, rows))
        if variance_mm2 is None or not is_known:
            assert tracking.zero_mm.tolist() == [0.0, 0.0]
        else:
            gain = start_mm**2 / (start_mm**2 + np.array(variance_mm2))
            assert tracking.zero_mm == pytest.approx(gain * [0.003, -0.002], rel=1e-5)


LIFTED_MM = np.array([0.05, -0.03])
SURE_MM = np.array([0.004, 0.005])
"""Standard deviation of the mean of a block."""


def half_lifted(blocks_since: int) -> Zeros:
    """Return zeros that a load left, after 40 s, at what a drift explains, so many blocks ago."""
    tracking = Zeros(WALK, RATE_HZ, SURE_MM * math.sqrt(BLOCK), 0.0, 0.0, 2)
    tracking.track(blocks(np.zeros(2), *[np.array([0.4, -0.4])] * 400, LIFTED_MM))
    assert tracking.is_loaded
    tracking.track(blocks(*[LIFTED_MM] * (1 + blocks_since)))
    assert not tracking.is_loaded
    assert tracking.zero_mm == pytest.approx(LIFTED_MM, rel=0.01)
    return tracking


@pytest.mark.parametrize(
    ("steps_mm", "blocks_since", "is_load"),
    [
        # Two blocks far back, within five seconds, show that the load was not yet gone.
        ([0.0 * LIFTED_MM] * 2, 50, False),
        ([0.0 * LIFTED_MM] * 2, 51, True),
        ([0.0 * LIFTED_MM], 20, True),
        ([0.0 * LIFTED_MM, -0.6 * LIFTED_MM], 20, True),
        # On the same way, or farther back than the rest was, it is another load.
        ([2.0 * LIFTED_MM] * 2, 20, True),
        ([-4.0 * LIFTED_MM] * 2, 20, True),
        # So does one block that is hardly another than the last one, within a minute.
        ([LIFTED_MM - 4.7 * SURE_MM * [1.0, -1.0]], 600, False),
        ([LIFTED_MM - 4.7 * SURE_MM * [1.0, -1.0]], 601, True),
        ([LIFTED_MM + 4.7 * SURE_MM * [1.0, -1.0]], 20, True),
    ],
)
def test_a_step_back_soon_after_a_load_seemed_gone_takes_the_zeros_back(
    steps_mm: list[Floats], blocks_since: int, is_load: bool
) -> None:
    tracking = half_lifted(blocks_since - len(steps_mm))
    tracking.track(blocks(*steps_mm))
    assert tracking.is_loaded is is_load
    if is_load:
        assert tracking.zero_mm == pytest.approx(LIFTED_MM, rel=0.01)
    else:
        # What the zeros may have drifted since the rest before that load is nearly all of their uncertainty.
        prior_mm2 = 1.25 * grown_mm(40.0 + (1 + blocks_since) / 10) ** 2
        gain = prior_mm2 / (prior_mm2 + SURE_MM**2)
        assert tracking.zero_mm == pytest.approx(gain * steps_mm[-1], rel=1e-3, abs=1e-9)
