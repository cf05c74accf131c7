"""The filters against theory, in numbers that follow from a formula stated beside them."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import (
    Chain,
    FloatArray,
    Stage,
    adaptive_stage,
    low_pass_stage,
    moving_average_stage,
    smoothing,
    spike_stage,
)

RATE_HZ = 200.0
WHITE = np.random.default_rng(7).standard_normal((60_000, 2))


def filtered(stage: Stage, values: FloatArray) -> FloatArray:
    return Chain((stage,), values.shape[1]).apply(values).mean_mm


def column(*values: float) -> FloatArray:
    return np.array(values, dtype=np.float64)[:, np.newaxis]


@pytest.mark.parametrize("window", [1, 2, 4, 16])
def test_a_moving_average_passes_white_noise_at_one_over_root_n(window: int) -> None:
    averaged = filtered(moving_average_stage(window), WHITE)
    assert np.std(averaged[window:]) == pytest.approx(1 / math.sqrt(window), rel=0.02)


def test_a_step_is_through_a_moving_average_after_n_readings() -> None:
    averaged = filtered(moving_average_stage(4), column(0, 0, 0, 0, 1, 1, 1, 1, 1))
    assert averaged[:, 0].tolist() == [0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1]


@pytest.mark.parametrize("factor", [0.05, 0.3, 1.0])
def test_a_low_pass_passes_white_noise_at_root_a_over_2_minus_a(factor: float) -> None:
    smoothed = filtered(low_pass_stage(factor), WHITE)
    assert np.std(smoothed[1000:]) == pytest.approx(math.sqrt(factor / (2 - factor)), rel=0.02)


def test_after_n_readings_a_low_pass_leaves_1_minus_a_to_the_n_of_a_step() -> None:
    smoothed = filtered(low_pass_stage(0.3), column(0, *[1] * 20))
    np.testing.assert_allclose(1 - smoothed[:, 0], 0.7 ** np.arange(21), rtol=1e-12)


def test_at_its_cutoff_a_low_pass_is_3_db_down() -> None:
    time_s = np.arange(20_000) / RATE_HZ
    tone = np.sin(2 * np.pi * 2.0 * time_s)[:, np.newaxis]
    smoothed = filtered(low_pass_stage(smoothing(2.0, RATE_HZ)), tone)
    gain = np.std(smoothed[10_000:]) / np.std(tone[10_000:])
    assert gain == pytest.approx(1 / math.sqrt(2), rel=0.02)


def test_a_single_spike_never_passes_and_a_step_passes_one_reading_later() -> None:
    cleaned = filtered(spike_stage(0.5), column(0, 0, 9, 0, 0, 5, 5, 5))
    assert cleaned[:, 0].tolist() == [0, 0, 0, 0, 0, 0, 5, 5]


def test_noise_below_the_limit_passes_the_spike_filter_untouched() -> None:
    cleaned = filtered(spike_stage(12.0), WHITE)
    np.testing.assert_array_equal(cleaned, WHITE)


def test_with_no_limit_the_spike_filter_is_a_median_of_three() -> None:
    cleaned = filtered(spike_stage(1e-12), WHITE)
    # The median of three has the variance 1 - sqrt(3) / pi; David & Nagaraja, Order Statistics, 2003, ch. 3.
    assert np.var(cleaned[2:]) == pytest.approx(1 - math.sqrt(3) / math.pi, rel=0.02)


def test_an_adaptive_mean_is_at_the_new_level_with_the_second_reading_of_a_step() -> None:
    averaged = filtered(adaptive_stage(4, 1.5), column(0, 0, 0, 0, 5, 7, 6, 6, 6, 6))
    assert averaged[:, 0].tolist() == [0, 0, 0, 0, 0, 6, 6, 6, 6.25, 6]


def test_after_a_step_the_noise_of_an_adaptive_mean_falls_as_one_over_root_n() -> None:
    noise = np.random.default_rng(1).standard_normal((60, 4000))  # the channels are the ensemble
    averaged = filtered(adaptive_stage(16, 8.0), noise + np.where(np.arange(60) < 30, 0, 100)[:, np.newaxis])
    readings = np.minimum(np.arange(2, 31), 16)
    np.testing.assert_allclose(averaged[31:].std(axis=1), 1 / np.sqrt(readings), rtol=0.06)
    np.testing.assert_allclose(averaged[31:].mean(axis=1), 100, atol=5 / math.sqrt(2 * 4000))
    assert np.abs(averaged[30].mean()) < 5 / math.sqrt(16 * 4000)  # the first reading of the step waits


def test_in_an_adaptive_mean_all_channels_restart_together() -> None:
    values = np.array([[0.0, 0], [0, 0], [0, 0], [9, 0.2], [9, 0.4], [9, 0.3]])
    averaged = filtered(adaptive_stage(8, 1.0), values)
    np.testing.assert_allclose(averaged[4:], [[9, 0.3], [9, 0.3]])


def test_a_lone_spike_never_enters_an_adaptive_mean() -> None:
    averaged = filtered(adaptive_stage(4, 1.0), column(0, 0, 9, 0, -9, 9, 0, 0))
    assert averaged[:, 0].tolist() == [0] * 8


def test_an_adaptive_mean_that_knows_nothing_but_spikes_begins_anew() -> None:
    averaged = filtered(adaptive_stage(4, 1.0), column(0, 0, 9, -9, 9, -9, 9, -9))
    assert averaged[:, 0].tolist() == [0, 0, 0, 0, 0, -9, -9, -9]  # after three, all that the mean remembers


def test_an_adaptive_mean_follows_a_slow_drift_within_the_step() -> None:
    drift = column(*(np.arange(1000) * 0.01))
    averaged = filtered(adaptive_stage(1000, 0.5), drift)
    assert np.abs(averaged - drift).max() <= 0.5 + 0.01


@pytest.mark.parametrize("window", [2, 5, 16])
def test_at_rest_an_adaptive_mean_of_n_passes_white_noise_at_one_over_root_n(window: int) -> None:
    averaged = filtered(adaptive_stage(window, 6.5), WHITE)
    expected = filtered(moving_average_stage(window), WHITE)
    assert np.std(averaged[window:]) == pytest.approx(1 / math.sqrt(window), rel=0.02)
    np.testing.assert_allclose(averaged, expected, atol=1e-12)  # no restart, nothing left out


def test_false_restarts_are_as_rare_as_stated() -> None:
    averaged = filtered(adaptive_stage(8, 2.0), WHITE)
    pairs = (WHITE[1:] + WHITE[:-1]) / 2  # what comes out at a restart
    restarts = int(np.all(np.abs(averaged[1:] - pairs) < 1e-12, axis=1).sum())
    assert 0 < restarts < 2 * math.exp(-(2.0**2) * 2 / 4) * len(WHITE)  # two channels, n = 2 being the worst


def test_at_six_standard_deviations_there_is_no_false_restart_in_a_million_readings() -> None:
    noise = np.random.default_rng(5).standard_normal((62_500, 16))
    averaged = filtered(adaptive_stage(16, 6.0), noise)
    expected = filtered(moving_average_stage(16), noise)
    np.testing.assert_allclose(averaged, expected, atol=1e-12)


def test_a_bad_reading_gives_nothing_and_an_adaptive_mean_goes_on() -> None:
    averaged = filtered(adaptive_stage(4, 4.0), column(1, 2, math.nan, 3, 9, math.nan, 9, 9))
    # A step needs two readings running: the bad one between the first two nines keeps them from being one.
    np.testing.assert_array_equal(averaged[:, 0], [1, 1.5, math.nan, 2, 2.5, math.nan, 3, 9])


def test_a_bad_reading_gives_nothing_and_leaves_the_average_at_once() -> None:
    averaged = filtered(moving_average_stage(4), column(1, 1, math.nan, 3, 3, 3, 3))
    np.testing.assert_array_equal(averaged[:, 0], [1, 1, math.nan, 5 / 3, 7 / 3, 3, 3])


def test_a_bad_reading_makes_a_low_pass_start_anew() -> None:
    smoothed = filtered(low_pass_stage(0.5), column(1, 1, math.nan, 3, 4))
    np.testing.assert_array_equal(smoothed[:, 0], [1, 1, math.nan, 2.5, 3.25])


def test_a_bad_reading_of_one_channel_leaves_the_others_alone() -> None:
    values = np.array([[1.0, 1.0], [math.nan, 2.0], [3.0, 3.0]])
    alone = filtered(moving_average_stage(3), values[:, 1:])
    together = filtered(moving_average_stage(3), values)
    np.testing.assert_array_equal(together[:, 1:], alone)
