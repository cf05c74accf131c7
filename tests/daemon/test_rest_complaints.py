"""What is said of a beam that is not at rest, with its numbers, and where each limit of a tare and a recording lies."""

import math
import re

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.at_rest import (
    NotAtRestError,
    describe_motion,
    find_frozen,
    noise_of,
    readings_for_tare,
    rest_gaps,
    select_rest,
    steps_mm,
    without_line,
)
from beamtouch_models.filters import FloatArray

from .surfaces import CHANNEL, RATE_HZ, STEP_MM, surface_of

REST = 20_000.0
ALTERNATING = np.tile([1.0, -1.0], 100)
"""200 values with a mean of 0 in each half, and a standard deviation of 1."""
HALVES = np.repeat([-1.0, 1.0], 100)


def refusal(counts: FloatArray, surface: Surface) -> str:
    with pytest.raises(NotAtRestError) as raised:
        select_rest(counts, surface, {})
    return str(raised.value)


@pytest.mark.parametrize(("rate_hz", "readings"), [(10.0, 50), (50.0, 50), (50.5, 51), (200.0, 200)])
def test_a_tare_averages_a_second_and_50_readings_at_least(rate_hz: float, readings: int) -> None:
    assert readings_for_tare(rate_hz) == readings


def test_noise_is_that_which_is_stated_or_half_the_mean_square_of_successive_differences() -> None:
    slow = np.cumsum(np.tile([0.3, 0.1], 50))
    assert noise_of(slow, 0.02) == 0.02
    assert noise_of(np.array([0.0, 3.0, 1.0, 6.0]), None) == pytest.approx(math.sqrt((26 / 3) / 2))  # 3, -2 and 5


@pytest.mark.parametrize(
    ("spread_mm", "drift_mm", "step_mm", "said"),
    [
        (0.0219, 0.0, 0.002, ""),  # twice the noise and a step
        (0.0221, 0.0, 0.002, "standard deviation 0.022 mm, drift 0 mm, noise 0.01 mm"),
        # Ten deviations of a reading over the root of 200 readings.
        (0.001, 0.0090, 0.002, ""),
        (0.001, 0.0092, 0.002, "standard deviation 0.0047 mm, drift 0.0092 mm, noise 0.01 mm"),
        (0.001, -0.0092, 0.002, "standard deviation 0.0047 mm, drift 0.0092 mm, noise 0.01 mm"),
    ],
)
def test_a_channel_moves_if_it_scatters_or_drifts_more_than_noise_and_a_step_explain(
    spread_mm: float, drift_mm: float, step_mm: float, said: str
) -> None:
    gaps = 2.5 + spread_mm * ALTERNATING + drift_mm / 2 * HALVES
    assert describe_motion(gaps, step_mm, surface_of(noise_mm=0.01)) == said


def test_of_few_readings_a_drift_by_the_noise_of_one_is_motion() -> None:
    surface = surface_of(noise_mm=0.01)
    halves = np.repeat([0.0, 1.0], 8)  # 16 readings: ten deviations over the root of them would be 2.5
    assert describe_motion(0.0099 * halves, 0.0, surface) == ""
    assert describe_motion(0.0101 * halves, 0.0, surface) != ""


def test_a_tare_is_the_mean_of_each_channel_and_says_what_moved() -> None:
    counts = REST + np.column_stack([20 * ALTERNATING, 100 + 30 * ALTERNATING]) + np.arange(200)[:, np.newaxis] % 2
    assert rest_gaps(counts, surface_of(noise_mm=0.003)) == pytest.approx({"s1": 2.49995, "s2": 2.48995})
    counts[100:, 1] += 60
    with pytest.raises(NotAtRestError) as raised:
        rest_gaps(counts, surface_of(noise_mm=0.003))
    assert str(raised.value) == (
        "s2 moved: standard deviation 0.0042 mm, drift 0.006 mm, noise 0.003 mm; take everything off the beam and try "
        "again"
    )


def test_a_tare_needs_each_reading_of_each_channel() -> None:
    counts = np.full((200, 2), float(REST)) + ALTERNATING[:, np.newaxis]
    counts[7, 1], counts[9:11, 0] = math.nan, 65_535
    with pytest.raises(NotAtRestError) as raised:
        rest_gaps(counts, surface_of())
    said = "s1 is saturated in 2 of 200 readings, s2 is missing in 1 of 200 readings; check the sensor"
    assert str(raised.value) == said


@pytest.mark.parametrize(("bad", "kept"), [(10, 990), (11, None)])
def test_a_recording_may_lack_a_hundredth_of_its_readings(bad: int, kept: int | None) -> None:
    counts = REST + 20 * np.random.default_rng(1).standard_normal((1000, 2))
    counts[::90][:bad, 1] = 100.0
    counts[90 * (bad - 1), 1] = 65_535.0  # the first reading that is bad is named
    if kept is None:
        assert refusal(counts, surface_of()) == "s2 is out-of-range in 11 of 1000 readings; check the sensor"
    else:
        assert len(select_rest(counts, surface_of(), {})) == kept


