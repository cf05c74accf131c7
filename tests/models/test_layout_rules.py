"""Rules of layouts beside all layouts that there are, and places on grids that are small enough to see."""

from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.arrays import Indices
from beamtouch_models.design.placement.layout_rules import LayoutRules, equal_layout, equal_pitch_mm
from beamtouch_models.design.placement.least_error import in_pairs
from beamtouch_models.design.placement.line_layouts import LineLayouts
from beamtouch_models.errors import SceneError
from beamtouch_models.places import grid_of, on_axis

LINE_MM = np.array([0.0, 3.0, 7.0, 8.0, 15.0, 22.0, 23.5, 30.0])
NONE = np.array([], dtype=np.intp)


def places(*numbers: int) -> Indices:
    return np.array(numbers, dtype=np.intp)


def rules_on_line(*fixed: int, min_distance_mm: float = 7.0) -> LayoutRules:
    return LayoutRules(on_axis(LINE_MM), places(*fixed), min_distance_mm)


def every_layout(fixed: Indices, count: int, least_mm: float) -> list[tuple[int, ...]]:
    """All layouts on the line that keep a distance and have all fixed sensors."""
    return [
        layout
        for layout in combinations(range(len(LINE_MM)), count)
        if set(fixed.tolist()) <= set(layout) and all(np.diff(LINE_MM[list(layout)]) >= least_mm)
    ]


@pytest.mark.parametrize("fixed", [(), (2,), (1, 5), (0, 3, 7), (4, 6)])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_the_best_layout_on_a_line_is_the_best_of_all_that_keep_the_rules(fixed: tuple[int, ...], count: int) -> None:
    rng, line = np.random.default_rng([count, len(fixed)]), LineLayouts(LINE_MM, places(*fixed), 7.0)
    layouts = every_layout(places(*fixed), count, 7.0)
    for _ in range(6):
        values = rng.normal(scale=3.0, size=(count, len(LINE_MM)))
        values[rng.random(values.shape) < 0.2] = -np.inf
        sums = [float(values[range(count), layout].sum()) for layout in layouts]
        through = np.full_like(values, -np.inf)
        for layout, total in zip(layouts, sums, strict=True):
            for sensor, at in enumerate(layout):
                through[sensor, at] = max(through[sensor, at], total)
        assert line.best_through(values) == pytest.approx(through)
        best = line.best(values)
        if max(sums, default=-np.inf) == -np.inf:
            assert best is None
        else:
            assert best is not None
            assert tuple(best) == layouts[int(np.argmax(sums))]


@pytest.mark.parametrize("fixed", [(), (2,), (1, 5)])
def test_a_layout_is_allowed_if_it_keeps_the_distance_and_has_all_fixed_sensors(fixed: tuple[int, ...]) -> None:
    rules = rules_on_line(*fixed)
    every = np.array(list(combinations(range(len(LINE_MM)), 3)), dtype=np.intp)
    expected = every_layout(places(*fixed), 3, 7.0)
    assert [tuple(layout) for layout in every[rules.allowed(every)]] == expected
    assert rules.allowed(every[:, ::-1]).tolist() == rules.allowed(every).tolist()
    on_plate = LayoutRules(np.column_stack([LINE_MM, 2 * LINE_MM]), places(*fixed), 7.0 * np.sqrt(5))
    assert on_plate.allowed(every).tolist() == rules.allowed(every).tolist()
    assert on_plate.allowed(places(0, 1, 2)[:, None]).tolist() == rules.allowed(places(0, 1, 2)[:, None]).tolist()


@pytest.mark.parametrize(
    ("min_distance_mm", "gap_mm"), [(7.0, 7.0 - 3e-8), (0.0, 0.5), (0.3, 0.5), (0.75, 0.75 - 3e-8)]
)
def test_the_gap_is_the_distance_but_for_rounding_and_distinct_places_otherwise(
    min_distance_mm: float, gap_mm: float
) -> None:
    assert rules_on_line(min_distance_mm=min_distance_mm).gap_mm == pytest.approx(gap_mm, rel=1e-10)


