"""From counts to deflection, and where each quality begins."""

import math

import numpy as np
import pytest

from beamtouch_daemon.config.signal import Channel
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_service.samples import Quality


def channel(**changes: object) -> Channel:
    values: dict[str, object] = {
        "name": "s1",
        "register": 0,
        "gain_mm_per_count": -0.001,
        "offset_mm": 4.5,
        "rest_gap_mm": 2.5,
        "range_mm": [1.0, 4.0],
        "adc_bits": 12,
    }
    return Channel.model_validate(values | changes)


def quality_of(counts: float, **changes: object) -> Quality:
    (code,) = Characteristic.of([channel(**changes)]).quality(np.array([[counts]])).ravel().tolist()
    return QUALITIES[code]


def test_deflection_is_the_rest_gap_less_the_gap() -> None:
    characteristic = Characteristic.of([channel()])
    gap = characteristic.gap(np.array([[2000.0], [2300.0]]))
    np.testing.assert_allclose(gap[:, 0], [2.5, 2.2])  # 4.5 - 0.001 x 2300
    np.testing.assert_allclose(characteristic.deflection(gap)[:, 0], [0.0, 0.3])  # nearer to the sensor is positive


def test_a_tared_rest_gap_overrides_the_configured_one_for_its_channel() -> None:
    characteristic = Characteristic.of([channel(name="s1"), channel(name="s2")], {"s2": 2.4})
    assert characteristic.rest_gap.tolist() == [2.5, 2.4]


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        (500, Quality.GOOD),  # gap 4.0: the end of the range belongs to it
        (499, Quality.OUT_OF_RANGE),
        (3500, Quality.GOOD),  # gap 1.0
        (3501, Quality.OUT_OF_RANGE),
        (1, Quality.OUT_OF_RANGE),
        (0, Quality.SATURATED),
        (4094, Quality.OUT_OF_RANGE),
        (4095, Quality.SATURATED),
        (4096, Quality.SATURATED),  # more than the ADC can give
        (math.nan, Quality.MISSING),
    ],
)
def test_where_each_quality_begins(counts: float, expected: Quality) -> None:
    assert quality_of(counts) is expected


def test_the_end_of_the_adc_is_saturated_even_inside_the_range() -> None:
    assert quality_of(0, offset_mm=2.0) is Quality.SATURATED


def test_a_missing_count_has_no_gap() -> None:
    assert np.isnan(Characteristic.of([channel()]).gap(np.array([[math.nan]])))


TABLE = [[500, 4.0], [1500, 2.0], [3500, 1.0]]


def with_table(table: object = TABLE, **changes: object) -> Channel:
    values = channel().model_dump(by_alias=True, exclude={"gain_mm_per_count", "offset_mm"})
    return Channel.model_validate(values | {"table": table} | changes)


def test_a_table_is_met_in_its_points_to_the_bit_and_straight_in_between_and_beyond() -> None:
    characteristic = Characteristic.of([with_table()])
    counts = np.array([[500.0], [1500.0], [3500.0], [1000.0], [2500.0], [0.0], [4000.0]])
    gap = characteristic.gap(counts)[:, 0]
    assert gap[:3].tolist() == [4.0, 2.0, 1.0]
    np.testing.assert_allclose(gap[3:], [3.0, 1.5, 5.0, 0.75], rtol=1e-14)


def test_a_table_agrees_with_plain_interpolation_beside_a_channel_with_a_line() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([np.sort(rng.uniform(0, 60_000, 30)), np.sort(rng.uniform(1, 4, 30))])
    both = Characteristic.of([channel(), with_table(points.tolist(), adc_bits=16), with_table()])
    counts = rng.uniform(points[0, 0], points[-1, 0], (1000, 3))
    np.testing.assert_allclose(both.gap(counts)[:, 1], np.interp(counts[:, 1], *points.T), rtol=1e-13)
    np.testing.assert_array_equal(both.gap(counts)[:, 0], 4.5 - 0.001 * counts[:, 0])
    np.testing.assert_array_equal(both.gap(counts)[:, 2], Characteristic.of([with_table()]).gap(counts[:, 2:])[:, 0])


def test_counts_outside_the_table_are_out_of_range_whatever_the_range_says() -> None:
    counts = np.array([[499.9], [500.0], [3500.0], [3500.1], [math.nan]])
    codes = Characteristic.of([with_table(range_mm=[0.1, 9.0])]).quality(counts)[:, 0]
    assert [QUALITIES[code] for code in codes] == [
        Quality.OUT_OF_RANGE,
        Quality.GOOD,
        Quality.GOOD,
        Quality.OUT_OF_RANGE,
        Quality.MISSING,
    ]


def test_the_steepest_piece_of_each_channel_is_known() -> None:
    np.testing.assert_allclose(Characteristic.of([channel(), with_table()]).steepest, [0.001, 0.002])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"table": [[1, 2.0]]}, "table needs at least 2 points"),
        ({"table": [[1, 2.0], [1, 3.0]]}, "counts must increase, but 1 follows 1"),
        ({"table": [[1, 2.0], [2, 3.0], [3, 2.5]]}, "gaps must all increase or all decrease, but 2.5 mm follows 3 mm"),
        ({"table": [[1, 2.0], [2, 2.0]]}, "gaps must all increase or all decrease"),
        ({"table": [[0, 1.0], [5e-324, 2.0]]}, "no slope can be computed"),
        ({"table": [[1, 2.0], [2, math.inf]]}, "finite"),
        ({"offset_mm": 1.0}, "give a table, or gain_mm_per_count with offset_mm, not both"),
        ({"table": None}, "gain_mm_per_count and offset_mm missing"),
        ({"table": None, "offset_mm": 1.0}, "gain_mm_per_count missing"),
        ({"counts_range": [5, 5]}, "counts_range must be"),
    ],
)
def test_an_invalid_characteristic_is_refused(changes: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        with_table(**changes)


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        (-2e9, Quality.SATURATED),
        (-1.9e9, Quality.GOOD),
        (0, Quality.GOOD),
        (4095, Quality.GOOD),
        (1.9e9, Quality.GOOD),
        (2e9, Quality.SATURATED),
    ],
)
def test_a_range_of_counts_takes_the_place_of_the_bits(counts: float, expected: Quality) -> None:
    assert quality_of(counts, gain_mm_per_count=5e-10, offset_mm=2.5, counts_range=[-2e9, 2e9]) is expected
