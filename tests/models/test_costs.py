"""What the parts of a layout's error are, and the words for them, on errors that are easy to sum by hand.

Cells are 10 mm wide at the middle of a beam of 400 mm, and narrower to the right.
"""

from collections.abc import Sequence

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.placement.reasons import Costs, costs_of, in_parts, reasons_for
from beamtouch_models.places import Extent, grid_of, on_axis
from beamtouch_models.runtime.error_model import Errors
from models.loaded_string import STRING

EDGES_MM = np.array([0.0, 10.0, 20.0, 40.0, 80.0, 120.0, 200.0, 280.0, 370.0, 380.0, 390.0, 400.0])
MIDDLES_MM, WIDTHS_MM = (EDGES_MM[1:] + EDGES_MM[:-1]) / 2, np.diff(EDGES_MM)
BEAM = Extent.of_beam((0.0, 400.0))


def costs(error_mm: Sequence[float], *without_mm: Sequence[float], sensors_mm: Sequence[float] = ()) -> Costs:
    places = on_axis(np.array(sensors_mm or np.linspace(50, 350, len(without_mm))))
    failed = np.reshape(without_mm, (-1, 11)).astype(np.float64)
    return Costs(places, BEAM, on_axis(MIDDLES_MM), WIDTHS_MM, np.array(error_mm, dtype=np.float64), failed)


def where(low_mm: float, high_mm: float, inside: float, outside: float) -> Floats:
    return np.where(np.abs(2 * MIDDLES_MM - low_mm - high_mm) < high_mm - low_mm, inside, outside)


FLAT = [3.0] * 11


def test_errors_are_means_over_lengths_of_the_whole_of_its_inner_nine_tenths_and_of_its_ends() -> None:
    """The ends are 20 mm each: two cells at either side."""
    ends = where(20, 380, 2.0, 11.0)
    found = costs(ends.tolist(), where(0, 120, 8.0, 4.0).tolist(), [5.0] * 11)
    assert found.all_mm == pytest.approx(0.9 * 2 + 0.1 * 11)
    assert (found.inner_mm, found.ends_mm) == pytest.approx((2.0, 11.0))
    assert found.failed_mm == pytest.approx([0.3 * 8 + 0.7 * 4, 5.0])
    assert in_parts(found) == (
        "mean 2.9 mm, 2 mm over the inner 90 %, 11 mm over the outer 5 % at each end; "
        "5.2 mm with the worst sensor failed"
    )
    alone = costs(ends.tolist(), sensors_mm=[100.0])
    assert alone.failed_mm == []
    assert in_parts(alone) == "mean 2.9 mm, 2 mm over the inner 90 %, 11 mm over the outer 5 % at each end"


@pytest.mark.parametrize(("low_mm", "high_mm", "part"), [(0, 40, 0), (40, 80, 1), (120, 200, 4), (360, 400, 9)])
def test_the_part_that_is_missed_most_is_the_tenth_whose_error_grows_by_the_largest_factor(
    low_mm: float, high_mm: float, part: int
) -> None:
    # Errors are large elsewhere, but do not grow there.
    error = where(low_mm, high_mm, 1.0, 50.0)
    found = costs(error.tolist(), (error * where(low_mm, high_mm, 3.0, 1.5)).tolist())
    chosen = found.part_missed_most(0)
    tenths = np.floor(MIDDLES_MM / 40).astype(int)
    assert part in tenths
    assert chosen.tolist() == (tenths == part).tolist()
    assert found.part_in_words(chosen) == f"{40 * part} to {40 * (part + 1)} mm"


def reasons(
    error: Sequence[float], without: Sequence[Sequence[float]], sensors_mm: Sequence[float], gap_mm: float, *fixed: int
) -> list[str]:
    given = costs(error, *without, sensors_mm=sensors_mm)
    return reasons_for(given, gap_mm, np.isin(np.arange(len(sensors_mm)), fixed))


