"""Influence functions of scripts: what is refused of them, and what follows from those known in closed form."""

import math
from typing import Any

import numpy as np
import pytest

from beamtouch_models import InfluenceFunction
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.influence_function import (
    Interpolation,
    check_own,
    even_loads_mm,
    travel_of,
)
from beamtouch_models.errors import SceneError
from beamtouch_models.places import grid_of

LOADS_MM = np.linspace(30.0, 470.0, 45)


def tilted(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return the deflection of a board that turns about 200 mm, more under loads that are further to the right."""
    moved: Floats = np.outer(1 + load_mm / 1000, (sensor_mm - 200) / 500)
    return moved


def plane(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return the deflection of a plate that tilts as a whole."""
    moved: Floats = np.outer(1 + load_mm[:, 0] / 100, sensor_mm @ [0.03, -0.04] + 0.5)
    return moved


BOARD: dict[str, Any] = {"length_mm": 500.0, "load_mm": LOADS_MM, "force_n": (1.0, 7.0), "at": tilted}
PLATE: dict[str, Any] = {
    "length_mm": (40.0, 30.0),
    "load_mm": grid_of([np.linspace(5, 35, 7), np.linspace(2, 28, 14)]),
    "force_n": (2.0, 3.0),
    "at": plane,
}
OF = " of an influence function must be "
GRID = "load_mm" + OF + "ascending and evenly spaced"


@pytest.mark.parametrize(
    ("kind", "changes", "said"),
    [
        (BOARD, {"length_mm": 0.0}, "length_mm" + OF + "a positive number, not 0.0"),
        (BOARD, {"length_mm": math.inf}, "length_mm" + OF + "a positive number, not inf"),
        (PLATE, {"length_mm": (40.0, -30.0)}, "length_mm" + OF + "a positive number, not (40.0, -30.0)"),
        (BOARD, {"load_mm": 30.0}, "load_mm" + OF + "a list of two positions or more, not 30.0"),
        (BOARD, {"load_mm": [30.0]}, "load_mm" + OF + "a list of two positions or more, not [30.]"),
        (PLATE, {"load_mm": [[30.0, 1.0]]}, "load_mm" + OF + "a list of two positions or more, not [[30.  1.]]"),
        (
            PLATE,
            {"load_mm": np.arange(4.0)},
            "load_mm" + OF + "a list of places with 2 numbers each, not [0. 1. 2. 3.]",
        ),
        (BOARD, {"load_mm": [0.0, math.inf]}, "load_mm" + OF + "finite, not [ 0. inf]"),
        (BOARD, {"load_mm": [-1.0, 9.0]}, "load_mm" + OF + "at 0 to length_mm, not [-1.  9.]"),
        (BOARD, {"load_mm": [0.0, 501.0]}, "load_mm" + OF + "at 0 to length_mm, not [  0. 501.]"),
        (BOARD, {"load_mm": [1.0, 2.0, 4.0]}, GRID + ", not [1. 2. 4.]"),
        (PLATE, {"load_mm": [[1.0, 1.0], [1.0, 2.0], [2.0, 1.0]]}, GRID),
        (PLATE, {"load_mm": [[1.0, 1.0], [2.0, 1.0], [1.0, 2.0], [2.0, 2.0]]}, GRID),
        (PLATE, {"load_mm": [[1.0, 1.0], [1.0, 2.0], [1.0, 3.0]]}, GRID),
        (
            BOARD,
            {"force_n": (0.0, 7.0)},
            "force_n" + OF + "positive, the first no larger than the second, not (0.0, 7.0)",
        ),
        (
            BOARD,
            {"force_n": (7.1, 7.0)},
            "force_n" + OF + "positive, the first no larger than the second, not (7.1, 7.0)",
        ),
        (BOARD, {"force_n": (7.0, math.inf)}, "force_n" + OF + "positive"),
        (BOARD, {"unit_mm_per_n": -1.0}, "unit_mm_per_n" + OF + "a positive number, not -1.0"),
        (BOARD, {"unit_mm_per_n": math.inf}, "unit_mm_per_n" + OF + "a positive number, not inf"),
        (
            BOARD,
            {"at": lambda sensor_mm, load_mm: tilted(sensor_mm, load_mm).T},
            "at of an influence function must return finite values of shape (loads, sensors), here (2, 3), not (3, 2)",
        ),
        (
            PLATE,
            {"at": lambda sensor_mm, load_mm: np.where(sensor_mm[:, 1] < 10, math.nan, plane(sensor_mm, load_mm))},
            "at of an influence function must return finite values of shape (loads, sensors), not nan for a sensor at "
            "8, 6 and a load at 35, 28 mm",
        ),
    ],
)
def test_what_is_not_as_its_line_says_is_refused_word_for_word(
    kind: dict[str, Any], changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(ValueError, match="influence function must") as refused:
        InfluenceFunction(**kind | changes)
    assert str(refused.value).startswith(said)


@pytest.mark.parametrize(
    "load_mm",
    [[0.0, 500.0], [1.0, 2.0], [0.1, 0.2, 0.3, 0.4], np.append(0, 0.5 * np.arange(1, 1001) - 1e-7)],
    ids=["both ends", "two", "decimals", "nearly even"],
)
def test_even_loads_are_taken(load_mm: Floats) -> None:
    own = InfluenceFunction(**BOARD | {"load_mm": load_mm, "force_n": (7.0, 7.0)})
    assert own.position_mm == pytest.approx((load_mm[0], load_mm[-1]))


def test_an_influence_function_is_shown_in_short() -> None:
    assert repr(InfluenceFunction(**PLATE)) == "InfluenceFunction(40 x 30 mm, loads at 5..35, 2..28 mm with 2..3 N)"
    assert repr(InfluenceFunction(**BOARD | {"force_n": (7.0, 7.0)})) == (
        "InfluenceFunction(500 mm, loads at 30..470 mm with 7 N)"
    )
    assert InfluenceFunction(**BOARD).unit_mm_per_n == 1
    assert InfluenceFunction(**PLATE).diagonal_mm == 50


def test_a_board_that_turns_travels_as_its_ends_do() -> None:
    travel = travel_of(InfluenceFunction(**BOARD))
    assert travel.lift_mm == pytest.approx(7 * 1.47 * 200 / 500)
    assert travel.fall_mm == pytest.approx(7 * 1.47 * 300 / 500)
    assert travel.largest_mm == travel.fall_mm
    assert travel.slope == pytest.approx(7 * 1.47 / 500)
    assert travel.force_n == 7
    lifted = travel_of(InfluenceFunction(**BOARD | {"at": lambda sensor, load: -tilted(sensor, load)}))
    assert (lifted.lift_mm, lifted.largest_mm) == (travel.fall_mm, travel.fall_mm)
    fallen = travel_of(InfluenceFunction(**BOARD | {"at": lambda sensor, load: 1 + tilted(sensor, load) / 10}))
    assert fallen.lift_mm == 0
    risen = travel_of(InfluenceFunction(**BOARD | {"at": lambda sensor, load: tilted(sensor, load) / 10 - 1}))
    assert risen.fall_mm == 0


def test_a_plate_that_tilts_travels_as_its_corners_do() -> None:
    travel = travel_of(InfluenceFunction(**PLATE))
    assert travel.lift_mm == pytest.approx(3 * 1.35 * (0.04 * 30 - 0.5))
    assert travel.fall_mm == pytest.approx(3 * 1.35 * (0.03 * 40 + 0.5))
    assert travel.slope == pytest.approx(3 * 1.35 * 0.05)
    up, down = (InfluenceFunction(**PLATE | {"at": lambda s, x, away=away: away + plane(s, x)}) for away in (-9, 9))
    assert (travel_of(up).fall_mm, travel_of(down).lift_mm) == (0, 0)


def test_a_travel_beyond_numbers_is_refused() -> None:
    for kind, said in ((BOARD, "check contact.force_n and beam"), (PLATE, "check contact.force_n")):
        huge = {"at": lambda s, x, at=kind["at"]: 1e300 * at(s, x), "force_n": (1.0, 1e12)}
        with (
            np.errstate(over="ignore"),
            pytest.raises(SceneError, match=f"largest force is beyond what can be computed; {said}$"),
        ):
            travel_of(InfluenceFunction(**kind | huge))


def test_what_a_tolerance_changes_is_the_slope_times_it_and_at_an_end_as_well() -> None:
    board, plate = InfluenceFunction(**BOARD), InfluenceFunction(**PLATE)
    for sensor_mm in (0.0, 0.3, 123.0, 500.0):
        assert board.deviation(np.array([[sensor_mm]]), np.array([[90.0]]), 0.7) == pytest.approx(
            np.array([[[0.7 * 1.09 / 500]]])
        )
    for place in ([0.0, 0.0], [11.0, 17.0], [40.0, 30.0]):
        found = plate.deviation(np.array([place]), np.array([[20.0, 5.0]]), 0.7)
        assert found == pytest.approx(0.7 * 1.2 * np.array([[[0.03, -0.04]]]))
        assert plate.variance(np.array([place]), np.array([[20.0, 5.0]]), 0.7) == pytest.approx(
            np.array([[(0.7 * 1.2 * 0.05) ** 2]])
        )
    assert board.is_uncertain(0.1)
    assert not board.is_uncertain(0.0)
    assert not board.deviation(np.array([[123.0]]), np.array([[90.0]]), 0.0).any()


def test_what_a_table_leaves_open_stands_behind_the_axes() -> None:
    left = Interpolation(
        lambda sensor_mm, load_mm: np.outer(load_mm[:, 0], sensor_mm[:, 0]),
        5.0,
        repeats=lambda sensor_mm, load_mm: np.full((len(load_mm), len(sensor_mm)), 0.3),
        shared_at=lambda sensor_mm: sensor_mm / 1000,
    )
    board = InfluenceFunction(**BOARD, interpolation=left)
    sensor_mm, load_mm = np.array([[100.0], [300.0]]), np.array([[50.0]])
    assert board.is_uncertain(0.0)
    found = board.deviation(sensor_mm, load_mm, 0.7)
    assert found == pytest.approx(np.array([[[0.7 * 1.05 / 500, 5000, 0.3], [0.7 * 1.05 / 500, 15_000, 0.3]]]))
    assert board.shared(sensor_mm) == pytest.approx(np.array([[0.1], [0.3]]))
    assert InfluenceFunction(**BOARD).shared(sensor_mm) is None
    assert math.isnan(left.order)
    alone = Interpolation(left.deviation_at, 5.0, shared_at=lambda sensor_mm: np.zeros((len(sensor_mm), 0)))
    assert InfluenceFunction(**BOARD, interpolation=alone).shared(sensor_mm) is None
    assert InfluenceFunction(**BOARD, interpolation=Interpolation(left.deviation_at, 5.0)).shared(sensor_mm) is None


def test_loads_are_a_four_hundredth_of_a_beam_apart_and_on_a_plate_about_as_far_along_both_axes() -> None:
    assert even_loads_mm([(30.0, 430.0)], [800.0]) == pytest.approx(np.linspace(30, 430, 201))
    assert even_loads_mm([(30.0, 30.1)], [800.0]) == pytest.approx(np.array([30, 30.1]))
    # 400 by 300 mm are 1200 squares of 10 mm.
    places = even_loads_mm([(10.0, 390.0), (20.0, 104.0)], [400.0, 300.0])
    assert [len(np.unique(along)) for along in places.T] == [39, 9]
    assert (places.min(axis=0).tolist(), places.max(axis=0).tolist()) == ([10, 20], [390, 104])
    thin = even_loads_mm([(10.0, 390.0), (20.0, 21.0)], [400.0, 300.0])
    assert [len(np.unique(along)) for along in thin.T] == [39, 2]


@pytest.mark.parametrize(
    ("kind", "ranges_mm", "force_n", "size_mm", "said"),
    [
        (
            BOARD,
            ((30, 470), (1, 2)),
            (1, 7),
            None,
            "influence: its number of axes is 1, but contact has two, x_mm and y_mm",
        ),
        (PLATE, ((30, 470),), (2, 3), None, "influence: its number of axes is 2, but contact has one, position_mm"),
        (
            BOARD,
            ((30, 470),),
            (1, 7),
            [501.0],
            "influence: its length_mm is 500, but that of the scene is 501; make them equal",
        ),
        (
            BOARD,
            ((30, 470.001),),
            (1, 7),
            None,
            "influence: its load_mm is 30 to 470, but that of the scene is 30 to 470.001; make them equal",
        ),
        (
            PLATE,
            ((5, 35), (2, 28.001)),
            (2, 3),
            None,
            "influence: its load_mm is 2 to 28, but that of the scene is 2 to 28.001; make them equal",
        ),
        (
            BOARD,
            ((30, 470),),
            (1, 7.00001),
            None,
            "influence: its force_n is 1 to 7, but that of the scene is 1 to 7.00001; make them equal",
        ),
    ],
)
def test_an_influence_function_of_other_contacts_is_refused(
    kind: dict[str, Any],
    ranges_mm: tuple[tuple[float, float], ...],
    force_n: tuple[float, float],
    size_mm: list[float] | None,
    said: str,
) -> None:
    own = InfluenceFunction(**kind)
    with pytest.raises(SceneError) as refused:
        check_own(own, ranges_mm, force_n, None if size_mm is None else np.array(size_mm))
    assert str(refused.value) == said


def test_an_influence_function_of_the_same_contacts_is_taken() -> None:
    check_own(InfluenceFunction(**BOARD), ((30.0004, 470.0),), (1.0, 7.000001), np.array([500.0002]))
    check_own(InfluenceFunction(**PLATE), ((5.0, 35.0), (2.0, 28.0)), (2.0, 3.0), np.array([40.0, 30.0]))
