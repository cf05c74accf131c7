"""Influence functions of tables: what is refused, what splines give, and how far they miss what is left out."""

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from beamtouch_models import InfluenceFunction, interpolate_influence, make_scene
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError

SCENE = make_scene(
    contact={"force_n": [1, 2], "position_mm": [25, 475]}, sensors={"noise_mm": 0.02, "range_mm": [1, 100]}
)
SENSORS_MM = np.array([0.0, 20, 50, 90, 120, 160, 190, 230, 280, 310, 350, 400, 440, 500])
LOADS_MM = np.array([20.0, 60, 90, 130, 170, 210, 260, 300, 330, 380, 420, 460, 480])
WAVES = 0.3 * np.cos(LOADS_MM[:, None] / 60 + SENSORS_MM / 90) + 1


def own(**changes: Any) -> InfluenceFunction:  # noqa: ANN401
    return interpolate_influence(SCENE, **{"sensor_mm": SENSORS_MM, "load_mm": LOADS_MM, "matrix": WAVES} | changes)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sensor_mm": SENSORS_MM[[0, -1]]}, "sensor_mm: give 3 or more ascending places"),
        ({"load_mm": [20, 300, 300, 480]}, "load_mm: give 3 or more ascending places"),
        ({"load_mm": [20, 300, 200, 480]}, "load_mm: give 3 or more ascending places"),
        ({"sensor_mm": [1, 200, 500]}, "sensor_mm: give places from 0 mm, or less, to 500 mm, or more"),
        ({"load_mm": [26, 200, 480]}, "load_mm: give places from 25 mm, or less, to 475 mm, or more"),
        ({"load_mm": [20, 200, 474]}, "load_mm: give places from 25 mm, or less, to 475 mm, or more"),
        ({"load_mm": [-1, 200, 480]}, "load_mm: must be finite from 0 to 500 (given: -1)"),
        *(
            (
                {"matrix": matrix},
                "matrix: give 13 rows, one for each load, of 14 finite numbers that are not all 0",
            )
            for matrix in (WAVES.T, WAVES[:-1], 0 * WAVES, np.where(np.eye(13, 14) > 0, np.nan, WAVES))
        ),
    ],
)
def test_a_table_that_is_not_as_its_line_says_is_refused(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError) as refused:
        own(**changes)
    assert str(refused.value) == said


def test_splines_go_through_the_table_and_a_product_of_cubics_comes_back() -> None:
    assert own().at(SENSORS_MM, LOADS_MM) == pytest.approx(WAVES)
    assert own().size_mm.tolist() == [500]
    assert own().unit_mm_per_n == pytest.approx(WAVES.max())
    assert own().position_mm == (25, 475)
    assert own().force_n == (1, 2)

    def cubic(sensor_mm: Floats, load_mm: Floats) -> Floats:
        by_load, by_sensor = (load_mm / 500) ** 3 + 1, (sensor_mm / 400) ** 3 - sensor_mm / 300
        return np.outer(by_load, by_sensor)

    between = np.array([33.0, 214.0, 477.0])
    table = own(matrix=cubic(SENSORS_MM, LOADS_MM))
    assert table.at(between, between) == pytest.approx(cubic(between, between), abs=1e-9)
    assert table.interpolation is not None
    assert table.interpolation.deviation_at(between[:, None], between[:, None]) == pytest.approx(
        np.zeros((3, 3)), abs=1e-9
    )


def test_a_structure_ends_where_the_last_sensor_of_its_table_stands_however_small_it_is() -> None:
    tiny = make_scene(
        contact={"force_n": [1, 2], "position_mm": [0.1, 0.7]}, sensors={"noise_mm": 0.02, "range_mm": [1, 100]}
    )
    own = interpolate_influence(tiny, SENSORS_MM / 625, LOADS_MM / 625, WAVES)
    assert own.size_mm.tolist() == [0.8]
    assert len(own.load_mm) == 301


def missed(places_mm: Floats, values: Floats) -> Floats:
    """Return by how much the splines of the others miss each place, of which every fourth is left out at once."""
    off = np.empty_like(values)
    for index in range(1, len(places_mm) - 1):
        kept = [other for other in range(len(places_mm)) if (other - index) % 4 or other in (0, len(places_mm) - 1)]
        off[index] = CubicSpline(places_mm[kept], values[kept])(places_mm[index]) - values[index]
    off[0], off[-1] = off[1], off[-2]
    return off


