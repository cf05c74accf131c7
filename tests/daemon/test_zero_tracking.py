"""Zero tracking: a drift is followed, a contact never."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_daemon.config.signal import ZeroTracking
from beamtouch_daemon.processing.zero_tracking import ZeroTracker
from beamtouch_models.filters import FloatArray

RATE_HZ = 20.0
NOISE_MM = 0.001
BAND_MM = 0.006
MAX_MM = 0.05
CALM = 20
"""Readings in a second."""
MINUTE = int(60 * RATE_HZ)


def tracker(channels: int = 2) -> ZeroTracker:
    return ZeroTracker(ZeroTracking(band_mm=BAND_MM, rate_mm_per_min=0.02, max_mm=MAX_MM), RATE_HZ, channels)


def noise(readings: int, channels: int = 2) -> FloatArray:
    return NOISE_MM * np.random.default_rng(4).standard_normal((readings, channels))


def seen(minutes: float, slope_mm_per_min: float) -> tuple[FloatArray, FloatArray]:
    """Return what is left of a drift of both channels, one up and one down, and the zeros at its end."""
    time_min = np.arange(int(minutes * MINUTE))[:, np.newaxis] / MINUTE
    deflection = noise(len(time_min)) + slope_mm_per_min * time_min * np.array([1.0, -1.0])
    tracking = tracker()
    return deflection - tracking.track(deflection), tracking.zero_mm


def test_a_slow_drift_is_followed() -> None:
    left, zero_mm = seen(10, 0.004)  # 0.04 mm in ten minutes
    np.testing.assert_allclose(zero_mm, [0.04, -0.04], atol=NOISE_MM)
    last = left[-5 * MINUTE :]
    assert np.abs(last.mean(axis=0)).max() < 0.5 * NOISE_MM
    np.testing.assert_allclose(last.std(axis=0), NOISE_MM, rtol=0.05)  # it adds no noise to speak of


def test_at_rest_the_zeros_stay_within_a_fraction_of_the_noise() -> None:
    _, zero_mm = seen(20, 0.0)
    assert np.abs(zero_mm).max() < 0.5 * NOISE_MM


def test_a_drift_faster_than_the_rate_is_not_followed_for_long() -> None:
    left, _ = seen(5, 0.1)
    assert np.abs(left[-1]).min() > 0.3


@pytest.mark.parametrize("contact_mm", [1.0, BAND_MM + 5 * NOISE_MM, BAND_MM + NOISE_MM])
def test_a_contact_beyond_the_band_is_not_eaten_in_an_hour(contact_mm: float) -> None:
    rest, hour = noise(MINUTE), noise(60 * MINUTE)
    tracking = tracker()
    tracking.track(rest)
    before_mm = tracking.zero_mm
    zeros = tracking.track(hour + np.array([contact_mm, 0.0]))  # one channel is enough
    np.testing.assert_array_equal(tracking.zero_mm, before_mm)
    np.testing.assert_array_equal(zeros[0], zeros[-1])


def test_for_a_second_after_a_contact_the_zeros_stand_still() -> None:
    deflection = np.full((100, 1), 0.004)
    deflection[50] = 1.0
    zeros = tracker(1).track(deflection)
    moves = np.flatnonzero(np.diff(zeros[:, 0])) + 1
    assert moves.tolist() == [*range(20, 51), *range(71, 100)]


def test_a_load_within_the_band_is_taken_for_drift() -> None:
    tracking = tracker(1)
    tracking.track(np.full((2 * MINUTE, 1), 0.9 * BAND_MM))
    assert tracking.zero_mm == pytest.approx(0.9 * BAND_MM)


def test_it_takes_off_no_more_than_it_may_either_way() -> None:
    left, zero_mm = seen(30, 0.004)
    np.testing.assert_array_equal(zero_mm, [MAX_MM, -MAX_MM])
    assert np.abs(left[-MINUTE:].mean(axis=0)).min() > 0.01


def test_it_moves_by_the_rate_at_most() -> None:
    deflection = np.full((MINUTE, 1), 0.005)
    zeros = tracker(1).track(deflection)
    assert np.diff(zeros[:, 0]).max() * MINUTE <= 0.02 * (1 + 1e-9)


def test_a_channel_that_is_not_good_holds_all_zeros_and_for_a_second_more() -> None:
    deflection = np.full((100, 2), 0.004)
    deflection[30:60, 1] = math.nan
    tracking = tracker()
    zeros = tracking.track(deflection)
    moves = np.flatnonzero(np.diff(zeros[:, 0])) + 1
    assert moves.tolist() == [*range(20, 31), *range(80, 100)]
    assert np.all(np.isfinite(tracking.zero_mm))


@pytest.mark.parametrize(("gap", "waits"), [(CALM - 1, 0), (CALM, CALM - 1)])
def test_a_gap_keeps_the_zeros_and_only_one_of_a_second_restarts_the_second(gap: int, waits: int) -> None:
    tracking = tracker(1)
    tracking.track(np.full((50, 1), 0.004))
    zero_mm = tracking.zero_mm
    zeros = tracking.track(np.full((30, 1), 0.004), [gap, *[0] * 29])
    assert np.flatnonzero(np.diff(zeros[:, 0])).tolist() == list(range(waits, 29))
    assert zeros[0] == zero_mm


def test_a_slow_surface_waits_for_ten_readings() -> None:
    assert ZeroTracker(ZeroTracking(band_mm=1.0, rate_mm_per_min=1.0, max_mm=1.0), 2.0, 1).calm_after == 10


streams = st.lists(st.tuples(*[st.floats(-0.008, 0.008) | st.just(math.nan)] * 2), min_size=1, max_size=30)


@given(start=streams, still=st.integers(0, 60), data=st.data())
def test_any_split_of_the_stream_gives_the_same_to_the_bit(
    start: list[tuple[float, float]], still: int, data: st.DataObject
) -> None:
    deflection = np.concatenate([np.array(start), np.full((still, 2), 0.003)])
    cuts = sorted(data.draw(st.lists(st.integers(0, len(deflection)), max_size=6), label="cuts"))
    at_once, split = tracker(), tracker()
    whole = at_once.track(deflection)
    pieces = [split.track(piece) for piece in np.split(deflection, cuts)]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    rest = np.full((CALM, 2), 0.001)
    np.testing.assert_array_equal(split.track(rest), at_once.track(rest))
