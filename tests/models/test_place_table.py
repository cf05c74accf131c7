"""Tables over places: cubics come back exactly, on one axis and on two."""

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.place_table import PlaceTable
from beamtouch_models.places import Extent, grid_of

LINE, PLANE = Extent(((20.0, 380.0),)), Extent(((-3.0, 7.0), (1.0, 5.0)))


def along(place: Floats) -> Floats:
    """Return two columns (places, 2) of a cubic of one axis."""
    x = place[..., 0] / 100
    return np.stack([x**3 - 4 * x**2 + 2, 3 * x - 1], axis=-1)


def across(place: Floats) -> Floats:
    """Return two columns (places, 2) of cubics of two axes."""
    x, y = place[..., 0], place[..., 1]
    return np.stack([x**3 * y - 2 * x * y**3 + 5, x**2 - 7 * y], axis=-1)


def across_slope(place: Floats) -> Floats:
    x, y = place[..., 0], place[..., 1]
    by_x, by_y = [3 * x**2 * y - 2 * y**3, 2 * x], [x**3 - 6 * x * y**2, np.full_like(x, -7.0)]
    return np.stack([np.stack(by_x, axis=-1), np.stack(by_y, axis=-1)], axis=-1)


def test_a_cubic_of_one_axis_comes_back() -> None:
    table, places = PlaceTable.over(LINE, along), np.array([[20.0], [33.3], [251.7], [380.0]])
    assert table.values.shape == (2001, 2)
    assert table(places) == pytest.approx(along(places), rel=1e-9)
    assert table(places.reshape(2, 2, 1)) == pytest.approx(along(places).reshape(2, 2, 2), rel=1e-9)
    x = places / 100
    wanted = np.stack([(3 * x**2 - 8 * x) / 100, np.full_like(x, 0.03)], axis=1)
    assert table.slope(places) == pytest.approx(wanted, rel=1e-6)


def test_a_cubic_of_two_axes_comes_back() -> None:
    table, places = PlaceTable.over(PLANE, across), np.array([[-3.0, 5.0], [0.4, 1.0], [2.2, 3.7], [7.0, 1.3]])
    assert table.values.shape == (64 * 64, 2)
    assert table(places) == pytest.approx(across(places), rel=1e-9)
    assert table.slope(places) == pytest.approx(across_slope(places), rel=1e-7, abs=1e-7)


def test_values_on_grids_are_those_at_their_places() -> None:
    ticks = [np.array([[-3.0, -2.9, -2.5], [6.2, 6.9, 7.0]]), np.array([[4.4, 5.0], [1.0, 2.6]])]
    grids = np.array([grid_of([x, y]) for x, y in zip(*ticks, strict=True)])
    for table in (PlaceTable.over(PLANE, across), PlaceTable.over(PLANE, across, least=-20.0)):
        assert table.on_grids(ticks) == pytest.approx(table(grids), rel=1e-9, abs=1e-9)
    assert table(grids).min() == -20.0


def test_no_value_is_below_the_least() -> None:
    places = np.array([[33.3], [251.7]])
    assert PlaceTable.over(LINE, along, least=0.5)(places) == pytest.approx(np.maximum(along(places), 0.5), rel=1e-9)
