"""Zeros that walk: a drift is followed at each rest, a load never, and what may have drifted since is stated."""

from collections.abc import Callable

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.filters import Chain, Mean, Rested, Tracked, Walk, Zeros
from beamtouch_models.filters.hurry import MOST_S, Hurry

RATE_HZ, NOISE_MM, CHANNELS = 200.0, 0.0045, 4
WALK = Walk(rate_mm_per_min=0.005, max_mm=0.1, start_mm=0.001)
SHAPE = np.array([0.3, 1.0, 0.9, 0.4])
"""Of a contact between the middle sensors."""
ALL, ONE, SOME = np.ones(4), np.array([0.0, 1.0, 0.0, 0.0]), np.array([1.0, -1.0, 0.0, 0.0])
Times = Callable[[Floats], Floats]


def zeros(walk: Walk = WALK, step_mm: float = 0.0) -> Zeros:
    return Zeros(walk, RATE_HZ, NOISE_MM, step_mm, 0.0, CHANNELS)


def times(seconds: float) -> Floats:
    return np.arange(round(seconds * RATE_HZ)) / RATE_HZ


def play(
    seconds: float, zero_mm: Times | None = None, load_mm: Times | None = None, tracking: Zeros | None = None
) -> tuple[Floats, Floats, Tracked]:
    """Return times, true zeros and what was tracked under loads of one shape; both are given by time."""
    at_s = times(seconds)
    true_mm = np.zeros((len(at_s), CHANNELS)) if zero_mm is None else zero_mm(at_s)
    loads_mm = np.zeros_like(true_mm) if load_mm is None else load_mm(at_s)[:, None] * SHAPE
    noise_mm = NOISE_MM * np.random.default_rng(7).standard_normal(true_mm.shape)
    return at_s, true_mm, (tracking or zeros()).track(true_mm + loads_mm + noise_mm)


def drift(um_per_min: float, channels: Floats = ALL) -> Times:
    return lambda at_s: 1e-3 * um_per_min / 60 * at_s[:, None] * channels


def pressed(begin_s: float, end_s: float, mm: float, *, within_s: float = 0.0) -> Times:
    """Return a load that comes and goes, at once or in some time."""
    ends = [begin_s, begin_s + max(within_s, 1e-6), end_s - max(within_s, 1e-6), end_s]
    return lambda at_s: np.interp(at_s, ends, [0.0, mm, mm, 0.0])


