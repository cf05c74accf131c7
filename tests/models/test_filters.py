"""The filters against theory, in numbers that follow from a formula stated beside them."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import Chain, FloatArray, Mean
from beamtouch_models.filters.chain import readings_within, unit_of

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


@pytest.mark.parametrize(
    ("time_ms", "rate_hz", "readings"),
    # As many as are there whole, or as good as whole.
    [
        (30.0, 100.0, 3),
        (39.9, 100.0, 3),
        (29.99999, 100.0, 3),
        (29.9999, 100.0, 2),
        (1e3 / 3, 300.0, 100),
        (1.9, 500, 0),
    ],
)
def test_readings_within_a_time_are_whole_ones(time_ms: float, rate_hz: float, readings: int) -> None:
    assert readings_within(time_ms, rate_hz) == readings


def test_readings_at_rest_deviate_by_their_noise_or_by_half_a_step() -> None:
    assert unit_of(0.3, 0.8, 2).tolist() == [0.4, 0.4]
    assert unit_of(np.array([0.3, 0.5]), -0.8, 2).tolist() == [0.4, 0.5]
    assert unit_of(0.3, np.array([0.5, 0.7]), 2).tolist() == [0.3, 0.35]


@pytest.mark.parametrize(
    ("mean", "most"),
    [
        (Mean("growing-mean", 4, 90), 90),
        (Mean("moving-average", 4, 90), 4),
        (Mean("none", 4, 90), 1),
    ],
)
def test_a_mean_has_no_more_readings_than_its_kind_allows(mean: Mean, most: int) -> None:
    assert (mean.most, mean.grows) == (most, mean.kind == "growing-mean")
    still = 1e-3 * WHITE[:200]
    assert np.nanmax(Chain(mean, 2, 1.0).apply(still).readings) == pytest.approx(most)


def test_a_long_input_is_filtered_as_its_parts_are() -> None:
    mean, values = Mean("growing-mean", 3, 50, 6.0), WHITE[:700] + 5.0 * (np.arange(700) > 300)[:, np.newaxis]
    whole, chain = Chain(mean, 2, 1.0, 9.0).apply(values), Chain(mean, 2, 1.0, 9.0)
    for start in range(0, 700, 7):
        part = chain.apply(values[start : start + 7])
        np.testing.assert_array_equal(part.mean_mm, whole.mean_mm[start : start + 7])
        np.testing.assert_array_equal(part.covariance_mm2, whole.covariance_mm2[start : start + 7])


def test_lost_readings_are_rows_without_values() -> None:
    mean, values = Mean("growing-mean", 3, 50, 6.0), WHITE[:60]
    lost = [0] * 60
    lost[20], lost[41] = 3, 1
    rows = np.insert(values, [20, 20, 20, 41], np.nan, axis=0)
    came = ~np.isnan(rows[:, 0])
    gapped, whole = Chain(mean, 2, 1.0, 9.0).apply(values, lost), Chain(mean, 2, 1.0, 9.0).apply(rows)
    np.testing.assert_array_equal(gapped.mean_mm, whole.mean_mm[came])
    np.testing.assert_array_equal(gapped.covariance_mm2, whole.covariance_mm2[came])
    np.testing.assert_array_equal(gapped.moves, whole.moves[came])


def test_a_chain_that_restarts_knows_nothing() -> None:
    chain = Chain(Mean("growing-mean", 3, 50, 6.0), 2, 1.0, 9.0)
    first = chain.apply(WHITE[:40])
    chain.apply(WHITE[40:90] + 9.0)
    chain.restart()
    again = chain.apply(WHITE[:40])
    np.testing.assert_array_equal(again.mean_mm, first.mean_mm)
    np.testing.assert_array_equal(again.covariance_mm2, first.covariance_mm2)


def test_without_the_noise_of_a_reading_no_covariance_is_known() -> None:
    found = Chain(Mean("moving-average", 4), 2).apply(WHITE[:9])
    with pytest.raises(ValueError, match="the covariance needs the noise of a reading"):
        _ = found.covariance_mm2
    known = Chain(Mean("moving-average", 4), 2, np.array([0.5, 2.0])).apply(1e-3 * WHITE[:9])
    assert known.covariance_mm2[-1].tolist() == [[0.25 / 4, 0.0], [0.0, 4.0 / 4]]
    assert known.covariances_mm2(np.array([8])).tolist() == known.covariance_mm2[8:].tolist()
