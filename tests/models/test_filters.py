"""The filters against theory, in numbers that follow from a formula stated beside them."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import Chain, FloatArray, Mean

WHITE = np.random.default_rng(7).standard_normal((60_000, 2))
NAN = math.nan


def filtered(mean: Mean, values: FloatArray) -> FloatArray:
    return Chain(mean, values.shape[1]).apply(values).mean_mm


@pytest.mark.parametrize("window", [1, 2, 4, 16])
def test_a_moving_average_passes_white_noise_at_one_over_root_n(window: int) -> None:
    averaged = filtered(Mean("moving-average", window), WHITE)
    assert np.std(averaged[window:]) == pytest.approx(1 / math.sqrt(window), rel=0.02)


@pytest.mark.parametrize(
    ("mean", "readings", "expected"),
    [
        # A step is through a mean of n readings after n of them.
        (Mean("moving-average", 4), [0, 0, 0, 0, 1, 1, 1, 1, 1], [NAN, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1]),
        # A mean has a value once its window is half full.
        (Mean("moving-average", 5), [1, 3, 5, 7, NAN, NAN, NAN, 9], [NAN, NAN, 3, 4, NAN, NAN, NAN, NAN]),
        # A bad reading gives nothing, and leaves the mean at once.
        (Mean("moving-average", 4), [1, 1, NAN, 3, 3, 3, 3], [NAN, 1, NAN, 5 / 3, 7 / 3, 3, 3]),
        # A single spike never passes, and a step passes one reading later.
        (Mean(spike_mm=0.5), [0, 0, 9, 0, 0, 5, 5, 5], [0, 0, 0, 0, 0, 0, 5, 5]),
        (
            Mean("moving-average", 4, spike_mm=0.5),
            [2, 2, 2, 2, 9, 2, 2.25, 2.25, 2.25],
            [NAN, 2, 2, 2, 2, 2, 6.25 / 3, 6.5 / 3, 8.75 / 4],
        ),
    ],
)
def test_a_filter_follows_its_formula(mean: Mean, readings: list[float], expected: list[float]) -> None:
    values = np.array(readings, dtype=np.float64)[:, np.newaxis]
    np.testing.assert_allclose(filtered(mean, values)[:, 0], expected, rtol=1e-12)


def test_a_bad_reading_of_one_channel_leaves_the_others_alone() -> None:
    values = np.array([[1.0, 1.0], [NAN, 2.0], [3.0, 3.0]])
    alone = filtered(Mean("moving-average", 3), values[:, 1:])
    together = filtered(Mean("moving-average", 3), values)
    np.testing.assert_array_equal(together[:, 1:], alone)