def every(pause_s: float) -> Times:
    """Return a load that is there for half of the time, of another size each time."""
    return lambda at_s: np.where(at_s % pause_s < pause_s / 2, 0.0, 0.1 + 0.3 * (at_s // pause_s % 5))


def deviation(tracked: Tracked) -> Floats:
    return np.hypot(tracked.own_mm, tracked.common_mm[:, None])


@pytest.mark.parametrize("channels", [ALL, ONE, SOME], ids=["all", "one", "some"])
@pytest.mark.parametrize("um_per_min", [0.5, 2.0, 5.0])
@pytest.mark.parametrize("pause_s", [1.0, 2.0, 4.0, 20.0])
def test_a_drift_is_followed_between_contacts_and_its_error_is_stated(
    pause_s: float, um_per_min: float, channels: Floats
) -> None:
    _, true_mm, tracked = play(120, drift(um_per_min, channels), every(pause_s))
    error = (tracked.zero_mm - true_mm) / deviation(tracked)
    assert np.abs(error[-2000:]).max() < 5
    assert (np.abs(error) < 2).mean() > 0.93


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "they stay, and become uncertain: by the stated rate times the time since the last rest.",
)
@pytest.mark.parametrize("channels", [ALL, ONE, SOME], ids=["all", "one", "some"])
def test_a_long_contact_widens_and_the_rest_after_it_brings_the_zeros_back(channels: Floats) -> None:
    at_s, true_mm, tracked = play(620, drift(5.0, channels), pressed(5, 605, 0.5))
    before, during, after = (int(second * RATE_HZ) for second in (4, 604, 606))
    assert tracked.common_mm[before] < 3e-4
    assert tracked.common_mm[during] == pytest.approx(0.05, rel=0.02)
    assert tracked.own_mm[during] == pytest.approx(0.025, rel=0.02)
    assert np.abs(tracked.zero_mm[during] - tracked.zero_mm[before]).max() < 1e-3
    assert np.abs(tracked.zero_mm[after:] - true_mm[after:]).max() < 2e-3
    assert at_s[after] == 606


@pytest.mark.promise("docs/explanation/readings-to-samples.md", "stays a load until a drift would usually be as large.")
def test_a_load_that_stays_for_hours_is_never_taken_for_drift() -> None:
    rate_hz = 4.0  # time counts, not readings
    at_s = np.arange(round(3 * 3600 * rate_hz)) / rate_hz
    load_mm = np.where(at_s > 10, 0.15, 0.0)[:, None] * SHAPE
    noise_mm = NOISE_MM * np.random.default_rng(7).standard_normal(load_mm.shape)
    tracked = Zeros(WALK, rate_hz, NOISE_MM, 0.0, 0.0, CHANNELS).track(load_mm + noise_mm)
    assert np.abs(tracked.zero_mm).max() < 2e-3


def test_a_light_load_that_comes_at_once_stays_a_load_though_a_drift_could_be_as_large() -> None:
    tracking = zeros()
    _, _, tracked = play(60, None, pressed(10, 100, 0.02), tracking)
    assert tracking.is_loaded
    assert np.abs(tracked.zero_mm).max() < 2e-3


@pytest.mark.promise("docs/reference/daemon-configuration.md", "What changes more than twice as fast is a load.")
@pytest.mark.parametrize(("mm", "most_mm"), [(0.25, 0.012), (1.0, 0.005)])
def test_a_load_that_creeps_on_faster_than_a_drift_moves_the_zeros_hardly(mm: float, most_mm: float) -> None:
    tracking = zeros()
    _, _, tracked = play(800, None, pressed(10, 1e6, mm, within_s=600), tracking)
    assert tracking.is_loaded
    assert np.abs(tracked.zero_mm).max() < most_mm


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "Nothing is followed farther than `max_mm` from the last tare",
)
@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Largest distance from the last tare that counts as drift, either way.",
)
def test_the_limit_from_the_last_tare_bounds_every_drift() -> None:
    tracking = zeros()
    _, _, tracked = play(25 * 60, drift(5.0), None, tracking)
    assert WALK.max_mm - 2e-3 < tracked.zero_mm.max() <= WALK.max_mm
    assert tracking.is_loaded


def test_a_start_under_a_load_takes_no_zero_from_it_and_the_lift_shows_the_rest() -> None:
    at_s, _, tracked = play(20, drift(5.0), lambda at_s: np.where(at_s < 10, 0.3, 0.0))
    assert np.abs(tracked.zero_mm[at_s < 10]).max() == 0.0
    assert np.abs(tracked.zero_mm[-1] - 0.005 / 3).max() < 2e-3


@pytest.mark.parametrize("lift_s", [0.3, 1.0, 3.0, 10.0, 30.0, 200.0])
def test_a_load_that_goes_slowly_after_a_long_contact_leaves_no_wrong_zero(lift_s: float) -> None:
    end_s = 70 + lift_s
    _, true_mm, tracked = play(end_s + 20, drift(5.0), pressed(5 - lift_s, end_s, 0.2, within_s=lift_s))
    assert np.abs(tracked.zero_mm[-1000:] - true_mm[-1000:]).max() < 2e-3


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "is noticed at rest, within half a minute if it is four times as fast as stated.",
)
@pytest.mark.parametrize("channels", [ALL, ONE, -ONE], ids=["all", "one", "one the other way"])
@pytest.mark.parametrize("pause_s", [2.0, 20.0])
def test_a_drift_four_times_as_fast_as_stated_is_told_before_a_zero_is_off_by_the_noise(
    pause_s: float, channels: Floats
) -> None:
    tracking, at_s = zeros(), times(30)
    true_mm = drift(20.0, channels)(at_s)
    values_mm = true_mm + every(pause_s)(at_s)[:, None] * SHAPE
    values_mm += NOISE_MM * np.random.default_rng(7).standard_normal(true_mm.shape)
    for begin in range(0, len(at_s), 20):
        tracked = tracking.track(values_mm[begin : begin + 20])
        if tracking.hurried is not None:
            break
    assert tracking.hurried is not None
    channel, mm_per_min, is_common = tracking.hurried
    assert mm_per_min == pytest.approx(0.02 * channels[channel], rel=0.5)
    assert is_common is bool((channels == channels[0]).all())
    assert np.abs(tracked.zero_mm[-1] - true_mm[begin + 19]).max() < NOISE_MM


