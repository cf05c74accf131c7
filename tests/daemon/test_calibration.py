"""From counts to deflection, and where each quality begins."""

import math

import numpy as np
import pytest

from beamtouch_daemon.calibration import QUALITIES, Calibration
from beamtouch_daemon.config import Channel
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
    (code,) = Calibration.of([channel(**changes)]).quality(np.array([[counts]])).ravel().tolist()
    return QUALITIES[code]


def test_deflection_is_the_rest_gap_less_the_gap() -> None:
    calibration = Calibration.of([channel()])
    gap = calibration.gap(np.array([[2000.0], [2300.0]]))
    np.testing.assert_allclose(gap[:, 0], [2.5, 2.2])  # 4.5 - 0.001 x 2300
    np.testing.assert_allclose(calibration.deflection(gap)[:, 0], [0.0, 0.3])  # nearer to the sensor is positive


def test_a_tared_rest_gap_overrides_the_configured_one_for_its_channel() -> None:
    calibration = Calibration.of([channel(name="s1"), channel(name="s2")], {"s2": 2.4})
    assert calibration.rest_gap.tolist() == [2.5, 2.4]


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
    assert np.isnan(Calibration.of([channel()]).gap(np.array([[math.nan]])))