def order_of(places_mm: Floats, values: Floats) -> float:
    fine = np.sqrt((missed(places_mm, values) ** 2).mean())
    coarse = np.sqrt((missed(places_mm[::2], values[::2]) ** 2).mean())
    return float(np.clip(np.log2(coarse / fine), 1, 4))


def test_what_a_table_leaves_open_is_what_it_misses_taken_to_the_distance_of_its_places() -> None:
    left = own().interpolation
    assert left is not None
    rows, columns = missed(LOADS_MM, WAVES), missed(SENSORS_MM, WAVES.T).T
    by_row, by_column = order_of(LOADS_MM, WAVES), order_of(SENSORS_MM, WAVES.T)
    of_rows = ((rows / 2**by_row) ** 2).mean(axis=0)
    of_columns = ((columns / 2**by_column) ** 2).mean(axis=0)
    worst = (by_row, 50.0) if (rows**2).sum() > (columns**2).sum() else (by_column, 60.0)
    assert (left.order, left.spacing_mm) == pytest.approx(worst)
    deviation = left.deviation_at(SENSORS_MM[:, None], LOADS_MM[:2, None])
    assert deviation == pytest.approx(np.tile(np.sqrt(of_rows), (2, 1)))
    # A fourth of the way from 50 to 90 mm: a parabola, 0 at both ends and 1 in the middle, on the deviation.
    at = np.array([[60.0]])
    rows_there = of_rows[2] + 0.25 * (of_rows[3] - of_rows[2])
    columns_there = of_columns[2] + 0.25 * (of_columns[3] - of_columns[2])
    assert left.deviation_at(at, LOADS_MM[:1, None])[0, 0] == pytest.approx(
        np.sqrt(rows_there + 0.75**2 * columns_there)
    )
    # With places of loads that are closer, the sensors are what limits the table.
    fine_mm = np.linspace(20, 480, 47)
    other = own(load_mm=fine_mm, matrix=0.3 * np.cos(fine_mm[:, None] / 60 + SENSORS_MM / 90) + 1).interpolation
    assert other is not None
    assert other.spacing_mm == 60


def test_a_table_of_few_places_is_taken_as_one_with_kinks() -> None:
    """Seven places do not tell the order, so that it is that of a kink."""

    def waves(place_mm: Floats) -> Floats:
        shapes: Floats = 1 + 0.1 * np.cos(place_mm[:, None] / 200 + place_mm / 300)
        return shapes

    few_mm = np.linspace(0, 500, 7)
    left = own(sensor_mm=few_mm, load_mm=few_mm, matrix=waves(few_mm)).interpolation
    assert left is not None
    assert left.order == 1
    more_mm = np.linspace(0, 500, 8)
    left = own(sensor_mm=more_mm, load_mm=more_mm, matrix=waves(more_mm)).interpolation
    assert left is not None
    assert left.order > 1.5


def test_a_table_that_misses_more_than_a_tenth_is_refused_with_numbers_that_follow_from_it() -> None:
    even_mm = np.linspace(0, 500, 11)
    waves = np.cos(even_mm[:, None] / 40) * np.ones(11)
    rows = missed(even_mm, waves)
    share = np.sqrt((rows**2).mean() / (waves**2).mean())
    needed = 50 * (0.1 / share) ** (1 / order_of(even_mm, waves))
    assert share > 0.1
    with pytest.raises(SceneError) as refused:
        own(sensor_mm=even_mm, load_mm=even_mm, matrix=waves)
    said = str(refused.value)
    assert said.startswith(
        "load_mm: places 50 mm apart are too coarse: splines of the others miss a place that is left"
    )
    percent, tenth, every = (float(said.partition(word)[2].split()[0]) for word in (" out by ", "more than ", "every "))
    assert percent == pytest.approx(100 * share, rel=0.05)
    assert tenth == 10
    assert 0.9 * needed < every <= needed
    with pytest.raises(SceneError, match="sensor_mm: places 50 mm apart are too coarse"):
        own(sensor_mm=even_mm, load_mm=even_mm, matrix=waves.T)