@pytest.mark.parametrize("channels", [ALL, ONE, SOME], ids=["all", "one", "some"])
def test_a_drift_as_stated_and_a_load_that_comes_at_once_are_no_fast_drift(channels: Floats) -> None:
    for load_mm in (every(2.0), every(20.0), pressed(10, 100, 0.02), pressed(5, 65, 0.2, within_s=30.0)):
        tracking = zeros()
        play(100, drift(5.0, channels), load_mm, tracking)
        assert tracking.hurried is None


def test_zeros_that_were_off_since_the_tare_and_stay_so_are_no_drift() -> None:
    # Little drift is stated, and the noise is three times as large as what a zero may be off after a tare.
    for seed in range(20):
        random = np.random.default_rng(seed)
        tracking = Zeros(Walk(rate_mm_per_min=0.001, max_mm=0.05, start_mm=0.001), 100.0, 0.003, 0.0, 5.0, 6)
        off_mm = 6e-4 * random.standard_normal(6)
        for _ in range(20):
            tracking.track(off_mm + 0.003 * random.standard_normal((50, 6)))
            assert tracking.hurried is None


def test_a_drift_that_slows_down_is_told_no_longer() -> None:
    tracking = zeros()
    play(120, lambda at_s: 1e-3 * np.interp(at_s, [0, 30, 120], [0, 10, 10])[:, None] * ALL, None, tracking)
    assert tracking.hurried is None


def test_a_knock_at_rest_is_no_drift_at_once_and_one_in_time() -> None:
    knock: Times = lambda at_s: np.where(at_s > 20, 0.03, 0.0)[:, None] * ONE  # noqa: E731  # read as one
    at_s, true_mm, tracked = play(1200, knock)
    assert np.abs(tracked.zero_mm[at_s < 120]).max() < 2e-3
    assert np.abs(tracked.zero_mm[-1] - true_mm[-1]).max() < 2e-3


def test_a_channel_that_is_out_keeps_its_zero_becomes_uncertain_and_finds_it_again() -> None:
    tracking, (at_s, true_mm) = zeros(), (times(200), drift(5.0)(times(200)))
    values = true_mm + NOISE_MM * np.random.default_rng(3).standard_normal(true_mm.shape)
    values[(at_s > 20) & (at_s < 140), 3] = np.nan
    tracked = tracking.track(values)
    out = int(139 * RATE_HZ)
    assert tracked.own_mm[out, 3] > 5 * tracked.own_mm[out, 0]
    assert np.abs(tracked.zero_mm[out, :3] - true_mm[out, :3]).max() < 1.5e-3
    assert np.abs(tracked.zero_mm[-1] - true_mm[-1]).max() < 1.5e-3


def test_steps_of_an_adc_that_hide_the_noise_bound_what_a_rest_tells() -> None:
    step_mm = 0.02
    tracking = Zeros(WALK, RATE_HZ, 1e-4, step_mm, 0.0, CHANNELS)
    true_mm = drift(5.0)(times(600))
    tracked = tracking.track(np.round(true_mm / step_mm) * step_mm)
    error = np.abs(tracked.zero_mm - true_mm)
    assert error.max() < step_mm
    assert (error < 2 * deviation(tracked)).mean() > 0.9