def test_each_reason_has_the_errors_there_and_overall() -> None:
    """Without the first sensor the error doubles at least, without the second it hardly grows."""
    without = [where(40, 80, 15.0, 6.0), where(280, 370, 4.5, 3.0), where(40, 80, 3.5, 3.0)]
    first, second, third = reasons(FLAT, [each.tolist() for each in without], [60.0, 300.0, 308.0], 8.0)
    assert first == (
        "keeps apart places that the others confuse, most at 40 to 80 mm; without it the error there is 15 mm "
        "instead of 3 mm, and 6.9 mm instead of 3 mm overall"
    )
    assert second == (
        "side by side with s3: their noise averages, and either may fail; without it the error is 3.34 mm instead of "
        "3 mm, and 4.5 mm instead of 3 mm at 320 to 360 mm"
    )
    assert third.startswith("side by side with s2: their noise averages")
    assert third.endswith("3.05 mm instead of 3 mm, and 3.5 mm instead of 3 mm at 40 to 80 mm")


@pytest.mark.parametrize(
    ("grown", "apart_mm", "gap_mm", "reason"),
    [
        (1.24, 10.0, 8.0, "side by side with s2"),
        (1.26, 10.0, 8.0, "tells most about "),
        (1.24, 10.1, 8.0, "tells most about "),
        (1.24, 0.0, 0.0, "tells most about "),  # sensors of no size have no side
        (1.99, 10.0, 8.0, "tells most about "),
        (2.0, 10.0, 8.0, "keeps apart places that the others confuse"),
    ],
)
def test_a_reason_follows_from_how_much_the_error_grows_and_who_stands_beside(
    grown: float, apart_mm: float, gap_mm: float, reason: str
) -> None:
    first, _ = reasons([1.0] * 11, [[grown] * 11] * 2, [100.0, 100.0 + apart_mm], gap_mm)
    assert first.startswith(reason)
    told, _ = reasons([1.0] * 11, [[grown] * 11] * 2, [100.0, 100.0 + apart_mm], gap_mm, 0)
    assert told.startswith(f"the scene fixes it here; without it the error is {grown:.3g} mm instead of 1 mm, and ")


def test_who_stands_between_two_is_beside_both() -> None:
    first, middle, last = reasons([1.0] * 11, [[1.1] * 11] * 3, [92.0, 100.0, 108.0], 8.0)
    assert first.startswith("side by side with s2:")
    assert middle.startswith("side by side with s1 and s3:")
    assert last.startswith("side by side with s2:")


def test_a_plate_has_four_parts_along_each_axis_and_a_rim() -> None:
    plate = Extent(((100.0, 500.0), (0.0, 200.0)))
    middles = grid_of([100 + 5 + 10 * np.arange(40.0), 5 + 10 * np.arange(20.0)])
    x, y = middles.T
    is_rim = (x < 120) | (x > 480) | (y < 10) | (y > 190)
    grows = (x > 300) & (x < 400) & (y < 50)
    found = Costs(
        np.array([[200.0, 100.0], [400.0, 50.0]]),
        plate,
        middles,
        np.full(800, 100.0),
        np.where(is_rim, 7.0, 2.0),
        np.array([np.where(grows, 9.0, 3.0), np.full(800, 4.0)]),
    )
    assert (found.inner_mm, found.ends_mm) == pytest.approx((2.0, 7.0))
    assert found.all_mm == pytest.approx(2 + 5 * is_rim.mean())
    chosen = found.part_missed_most(0)
    assert chosen.tolist() == grows.tolist()
    assert found.part_in_words(chosen) == "x = 300 to 400 mm, y = 0 to 50 mm"
    assert in_parts(found).endswith(" over the outer 5 % along the rim; 4 mm with the worst sensor failed")


def test_layouts_of_a_structure_are_compared_on_the_same_contacts() -> None:
    layouts = [on_axis(np.array(layout)) for layout in ([80.0, 200.0, 330.0], [80.0, 200.0, 330.0], [30.0, 40.0, 50.0])]
    one, same, other = costs_of(STRING, Errors(0.05), layouts, 3, Effort(0.01))
    assert (one.error_mm.tolist(), one.without_mm.tolist()) == (same.error_mm.tolist(), same.without_mm.tolist())
    assert one.without_mm.shape == (3, len(one.weight))
    assert other.all_mm > 1.2 * one.all_mm
    assert all(failed > one.all_mm for failed in one.failed_mm)
    assert one.weight.sum() == pytest.approx(380.0)
    assert len(one.weight) >= 256
    (alone,) = costs_of(STRING, Errors(0.05), [on_axis(np.array([150.0]))], 3, Effort(0.01))
    assert alone.without_mm.shape == (0, len(alone.weight))