@pytest.mark.parametrize("fixed", [(), (2,), (1, 5)])
def test_the_fitted_layout_has_the_least_sum_of_squared_distances(fixed: tuple[int, ...]) -> None:
    rules, rng = rules_on_line(*fixed), np.random.default_rng(5)
    layouts = every_layout(places(*fixed), 3, 7.0)
    for wanted_mm in rng.uniform(-2, 33, (12, 3, 1)):
        found = rules.fitted(wanted_mm)
        off = [((LINE_MM[list(layout)] - np.sort(wanted_mm[:, 0])) ** 2).sum() for layout in layouts]
        assert found is not None
        assert tuple(found) == layouts[int(np.argmin(off))]
    assert rules.fitted(np.zeros((6, 1))) is None
    assert rules_on_line(1, 5).fitted(np.zeros((1, 1))) is None
    one = LayoutRules(np.array([[4.0]]), NONE, 0.0)
    assert one.fitted(np.array([[9.0]])) == places(0)


PLATE_MM = np.delete(grid_of([np.array([0.0, 10.0, 30.0]), np.array([0.0, 5.0, 20.0, 40.0])]), 6, axis=0)
"""Three by four places without that at (10, 20)."""


def plate(*fixed: int, min_distance_mm: float = 0.0) -> LayoutRules:
    return LayoutRules(PLATE_MM, places(*fixed), min_distance_mm)


def number_of(x_mm: float, y_mm: float) -> int:
    found: int = PLATE_MM.tolist().index([x_mm, y_mm])
    return found


def test_sensors_move_on_the_grid_and_stay_inside() -> None:
    rules = plate()
    assert (rules.axes, rules.ticks_across, rules.gap_mm) == (2, 4, 2.5)
    layout = places(number_of(0, 5), number_of(10, 5), number_of(30, 40))
    steps = np.array(
        [[[1, 0], [0, 1], [0, -1]], [[0, 2], [-1, -1], [-2, 0]], [[0, -2], [1, 1], [0, 1]], [[-1, 0], [3, 0], [1, 0]]]
    )
    moved = [
        [number_of(10, 5), -1, number_of(30, 20)],
        [number_of(0, 40), number_of(0, 0), number_of(0, 40)],
        [-1, number_of(30, 20), -1],
        [-1, -1, -1],
    ]
    assert rules.moved(layout, steps).tolist() == moved
    pushed = [
        [number_of(10, 5), number_of(10, 5), number_of(30, 20)],  # no candidate is at (10, 20)
        [number_of(0, 40), number_of(0, 0), number_of(0, 40)],
        [number_of(0, 0), number_of(30, 20), number_of(30, 40)],
        [number_of(0, 5), number_of(30, 5), number_of(30, 40)],
    ]
    assert rules.pushed(layout, steps).tolist() == pushed


def test_candidates_are_taken_evenly() -> None:
    assert rules_on_line().evenly(3).tolist() == [0, 4, 7]
    assert rules_on_line().evenly(1).tolist() == [0, 7]
    assert rules_on_line().evenly(8).tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert plate().evenly(11).tolist() == list(range(11))
    assert plate().evenly(9).tolist() == [
        number_of(x, y) for x, y in [(0, 0), (0, 20), (0, 40), (10, 0), (10, 40), (30, 0), (30, 20), (30, 40)]
    ]
    assert plate().evenly(2).tolist() == [number_of(x, y) for x in (0, 30) for y in (0, 40)]