@pytest.mark.parametrize(
    ("step_mm", "noise_mm", "variance_mm2"),
    [
        (0.0, 0.3, 0.3**2 / 20),  # of a mean of the 20 readings in 0.1 s
        (0.6, 0.0, 0.6**2 / 12),  # of a number that was rounded
        (0.5, 0.3, 0.3**2 / 20 + 0.5**2 / 12),
    ],
)
def test_a_rest_moves_a_zero_the_further_the_less_its_readings_deviate(
    step_mm: float, noise_mm: float, variance_mm2: float
) -> None:
    """By p / (p + R) of the way, for the variances p of the zero, and R of a block of readings."""
    walk, start_mm = Walk(rate_mm_per_min=1e-6, max_mm=10.0, start_mm=0.1), 0.1
    tracking = Zeros(walk, RATE_HZ, noise_mm, step_mm, 0.0, 1)
    tracking.track(np.full((19, 1), 0.05))
    assert tracking.zero_mm == [0.0]
    tracking.track(np.full((1, 1), 0.05))
    assert tracking.zero_mm == pytest.approx([0.05 * start_mm**2 / (start_mm**2 + variance_mm2)], rel=1e-4)


def test_a_rest_that_moves_one_zero_faster_than_a_drift_moves_all_by_the_same_part() -> None:
    """What comes slowly as a load does moves some channels faster than others."""
    walk, rested = Walk(rate_mm_per_min=0.6, max_mm=10.0, start_mm=1.0), Rested(9.9, (0.0, 0.0), (1.0, 1.0))
    tracking = Zeros(walk, RATE_HZ, 0.001, 0.0, 0.0, 2, rested)
    tracking.track(np.full((20, 2), [0.8, 0.12]))
    # Twice the rate is 0.2 mm in the 10 s since the last rest, a fourth of 0.8; noise explains four deviations more.
    leash_mm = 4 * 0.001 / 20**0.5
    assert tracking.zero_mm == pytest.approx([0.2 + leash_mm, 0.03 + leash_mm], rel=1e-4)


def test_a_light_touch_soon_after_a_long_contact_is_no_part_of_its_lift() -> None:
    contact, light_touch = pressed(5, 305, 0.3), pressed(320, 330, 0.02)

    def touched(at_s: Floats) -> Floats:
        return contact(at_s) + light_touch(at_s)

    at_s, true_mm, tracked = play(340, drift(-5.0), touched)
    assert np.abs(tracked.zero_mm - true_mm)[at_s > 310].max() < 2e-3


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "zeros may have drifted since, no farther than `max_mm`",
)
@pytest.mark.parametrize("hours", [1.0, 1e3, np.inf])
def test_a_start_long_after_the_tare_takes_what_a_drift_explains_for_rest(hours: float) -> None:
    tracking = Zeros(WALK, RATE_HZ, NOISE_MM, 0.0, 0.0, CHANNELS, Rested(hours * 3600))
    at_s, true_mm, tracked = play(10, lambda at_s: np.full((len(at_s), CHANNELS), 0.06), None, tracking)
    assert tracked.common_mm[0] == pytest.approx(WALK.max_mm / 3**0.5)
    assert np.abs(tracked.zero_mm - true_mm)[at_s > 1].max() < 2e-3


def test_a_start_long_after_the_tare_under_a_load_is_uncertain_until_the_lift() -> None:
    tracking = Zeros(WALK, RATE_HZ, NOISE_MM, 0.0, 0.0, CHANNELS, Rested(3600.0))
    at_s, true_mm, tracked = play(20, lambda at_s: np.full((len(at_s), CHANNELS), 0.06), pressed(-1, 10, 0.3), tracking)
    assert np.abs(tracked.zero_mm[at_s < 10]).max() == 0.0
    assert (np.abs(tracked.zero_mm - true_mm) < 2 * deviation(tracked)).mean() > 0.9
    assert np.abs(tracked.zero_mm - true_mm)[at_s > 11].max() < 2e-3


@pytest.mark.parametrize("lost", [1, 19, 4000])
def test_lost_readings_are_time_in_which_zeros_may_have_drifted(lost: int) -> None:
    tracking = zeros()
    tracking.track(np.zeros((400, CHANNELS)))
    (common_mm,) = tracking.track(np.zeros((1, CHANNELS)), [lost]).common_mm
    assert common_mm == pytest.approx(float(WALK.grown_mm((lost + 1) / RATE_HZ)))


