"""From counts to deflection, and where each quality begins."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_service.samples import Quality

from .surfaces import CHANNEL, surface_of

GOOD, OUT_OF_RANGE, SATURATED = Quality.GOOD, Quality.OUT_OF_RANGE, Quality.SATURATED
LINE: dict[str, object] = {"gain_mm_per_count": -0.001, "adc_bits": 12}
"""A gap of 4.5 - 0.001 x counts."""
TABLE = [[500, 4.0], [1500, 2.0], [3500, 1.0]]
GAUGE: dict[str, object] = {"type": "f32", "gain_mm_per_count": 1.0, "offset_mm": 0.0}
"""It gives the gap in mm."""
TABLED: dict[str, object] = {"gain_mm_per_count": None, "offset_mm": None, "table": TABLE}


def of(channel: dict[str, object]) -> Characteristic:
    return Characteristic.of(surface_of(1, channel))


def gaps(channel: dict[str, object], *counts: float) -> list[float]:
    column: list[float] = of(channel).gap(np.array(counts)[:, np.newaxis])[:, 0].tolist()
    return column


def test_a_table_is_met_in_its_points_to_the_bit_and_straight_in_between_and_beyond() -> None:
    assert gaps(TABLED, 500, 1500, 3500) == [4.0, 2.0, 1.0]
    assert gaps(TABLED, 1000, 2500, 0, 4000) == pytest.approx([3.0, 1.5, 5.0, 0.75], rel=1e-14)
    assert of(TABLED).steepest.tolist() == pytest.approx([0.002])


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "[counts, gap] points instead of gain and offset, joined by straight lines; out-of-range beyond the ends.",
)
def test_a_table_agrees_with_plain_interpolation_beside_a_channel_with_a_line() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([np.sort(rng.uniform(0, 60_000, 30)), np.sort(rng.uniform(1, 4, 30))])
    tabled = CHANNEL | TABLED | {"table": points.tolist(), "name": "s2", "register": 1}
    surface = surface_of(channels=[CHANNEL | {"name": "s1", "register": 0}, tabled])
    counts = rng.uniform(points[0, 0], points[-1, 0], (1000, 2))
    both = Characteristic.of(surface).gap(counts)
    np.testing.assert_array_equal(both[:, 0], 4.5 - 0.0001 * counts[:, 0])
    np.testing.assert_allclose(both[:, 1], np.interp(counts[:, 1], *points.T), rtol=1e-13)


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Linear range of the sensor; gaps outside it are out-of-range.",
    "Counts at these ends and beyond are saturated; overrides `adc_bits`.",
)
@pytest.mark.parametrize(
    ("channel", "counts", "expected"),
    [
        (LINE, 500, GOOD),  # a gap of 4.0: the end of the range belongs to it
        (LINE, 499, OUT_OF_RANGE),
        (LINE, 3500, GOOD),
        (LINE, 3501, OUT_OF_RANGE),
        (LINE, 5, OUT_OF_RANGE),
        (LINE, 4, SATURATED),  # an input without its cable
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


def test_a_deflection_changes_with_a_count_by_the_slope_there_in_the_direction_of_the_load() -> None:
    channels = [CHANNEL | kind | {"name": f"s{at}", "register": at} for at, kind in enumerate((TABLED, LINE, TABLED))]
    of_gaps = Characteristic.of(surface_of(channels=channels))
    assert of_gaps.mm_per_count(np.array([499.0, 7.0, 1500.0])).tolist() == pytest.approx([0.002, 0.001, 0.0005])
    assert of_gaps.mm_per_count(np.array([3501.0, math.nan, 1499.0])).tolist() == [
        pytest.approx(0.0005),
        pytest.approx(math.nan, nan_ok=True),
        pytest.approx(0.002),
    ]
    assert of(LINE | {"value_unit": "uT"}).mm_per_count(np.array([7.0])).tolist() == [-0.001]  # no gap


VOLTS: dict[str, object] = {"gain_mm_per_count": 0.3, "offset_mm": 1.0}
"""0 to 10 V for 1 to 4 mm, 5 V at rest."""
MILLIVOLTS = VOLTS | {"gain_mm_per_count": 0.0003}
WIDE = {"range_mm": [-1e6, 1e6], "rest_gap_mm": 1e5, "gain_mm_per_count": 0.01, "offset_mm": 0.0}
"""A range that holds every count."""


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "the ends of `type` are, and f32 and f64 have none; serial: 16.",
)
@pytest.mark.parametrize(
    ("value_type", "channel", "good", "saturated"),
    [
        ("u16", {}, (60, 65_534), (0, 65_535)),
        ("i16", {}, (-32_767, -1, 0, 1, 32_766), (-32_768, 32_767)),
        ("u32", {"gain_mm_per_count": 1e-4}, (1_000_000_000, 2**32 - 2), (0, 2**32 - 1)),
        ("i32", {"gain_mm_per_count": 1e-4}, (-(2**31) + 1, 0, 2**31 - 2), (-(2**31), 2**31 - 1)),
        ("f32", {}, (-1e7, -1.0, 0.0, 65_535.0, 1e7), ()),
        ("f64", {}, (-1e7, -1.0, 0.0, 65_535.0, 1e7), ()),
        ("i16", {"adc_bits": 12}, (60, 4094), (-1, 0, 4095)),
        ("u32", {"adc_bits": 24}, (1_000_000, 2**24 - 2), (0, 2**24 - 1)),
        ("f32", {"counts_range": [-10.0, 10.0]}, (-9.9, 0.0, 9.9), (-10.0, 10.0)),
        ("i16", {"counts_range": [-10.0, 65_535.0]}, (-9, 32_767), (-10,)),
    ],
)
def test_the_type_of_the_counts_says_where_they_are_saturated(
    value_type: str, channel: dict[str, object], good: tuple[float, ...], saturated: tuple[float, ...]
) -> None:
    characteristic = of(WIDE | channel | {"type": value_type})
    codes = characteristic.quality(np.array([*good, *saturated])[:, np.newaxis])[:, 0].tolist()
    assert [QUALITIES[code] for code in codes] == [GOOD] * len(good) + [SATURATED] * len(saturated)


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "but not where 0 counts stand for a gap inside that range, or for that at rest.",
)
@pytest.mark.promise("docs/reference/daemon-configuration.md", "Counts of about 0, as without a cable")
@pytest.mark.parametrize(
    ("channel", "expected"),
    [
        (MILLIVOLTS, {1: SATURATED, 4: SATURATED, 10: SATURATED, 11: GOOD}),
        (MILLIVOLTS | {"type": "i16"}, {-4: SATURATED, 3: SATURATED, 11: GOOD}),
        (MILLIVOLTS | {"counts_range": [0, 10_000]}, {1: GOOD}),  # as stated
        (VOLTS | {"type": "f32"}, {-0.004: SATURATED, 0.0: SATURATED, 0.004: SATURATED, 0.02: GOOD}),
        # 4 to 20 mA: 0 is far below the linear range.
        ({"type": "f32", "gain_mm_per_count": 0.1875, "offset_mm": 0.25}, {0.001: OUT_OF_RANGE, 4.1: GOOD}),
        # A gap of 0 may be any gap of a gauge, and that at rest.
        (GAUGE | {"range_mm": [-2.0, 2.0], "rest_gap_mm": 1.5}, {0.0: GOOD, 0.001: GOOD}),
        (GAUGE | {"range_mm": [0.0, 2.0], "rest_gap_mm": 0.01}, {0.0: GOOD, 0.001: GOOD}),
        (GAUGE | {"range_mm": [0.0, 2.0], "rest_gap_mm": 1.5}, {0.0: SATURATED, 0.001: SATURATED, 0.01: GOOD}),
        (GAUGE | {"range_mm": [-2.0, 0.0], "rest_gap_mm": -1.5}, {0.0: SATURATED, -0.001: SATURATED, -0.01: GOOD}),
        ({"adc_bits": 8, "gain_mm_per_count": -0.01}, {1: SATURATED, 4: OUT_OF_RANGE}),  # of a coarse ADC, fewer
        (TABLED | {"table": [[0, 4.0], [1500, 2.0], [3500, 1.0]]}, {4: SATURATED, 5: GOOD}),
    ],
)
def test_an_input_without_its_cable_is_saturated_where_its_counts_cannot_be_a_gap(
    channel: dict[str, object], expected: dict[float, Quality]
) -> None:
    codes = of(channel).quality(np.array(list(expected))[:, np.newaxis])[:, 0].tolist()
    assert [QUALITIES[code] for code in codes] == list(expected.values())


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


@pytest.mark.promise("docs/reference/daemon-configuration.md", "the tare file overrides it.")
@pytest.mark.promise(
    "docs/reference/samples.md",
    "a short text that changes with each tare and each change of a characteristic.",
)
def test_another_rest_gap_or_gain_is_another_identity_and_a_tare_overrides_the_rest_gap() -> None:
    def of_surface(surface: Surface, tared: dict[str, float] | None = None) -> Characteristic:
        return Characteristic.of(surface, tared)

    same, tared = of_surface(surface_of()), of_surface(surface_of(), {"s2": 2.6})
    assert tared.rest_gap.tolist() == [2.5, 2.6]
    assert same.identity == of_surface(surface_of()).identity
    assert re.fullmatch("[0-9a-f]{12}", same.identity)
    assert len({same.identity, tared.identity, replace(same, slopes=2 * same.slopes).identity}) == 3