def test_on_a_plate_each_sensor_takes_the_nearest_place_that_is_left() -> None:
    wanted_mm = np.array([[29.0, 1.0], [2.0, 38.0], [28.0, 4.0]])
    near = sorted([number_of(30, 0), number_of(0, 40), number_of(30, 5)])
    assert plate().fitted(wanted_mm) == pytest.approx(np.array(near))
    apart = plate(min_distance_mm=6.0).fitted(wanted_mm)
    assert apart == pytest.approx(np.array(sorted([number_of(30, 0), number_of(0, 40), number_of(30, 20)])))
    # The place that is wanted nearest to a fixed sensor is its own, and the others keep away from it.
    fixed = plate(number_of(30, 5), min_distance_mm=6.0).fitted(wanted_mm)
    assert fixed == pytest.approx(np.array(sorted([number_of(30, 5), number_of(0, 40), number_of(10, 0)])))
    assert plate(min_distance_mm=60.0).fitted(wanted_mm) is None
    assert plate(0, 1).fitted(wanted_mm[:1]) is None
    assert plate(0, 1).fitted(wanted_mm[:2]) == pytest.approx(np.array([0, 1]))
    assert plate(0, 1, min_distance_mm=6.0).fitted(wanted_mm) is None  # the fixed ones are 5 mm apart


@pytest.mark.parametrize(
    ("size_mm", "count", "expected"),
    [
        ([400.0], 1, [[200]]),
        ([400.0], 3, [[100], [200], [300]]),
        ([400.0, 300.0], 5, [[100, 100], [200, 100], [300, 100], [400 / 3, 200], [800 / 3, 200]]),
        ([400.0, 10.0], 3, [[100, 5], [200, 5], [300, 5]]),
        ([10.0, 400.0], 3, [[5, 100], [5, 200], [5, 300]]),
        ([300.0, 300.0], 4, [[100, 100], [200, 100], [100, 200], [200, 200]]),
    ],
)
def test_equal_pitch_divides_a_beam_into_equal_parts_and_a_plate_into_rows(
    size_mm: list[float], count: int, expected: list[list[float]]
) -> None:
    assert equal_pitch_mm(np.array(size_mm), count) == pytest.approx(np.array(expected, dtype=np.float64))


@pytest.mark.parametrize(
    ("rules", "count", "said"),
    [
        (rules_on_line(1, 5), 1, "sensors.fixed_mm has 2 sensors, more than the 1 to be placed"),
        (
            rules_on_line(),
            9,
            "9 sensors do not fit on 8 places, all that the rules of sensors allow .* place 8 or fewer",
        ),
        (rules_on_line(), 6, "no layout of 6 sensors keeps the rules of sensors"),
    ],
)
def test_what_no_layout_keeps_is_said_with_its_numbers(rules: LayoutRules, count: int, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        equal_layout(rules, np.array([30.0]), count)


def test_the_ends_of_what_fits_are_laid_out() -> None:
    assert equal_layout(rules_on_line(1, 5), np.array([30.0]), 2).tolist() == [1, 5]
    assert equal_layout(rules_on_line(min_distance_mm=0.0), np.array([30.0]), 8).tolist() == list(range(8))


def even(step_mm: float, distance_mm: float) -> LayoutRules:
    return LayoutRules(on_axis(np.arange(0.0, 400.1, step_mm)), NONE, distance_mm)


@pytest.mark.parametrize(
    ("count", "expected"),
    [
        (2, [196, 204]),
        (3, [129, 137, 263]),  # the pairs are at a third and at two thirds; the last has no partner
        (4, [129, 137, 263, 271]),
        (6, [96, 104, 196, 204, 296, 304]),
    ],
)
def test_pairs_stand_side_by_side_at_equal_pitch(count: int, expected: list[float]) -> None:
    rules = even(1.0, 8.0)
    found = in_pairs(rules, np.array([400.0]), count)
    assert found is not None
    assert rules.place_mm[found][:, 0] == pytest.approx(expected, abs=1.01)
    assert np.diff(rules.place_mm[found][:, 0])[::2] == pytest.approx(8.0)
