"""Zero tracking: a drift is followed, a contact never."""

import math

import numpy as np
import pytest

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


def left_of(minutes: float, slope_mm_per_min: float) -> tuple[FloatArray, FloatArray]:
    """Return what is left of a drift of both channels, one up and one down, and the zeros at its end."""
    time_min = np.arange(int(minutes * MINUTE))[:, np.newaxis] / MINUTE
    deflection = noise(len(time_min)) + slope_mm_per_min * time_min * np.array([1.0, -1.0])
    tracking = tracker()
    return deflection - tracking.track(deflection), tracking.zero_mm


def moves(zeros: FloatArray) -> list[int]:
    """Return the readings at which the zero of the first channel moves."""
    found: list[int] = (np.flatnonzero(np.diff(zeros[:, 0])) + 1).tolist()
    return found


@pytest.mark.parametrize(
    ("minutes", "slope_mm_per_min", "zero_mm", "left_mm"),
    [
        (10, 0.004, 0.04, 0.0),  # slow: followed
        (20, 0.0, 0.0, 0.0),
        (5, 0.1, 0.0, 0.5),  # faster than the rate: it leaves the band
        (30, 0.004, MAX_MM, 0.068),  # no more than it may
    ],
)
def test_a_slow_drift_is_followed_within_its_limits(
    minutes: float, slope_mm_per_min: float, zero_mm: float, left_mm: float
) -> None:
    left, zeros_mm = left_of(minutes, slope_mm_per_min)
    np.testing.assert_allclose(zeros_mm, [zero_mm, -zero_mm], atol=NOISE_MM)
    last = left[-MINUTE // 4 :]
    np.testing.assert_allclose(last.mean(axis=0), [left_mm, -left_mm], atol=0.15 * left_mm + 0.5 * NOISE_MM)
    if slope_mm_per_min < 0.1:
        np.testing.assert_allclose(last.std(axis=0), NOISE_MM, rtol=0.2)  # it adds no noise to speak of


@pytest.mark.parametrize("contact_mm", [1.0, BAND_MM + 5 * NOISE_MM, BAND_MM + NOISE_MM])
def test_a_contact_beyond_the_band_is_not_eaten_in_an_hour(contact_mm: float) -> None:
    tracking = tracker()
    tracking.track(noise(MINUTE))
    before_mm = tracking.zero_mm
    zeros = tracking.track(noise(60 * MINUTE) + np.array([contact_mm, 0.0]))  # one channel is enough
    np.testing.assert_array_equal(tracking.zero_mm, before_mm)
    np.testing.assert_array_equal(zeros[0], zeros[-1])


def test_a_load_within_the_band_is_taken_for_drift_at_the_stated_rate() -> None:
    tracking = tracker(1)
    zeros = tracking.track(np.full((2 * MINUTE, 1), 0.9 * BAND_MM))
    assert tracking.zero_mm == pytest.approx(0.9 * BAND_MM)
    assert np.diff(zeros[:, 0]).max() * MINUTE <= 0.02 * (1 + 1e-9)


@pytest.mark.parametrize(
    ("strange", "lasts", "expected"), [(1.0, 1, [*range(20, 51), *range(71, 100)]), (math.nan, 30, [*range(20, 51)])]
)
def test_for_a_second_after_a_contact_or_a_missing_channel_all_zeros_stand_still(
    strange: float, lasts: int, expected: list[int]
) -> None:
    deflection = np.full((100, 2), 0.004)
    deflection[50 : 50 + lasts, 1] = strange
    tracking = tracker()
    assert moves(tracking.track(deflection)) == expected
    assert np.all(np.isfinite(tracking.zero_mm))


@pytest.mark.parametrize(("gap", "waits"), [(CALM - 1, 0), (CALM, CALM - 1)])
def test_a_gap_keeps_the_zeros_and_only_one_of_a_second_restarts_the_second(gap: int, waits: int) -> None:
    tracking = tracker(1)
    tracking.track(np.full((50, 1), 0.004))
    zero_mm = tracking.zero_mm
    zeros = tracking.track(np.full((30, 1), 0.004), [gap, *[0] * 29])
    assert moves(zeros) == list(range(waits + 1, 30))
    assert zeros[0] == zero_mm