def test_steps_are_those_of_the_type_or_the_larger_ones_that_show_up_to_a_harmless_one() -> None:
    counts = np.array([[REST, REST, REST], [REST + 3, REST, REST + 900], [REST + 7, REST, REST]], dtype=float)
    harmless_mm = 0.06  # a fiftieth of the range
    expected = [3 * STEP_MM, STEP_MM, harmless_mm]
    assert steps_mm(counts, surface_of(3)).tolist() == pytest.approx(expected)


def frozen(*values: int, **changes: object) -> list[str]:
    """Return the frozen ones of channels that take so many values in 400 readings."""
    counts = REST + np.column_stack([np.arange(400) % number for number in values])
    return find_frozen(counts.astype(float), surface_of(len(values), **changes))


def test_a_channel_is_frozen_if_another_one_takes_more_than_four_values() -> None:
    assert frozen(1, 4) == []
    assert frozen(1, 5, 2, 1) == ["s1", "s4"]
    assert frozen(1, 2, noise_mm=0.002) == ["s1"]
    assert frozen(1, 2, noise_mm=0.00001) == []  # less than a step: it may stand still


@pytest.mark.parametrize(("stuck_after_ms", "is_frozen"), [(1995.0, True), (2000.0, False)])
def test_a_channel_that_states_a_time_is_frozen_after_it(stuck_after_ms: float, is_frozen: bool) -> None:
    stated = {"stuck_after_ms": stuck_after_ms}  # 400 readings take 2 s
    channels = [CHANNEL | stated | {"name": "s1", "register": 0}, CHANNEL | {"name": "s2", "register": 4}]
    assert frozen(1, 9, channels=channels) == (["s1"] if is_frozen else [])


def test_fractional_numbers_that_never_change_show_neither_noise_nor_steps() -> None:
    floats = surface_of(3, {"type": "f32", "stuck_after_ms": 60_000.0})
    counts = REST + np.random.default_rng(1).standard_normal((1000, 3))
    counts[:, 1:] = REST
    assert refusal(counts, floats) == (
        "s2, s3: neither noise nor steps show, as the counts do not change; state noise_mm from the data sheet, with "
        "half a step at least"
    )


def moving(motion_mm: FloatArray) -> FloatArray:
    """Return counts of two channels with small noise of their own, the second one moving (readings,)."""
    noise = 20 * np.random.default_rng(2).standard_normal((len(motion_mm), 2))
    noise[:, 1] += motion_mm / STEP_MM
    return np.rint(REST + noise)


@pytest.mark.parametrize("minutes", [1, 3])
def test_a_zero_may_drift_by_a_fiftieth_of_the_range_in_each_minute(minutes: int) -> None:
    time = np.linspace(0, 1, round(60 * RATE_HZ * minutes) // 4)
    surface = surface_of(rate_hz=RATE_HZ / 4)
    allowed_mm = 0.06 * minutes / 0.8  # the first and the last fifth are compared
    assert len(select_rest(moving(0.97 * allowed_mm * (time - 0.5)), surface, {})) == len(time)
    said = refusal(moving(1.03 * allowed_mm * (time - 0.5)), surface)
    assert said == f"s2 drifted by {0.062 * minutes:.2g} mm; take everything off the beam, leave it alone and try again"


def test_a_touch_is_told_with_its_size_and_its_time() -> None:
    at_s = np.arange(round(60 * RATE_HZ)) / RATE_HZ
    said = refusal(moving(np.where(at_s >= 42.0, 0.03, 0.0)), surface_of())
    assert re.match(r"s2 moved by 0\.03[0-4]? mm after 42(\.0[0-9]*)? s; take everything off the beam, leave it", said)


def test_channels_that_shake_together_are_told_with_their_correlation() -> None:
    shaking = np.random.default_rng(4).standard_normal((12_000, 3))
    shaking[:, 2] = 0.6 * shaking[:, 0] + 0.8 * shaking[:, 2]
    first, third = (shaking[:, place] - shaking[:, place].mean() for place in (0, 2))
    alike = f"{first @ third / math.sqrt((first @ first) * (third @ third)):.2f}"
    assert refusal(np.rint(REST + 30 * shaking), surface_of(3)) == (
        f"s1 and s3 move together (correlation {alike}), so the beam moves; take everything off the beam, leave it "
        "alone and try again"
    )
    shaking[:, 2] = np.random.default_rng(5).standard_normal(12_000)
    shaking[:, 2] += 0.5 * shaking[:, 0]  # a correlation of 0.45
    assert len(select_rest(np.rint(REST + 30 * shaking), surface_of(3), {})) == 12_000


def test_values_without_their_line_are_what_a_fit_leaves() -> None:
    values = np.random.default_rng(3).standard_normal((41, 2)) + np.outer(np.arange(41), [0.3, -2.0]) + [7.0, 9.0]
    at = np.arange(41)
    expected = np.column_stack([column - np.polyval(np.polyfit(at, column, 1), at) for column in values.T])
    np.testing.assert_allclose(without_line(values), expected, atol=1e-12)
