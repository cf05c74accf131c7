"""From counts to deflection, and where each quality begins."""

import math
from dataclasses import replace

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_service.samples import Quality

from .surfaces import surface_of

GOOD, OUT_OF_RANGE, SATURATED = Quality.GOOD, Quality.OUT_OF_RANGE, Quality.SATURATED
LINE: dict[str, object] = {"gain_mm_per_count": -0.001, "adc_bits": 12}
"""A gap of 4.5 - 0.001 x counts."""
TABLE = [[500, 4.0], [1500, 2.0], [3500, 1.0]]
TABLED: dict[str, object] = {"gain_mm_per_count": None, "offset_mm": None, "table": TABLE}


def of(channel: dict[str, object]) -> Characteristic:
    return Characteristic.of(surface_of(1, channel).channels)


def gaps(channel: dict[str, object], *counts: float) -> list[float]:
    column: list[float] = of(channel).gap(np.array(counts)[:, np.newaxis])[:, 0].tolist()
    return column


def test_a_table_is_met_in_its_points_to_the_bit_and_straight_in_between_and_beyond() -> None:
    assert gaps(TABLED, 500, 1500, 3500) == [4.0, 2.0, 1.0]
    assert gaps(TABLED, 1000, 2500, 0, 4000) == pytest.approx([3.0, 1.5, 5.0, 0.75], rel=1e-14)
    assert of(TABLED).steepest.tolist() == pytest.approx([0.002])


def test_a_table_agrees_with_plain_interpolation_beside_a_channel_with_a_line() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([np.sort(rng.uniform(0, 60_000, 30)), np.sort(rng.uniform(1, 4, 30))])
    channels = [*surface_of(1).channels, *surface_of(1, TABLED | {"table": points.tolist()}).channels]
    counts = rng.uniform(points[0, 0], points[-1, 0], (1000, 2))
    both = Characteristic.of(channels).gap(counts)
    np.testing.assert_array_equal(both[:, 0], 4.5 - 0.0001 * counts[:, 0])
    np.testing.assert_allclose(both[:, 1], np.interp(counts[:, 1], *points.T), rtol=1e-13)


@pytest.mark.parametrize(
    ("channel", "counts", "expected"),
    [
        (LINE, 500, GOOD),  # a gap of 4.0: the end of the range belongs to it
        (LINE, 499, OUT_OF_RANGE),
        (LINE, 3500, GOOD),
        (LINE, 3501, OUT_OF_RANGE),
        (LINE, 1, OUT_OF_RANGE),
        (LINE, 0, SATURATED),
        (LINE, 4094, OUT_OF_RANGE),
        (LINE, 4095, SATURATED),
        (LINE, 4096, SATURATED),  # more than the ADC can give
        (LINE | {"offset_mm": 2.0}, 0, SATURATED),  # though its gap is within the range
        (LINE, math.nan, Quality.MISSING),
        # Outside its table, whatever the range says.
        (TABLED | {"range_mm": [0.1, 9.0]}, 499.9, OUT_OF_RANGE),
        (TABLED | {"range_mm": [0.1, 9.0]}, 500, GOOD),
        (TABLED | {"range_mm": [0.1, 9.0]}, 3500.1, OUT_OF_RANGE),
        # A range of counts takes the place of the bits.
        (LINE | {"counts_range": [-1500, 5000]}, 4095, OUT_OF_RANGE),
        (LINE | {"counts_range": [600, 5000]}, 600, SATURATED),
        (LINE | {"counts_range": [600, 3000]}, 3000, SATURATED),
    ],
)
def test_where_each_quality_begins(channel: dict[str, object], counts: float, expected: Quality) -> None:
    (code,) = of(channel).quality(np.array([[counts]])).ravel().tolist()
    assert QUALITIES[code] is expected


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"table": [[1, 2.0]]}, "table needs at least 2 points"),
        ({"table": [[1, 2.0], [1, 3.0]]}, "counts must increase, but 1 follows 1"),
        ({"table": [[1, 2.0], [2, 3.0], [3, 2.5]]}, "gaps must all increase or all decrease, but 2.5 mm follows 3 mm"),
        ({"table": [[0, 1.0], [5e-324, 2.0]]}, "table: the slope from 0 to"),
        ({"table": [[1, 2.0], [2, math.inf]]}, "finite"),
        ({"offset_mm": 1.0}, "give a table, or gain_mm_per_count with offset_mm, not both"),
        ({"table": None, "offset_mm": 1.0}, "gain_mm_per_count missing"),
        ({"counts_range": [5, 5]}, "counts_range must be"),
    ],
)
def test_an_invalid_characteristic_is_refused(changes: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        surface_of(1, TABLED | changes)


def test_another_rest_gap_or_gain_is_another_identity_and_a_tare_overrides_the_rest_gap() -> None:
    def of_surface(surface: Surface, tared: dict[str, float] | None = None) -> Characteristic:
        return Characteristic.of(surface.channels, tared)

    same, tared = of_surface(surface_of()), of_surface(surface_of(), {"s2": 2.6})
    assert tared.rest_gap.tolist() == [2.5, 2.6]
    assert same.identity == of_surface(surface_of()).identity
    assert len({same.identity, tared.identity, replace(same, slopes=2 * same.slopes).identity}) == 3
