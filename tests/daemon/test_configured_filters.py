"""The filters of the models, as a surface configures them."""

import math

import numpy as np
import pytest

from beamtouch_daemon.processing.filters import _rounded as rounded_triangles
from beamtouch_daemon.processing.filters import mean_of, rest_of, slowest_period, steps_mm, walk_of
from beamtouch_models.filters import Mean, Walk

from .surfaces import CHANNEL, STEP_MM, surface_of


@pytest.mark.parametrize(
    ("settings", "mean"),
    [
        ({"kind": "none", "spike_mm": 0.3}, Mean("none", 1, 1, 0.3)),
        ({"kind": "moving-average", "window": 7, "spike_mm": 0.3}, Mean("moving-average", 7, 1, 0.3)),
        ({"kind": "growing-mean", "window": 3, "max_mean_ms": 250.0}, Mean("growing-mean", 3, 50, None)),
        ({"kind": "growing-mean", "window": 1, "max_mean_ms": 0.1}, Mean("growing-mean", 1, 1, None)),
    ],
)
def test_each_kind_of_filter_is_a_mean_of_so_many_readings(settings: dict[str, object], mean: Mean) -> None:
    surface = surface_of(filter=settings, noise_mm=0.002)
    assert mean_of(surface.filter, surface.rate_hz) == mean


def test_the_slowest_period_is_taken_in_readings() -> None:
    assert slowest_period(surface_of(slowest_period_ms=130.0)) == 26.0
    assert slowest_period(surface_of()) == 0.0


def test_steps_are_those_of_a_conversion_in_a_mean_and_unknown_for_fractional_numbers() -> None:
    source = {"kind": "serial", "port": "/dev/x", "oversampling": 16}
    assert steps_mm(surface_of(source=source)).tolist() == pytest.approx([STEP_MM / 4] * 2)
    channels = [CHANNEL | {"name": "s1", "register": 0}, CHANNEL | {"name": "s2", "register": 4, "type": "f32"}]
    assert steps_mm(surface_of(channels=channels)).tolist() == pytest.approx([STEP_MM, 0.0])


def test_zeros_walk_as_is_stated_in_mm_a_minute() -> None:
    assert walk_of(surface_of()) is None
    tracking = {"drift_um_per_min": 7.0, "max_mm": 0.3}
    assert walk_of(surface_of(noise_mm=0.002, zero_tracking=tracking, zero_drift_mm=0.02)) == Walk(0.007, 0.3, 0.02)


def test_only_a_growing_mean_of_a_known_noise_notices_that_nothing_happens() -> None:
    growing = {"kind": "growing-mean", "max_mean_ms": 250.0}
    assert rest_of(surface_of(filter=growing | {"window": 2}, noise_mm=0.002)) is not None
    assert rest_of(surface_of(filter={"kind": "moving-average"}, noise_mm=0.002)) is None
    assert rest_of(surface_of(filter={"kind": "none"}, noise_mm=0.002)) is None
    assert rest_of(surface_of()) is None


def test_a_covariance_is_rounded_far_below_the_noise_and_one_without_noise_below_its_entries() -> None:
    triangles = np.array([[0.123456789, -0.0023456789, 3.00000049], [5.5e-6, 0.0, 1.23456789e-3]])
    white_mm2 = np.array([0.021, 0.0])  # a ten-thousandth of it is 2.1e-6, so that six digits stay
    rounded = rounded_triangles(triangles, white_mm2)
    assert rounded[0].tolist() == [0.123457, -0.002346, 3.0]
    assert rounded[1] == pytest.approx(triangles[1], rel=0, abs=1e-15)
    faint = rounded_triangles(np.array([[0.123456789012345678, 1.000000000000000444]]), np.array([1e-30]))
    assert faint.tolist() == [[0.123456789012, 1.0]]  # of the larger entry, twelve digits
    assert rounded_triangles(np.array([[3e-302, 0.0]]), np.array([5e-320])).tolist() == [[3e-302, 0.0]]
    assert rounded_triangles(np.zeros((1, 3)), np.zeros(1)).tolist() == [[0.0, 0.0, 0.0]]
    unknown = rounded_triangles(triangles[:1], np.array([math.nan]))
    assert unknown.tolist() == triangles[:1].tolist()


def test_large_variances_lose_no_digit_before_the_point() -> None:
    assert rounded_triangles(np.array([[123_456.7]]), np.array([120_000.0])).tolist() == [[123_456.7]]