@pytest.mark.parametrize(
    ("frequency_hz", "damping_per_s", "rest_s"), [(23.0, 0.8, 0.6), (6.5, 4.0, 0.3)], ids=["fast", "slow, short rests"]
)
@pytest.mark.parametrize("drift_um_per_min", [pytest.param(0.0, marks=pytest.mark.soak), 4.0])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2, 3))])
def test_a_beam_that_rings_from_each_touch_to_the_next_has_zeros_that_are_known(
    drift_um_per_min: float, seed: int, frequency_hz: float, damping_per_s: float, rest_s: float
) -> None:
    """No block of readings is calm then. Loads bend it by six deviations of the noise and more."""
    rate_hz, noise_mm, period = 100.0, 0.004, max(10.0, 100.0 / frequency_hz)
    random, shape = np.random.default_rng(seed), np.array([0.4, 0.9, 1.0, 0.5])
    chain = Chain(Mean("growing-mean", 4, 200, 6 * noise_mm), 4, noise_mm, period, unseen_swing=0.01)
    tracking = Zeros(Walk(0.0045, 0.05, 0.001), rate_hz, noise_mm, 0.0, period, 4)
    off, stated = [], []
    at_s = np.arange(0.0, 90.0, 1 / rate_hz)
    true_mm = drift_um_per_min / 60e3 * at_s[:, None] * np.ones(4)
    bent_mm = true_mm + noise_mm * random.standard_normal(true_mm.shape)
    for touch_s in np.arange(1.0, 90.0, 0.9 + rest_s):
        load_mm = 10 ** random.uniform(-1.6, 0)
        for change_s, size_mm in ((touch_s, load_mm), (touch_s + 0.9, -load_mm)):
            later_s = np.maximum(at_s - change_s, 0.0)
            rings = (at_s >= change_s) * (
                1 - np.exp(-damping_per_s * later_s) * np.cos(2 * np.pi * frequency_hz * later_s)
            )
            bent_mm += size_mm * rings[:, None] * shape
    for first in range(0, len(at_s), 100):
        values = bent_mm[first : first + 100]
        tracked = tracking.track(values, None, chain.apply(values))
        off.append(tracked.zero_mm - true_mm[first : first + 100])
        stated.append(np.hypot(tracked.common_mm[:, None], tracked.own_mm))
    assert np.concatenate(stated[-10:]).max() < 0.005
    assert np.percentile(np.abs(np.concatenate(off)) / np.concatenate(stated), 99.5) < 4


def test_a_drift_that_is_over_is_soon_forgotten_however_long_it_was() -> None:
    hurry, at_s = Hurry(0.001), 0.0
    for _ in range(1200):
        at_s += 0.1
        hurry.add(at_s, 0.1, np.full(3, 1e-3 * at_s), np.full(3, 1e-5), strains=True)
    assert hurry.hurried is not None
    for _ in range(round(10 * MOST_S) + 1):
        at_s += 0.1
        hurry.add(at_s, 0.1, np.full(3, 0.12), np.full(3, 1e-5), strains=False)
    assert hurry.hurried is None


def test_the_last_rest_is_stated_as_it_was_given_with_the_time_since() -> None:
    """For the next start of a daemon."""
    rested = Rested(3.0, (3e-4, 0.0, -2e-4, 1e-4), (0.002, 0.001, 0.003, 0.004))
    tracking = Zeros(WALK, RATE_HZ, NOISE_MM, 0.0, 0.0, CHANNELS, rested)
    assert tracking.rested.ago_s == 3.0
    assert tracking.rested.zero_mm == rested.zero_mm
    assert tracking.rested.deviation_mm == pytest.approx(rested.deviation_mm)
    tracking.track(np.full((100, CHANNELS), np.nan))  # lost readings are time, too
    assert tracking.rested.ago_s == 3.5
    assert tracking.rested.zero_mm == rested.zero_mm
    _, _, tracked = play(10.0, tracking=tracking)
    assert 0.0 <= tracking.rested.ago_s <= 1.0
    assert tracking.rested.zero_mm == pytest.approx(tuple(tracked.zero_mm[-1]), abs=1e-3)
