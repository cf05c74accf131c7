"""The filters against theory, in numbers that follow from a formula stated beside them."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import Chain, FloatArray, Mean

WHITE = np.random.default_rng(7).standard_normal((60_000, 2))


def filtered(mean: Mean, values: FloatArray) -> FloatArray:
    return Chain(mean, values.shape[1]).apply(values).mean_mm


def column(*values: float) -> FloatArray:
    return np.array(values, dtype=np.float64)[:, np.newaxis]


@pytest.mark.parametrize("window", [1, 2, 4, 16])
def test_a_moving_average_passes_white_noise_at_one_over_root_n(window: int) -> None:
    averaged = filtered(Mean("moving-average", window), WHITE)
    assert np.std(averaged[window:]) == pytest.approx(1 / math.sqrt(window), rel=0.02)


def test_a_step_is_through_a_moving_average_after_n_readings() -> None:
    averaged = filtered(Mean("moving-average", 4), column(0, 0, 0, 0, 1, 1, 1, 1, 1))
    assert averaged[1:, 0].tolist() == [0, 0, 0, 0.25, 0.5, 0.75, 1, 1]


def test_a_moving_average_has_a_value_once_its_window_is_half_full() -> None:
    averaged = filtered(Mean("moving-average", 5), column(1, 3, 5, 7, math.nan, math.nan, math.nan, 9))
    np.testing.assert_array_equal(averaged[:, 0], [math.nan, math.nan, 3, 4, *[math.nan] * 4])


def test_a_single_spike_never_passes_and_a_step_passes_one_reading_later() -> None:
    cleaned = filtered(Mean(spike_mm=0.5), column(0, 0, 9, 0, 0, 5, 5, 5))
    assert cleaned[:, 0].tolist() == [0, 0, 0, 0, 0, 0, 5, 5]


def test_a_spike_is_left_out_of_a_moving_average() -> None:
    averaged = filtered(Mean("moving-average", 4, spike_mm=0.5), column(2, 2, 2, 2, 9, 2, 2.25, 2.25, 2.25))
    assert averaged[1:, 0] == pytest.approx([2, 2, 2, 2, 2, 6.25 / 3, 6.5 / 3, 8.75 / 4])


def test_a_bad_reading_gives_nothing_and_leaves_the_average_at_once() -> None:
    averaged = filtered(Mean("moving-average", 4), column(1, 1, math.nan, 3, 3, 3, 3))
    np.testing.assert_allclose(averaged[1:, 0], [1, math.nan, 5 / 3, 7 / 3, 3, 3], rtol=1e-12)


def test_a_bad_reading_of_one_channel_leaves_the_others_alone() -> None:
    values = np.array([[1.0, 1.0], [math.nan, 2.0], [3.0, 3.0]])
    alone = filtered(Mean("moving-average", 3), values[:, 1:])
    together = filtered(Mean("moving-average", 3), values)
    np.testing.assert_array_equal(together[:, 1:], alone)
