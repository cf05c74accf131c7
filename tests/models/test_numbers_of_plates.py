"""Plates in numbers: curvature and bow in closed form, the places for their sensors, and what cannot be computed."""

import math
from typing import Any

import numpy as np
import pytest

from beamtouch_models import SceneError
from beamtouch_models.design.physics.plate import (
    free_plate,
    heated,
    influence,
    influence_of,
    load_places_mm,
    places_of_sensors,
    supported_plate,
)
from beamtouch_models.design.physics.structure import changed
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.scene.tables import Sensors
from beamtouch_models.runtime.departures import Departures
from models.scene_limits import PLATE, contact, made, plate

SIZE = {"length_x_mm": 400.0, "length_y_mm": 300.0, "thickness_mm": 3.0, "youngs_modulus_gpa": 210.0}


def steel(**changed: Any) -> Plate:  # noqa: ANN401
    return Plate.model_validate(SIZE | changed)


def test_a_strip_on_two_lines_has_the_curvature_of_its_moment() -> None:
    """Without lateral contraction, M / (E I) with M = F b x / l under a load across the whole width."""
    strip = steel(length_y_mm=20.0, thickness_mm=4.0, poisson_ratio=0.0, supports=[{"x_mm": 0}, {"x_mm": 400}])
    rigidity = 210e3 * 20 * 64 / 12
    found = supported_plate(strip).curvatures(np.array([[90.0, 10.0], [330.0, 10.0]]), np.array([[240.0, 10.0]]), 20.0)
    wanted = np.array([160 * 90 / 400, 240 * 70 / 400]) / rigidity
    assert -found[0] == pytest.approx(wanted, rel=0.02)


def test_the_sum_of_curvatures_is_by_how_much_slopes_change_along_both_axes() -> None:
    """Within an element these are differences of parabolas along the axis, which are exact."""
    solved, load = supported_plate(steel()), np.array([[250.0, 90.0]])
    at, step_mm = np.array([[106.25, 43.75], [231.25, 206.25]]), 3.0
    wanted = np.zeros((1, 2))
    for axis in (0, 1):
        ends = (solved.slopes(at + side * step_mm * np.eye(2)[axis], load)[..., axis] for side in (1, -1))
        wanted += (next(ends) - next(ends)) / (2 * step_mm)
    assert solved.curvatures(at, load) == pytest.approx(wanted, rel=1e-6)


def test_a_plate_that_is_warmer_above_bows_as_a_cap() -> None:
    """On its corners the free cap is held nowhere else: alpha / t times half the square of the distance."""
    one = steel(expansion_um_per_m_k=12.0)
    at = np.array([[200.0, 150.0], [100.0, 40.0], [0.0, 300.0]])
    squares = ((at - [200, 150]) ** 2).sum(axis=1)
    wanted = 12e-6 / 3 * (squares - 250**2) / 2
    assert heated(one, at) == pytest.approx(wanted, abs=1e-6 * abs(wanted).max())
    with pytest.raises(SceneError, match="plate: state material or expansion_um_per_m_k; it sets how far heat bows"):
        heated(steel(), at)
    # On soft springs it takes the same form, and the springs do not move.
    assert heated(steel(expansion_um_per_m_k=12.0, support_stiffness_n_per_mm=2.0), at) == pytest.approx(
        wanted, abs=1e-6 * abs(wanted).max()
    )


def test_edges_hold_a_plate_that_is_warmer_above() -> None:
    held = steel(expansion_um_per_m_k=12.0, supports="edges")
    *edges, middle = heated(held, np.array([[200.0, 0.0], [0.0, 150.0], [400.0, 111.0], [200.0, 150.0]])).tolist()
    assert edges == pytest.approx([0, 0, 0], abs=1e-9)
    free = heated(steel(expansion_um_per_m_k=12.0), np.array([[200.0, 150.0]]))[0]
    assert free < middle < 0.1 * free


def test_lateral_contraction_stiffens_a_plate_as_kirchhoff_says() -> None:
    assert steel(poisson_ratio=0.2).rigidity_n_mm == pytest.approx(210e3 * 27 / 12 / 0.96)
    assert steel().rigidity_n_mm == pytest.approx(210e3 * 27 / 12 / 0.91)
    assert steel(youngs_modulus_gpa=None, material="glass").rigidity_n_mm == pytest.approx(70e3 * 27 / 12 / 0.96)
    assert steel(material="glass").rigidity_n_mm == pytest.approx(210e3 * 27 / 12 / 0.96)


def test_elements_are_about_square_and_no_fewer_than_six_along_a_side() -> None:
    for lengths, elements in (((1.0, 0.75), (32, 24)), ((0.75, 1.0), (24, 32)), ((1.0, 0.01), (128, 6))):
        body = free_plate(*lengths, 0.3)
        assert (body.x.elements, body.y.elements) == elements
        assert (body.x.length, body.y.length) == lengths
        assert len(body.free) == body.x.unknowns * body.y.unknowns - 3


def test_a_plate_is_factored_once_whatever_holds_it() -> None:
    one, other = (supported_plate(steel(thickness_mm=t, support_stiffness_n_per_mm=k)) for t, k in ((3, 15), (5, 40)))
    assert supported_plate(steel(thickness_mm=3, support_stiffness_n_per_mm=15)) is one
    assert one is not other
    assert one.body is other.body


def test_a_plate_beyond_numbers_is_refused() -> None:
    said = "plate: its deflection is beyond what can be computed; check its lengths, thickness and springs"
    for changes in (
        {"length_x_mm": 1e200, "length_y_mm": 1e200},
        {"length_x_mm": 1e-140, "length_y_mm": 1e-140, "thickness_mm": 1e10},
        {"length_x_mm": 1e-100, "length_y_mm": 1e-100, "support_stiffness_n_per_mm": 1e-300},
    ):
        with pytest.raises(SceneError) as refused:
            influence(steel(**changes), [[0.0, 0.0]], [[0.0, 0.0]])
        assert str(refused.value) == said


def test_an_influence_function_of_a_plate_has_its_scene_s_contacts() -> None:
    scene = made(PLATE, contact(width_mm=9))
    assert scene.plate is not None
    own = influence_of(scene, scene.plate)
    assert (own.length_mm, own.extent.ranges_mm, own.force_n) == ((400, 300), ((10, 390), (20, 280)), (2, 20))
    assert own.unit_mm_per_n == pytest.approx(400**2 / scene.plate.rigidity_n_mm)
    at, load = np.array([[100.0, 70.0]]), np.array([[300.0, 200.0]])
    assert own.at(at, load) == pytest.approx(influence(scene.plate, at, load, 9.0))
    assert abs(own.at(load, load) - influence(scene.plate, load, load)).max() > 1e-6
    assert [len(np.unique(along)) for along in load_places_mm(scene, scene.plate).T] == [39, 27]


def places(plate: Plate, **keys: Any) -> tuple[np.ndarray, list[int]]:  # noqa: ANN401
    found, fixed = places_of_sensors(plate, Sensors(noise_mm=0.01, **keys))
    return found, fixed.tolist()


def test_sensors_stand_on_the_grid_of_a_plate_where_a_housing_has_room() -> None:
    square = steel(length_x_mm=100.0, length_y_mm=70.0, supports=[{"x_mm": 50, "y_mm": 0}, {"x_mm": 0}])
    found, fixed = places(square, grid_mm=25, size_mm=20)
    assert found.tolist() == [[x, y] for x in (25, 50, 75) for y in (25, 50)]
    assert fixed == []
    found, fixed = places(
        square, grid_mm=25, size_mm=20, fixed=[{"x_mm": 75, "y_mm": 50}, {"x_mm": 33, "y_mm": 44}],
        keep_out=[{"x_mm": [40, 60], "y_mm": [30, 70]}],
    )  # fmt: skip
    assert found.tolist() == [[25, 25], [25, 50], [33, 44], [75, 25], [75, 50]]
    assert fixed == [2, 4]
    # A fixed place that differs by rounding takes the place of that of the grid.
    found, fixed = places(square, grid_mm=25, size_mm=20, fixed=[{"x_mm": 75 + 5e-8, "y_mm": 50}])
    assert found[fixed].tolist() == [[75 + 5e-8, 50]]
    assert len(found) == 6
    found, _ = places(steel(length_x_mm=0.3, length_y_mm=0.2, thickness_mm=0.01), grid_mm=0.1, size_mm=0)
    assert sorted(set(found[:, 0].tolist())) == [0, 0.1, 0.2, 0.3]


def test_a_grid_that_is_not_stated_has_forty_steps_along_a_plate_and_eight_across() -> None:
    for lengths, steps in (((400, 300), (10, 10)), ((400, 40), (5, 5)), ((4000, 20), (6, 6)), ((30, 20), (1, 1))):
        one = steel(length_x_mm=float(lengths[0]), length_y_mm=float(lengths[1]), thickness_mm=1.0, supports="edges")
        found, _ = places(one, size_mm=2)
        assert [float(np.diff(np.unique(along)).min()) for along in found.T] == list(steps)


def test_places_for_sensors_of_a_plate_that_make_no_layout_are_refused() -> None:
    with pytest.raises(SceneError) as refused:
        places(steel(), grid_mm=3.4)
    assert str(refused.value) == ("sensors.grid_mm = 3.4 makes more than 10000 places on the plate; make it coarser")
    square = steel(length_y_mm=400.0)
    assert len(places(square, grid_mm=4, size_mm=0)[0]) == 101**2 - 4  # without the corners, where it is held
    with pytest.raises(SceneError) as refused:
        places(steel(), grid_mm=200, size_mm=150)
    assert str(refused.value) == (
        "sensors: grid_mm, size_mm and keep_out leave fewer than two places; keep out less, refine the grid, or "
        "correct size_mm"
    )
    found, _ = places(steel(), grid_mm=200, size_mm=150, fixed=[{"x_mm": 100, "y_mm": 100}])
    assert found.tolist() == [[100, 100], [200, 200]]


def test_springs_of_a_plate_change_one_by_one_and_with_its_rigidity() -> None:
    sprung = made(PLATE, plate(support_stiffness_n_per_mm=20)).plate
    assert sprung is not None
    none = Departures.none(4)
    other = changed(sprung, none.model_copy(update={"rigidity": 1.5, "spring_stiffness": [1.0, 2.0, 0.5, 1.0]}))
    assert isinstance(other, Plate)
    assert [one.stiffness_n_per_mm for one in other.support_list] == pytest.approx([30, 60, 15, 30])
    assert other.rigidity_n_mm == pytest.approx(1.5 * sprung.rigidity_n_mm)
    assert (sprung.is_sprung, steel().is_sprung) == (True, False)
    rigid = changed(steel(), none.model_copy(update={"rigidity": 1.5, "spring_stiffness": [1.0, 2.0, 0.5, 1.0]}))
    assert isinstance(rigid, Plate)
    assert [one.stiffness_n_per_mm for one in rigid.support_list] == [None] * 4
    with pytest.raises(SceneError, match="spring_stiffness has 3 entries for 4 supports"):
        changed(sprung, none.model_copy(update={"spring_stiffness": [1.0, 2.0, 0.5]}))
    with pytest.raises(SceneError, match="rigidity: must be a finite number"):
        changed(sprung, none.model_copy(update={"rigidity": math.inf}))


def test_an_edge_is_a_line_whose_ends_count_and_a_corner_is_a_point() -> None:
    assert steel(supports=[{"x_mm": 40}, {"x_mm": 90, "y_mm": 20}]).support_points == ((40, 0), (40, 300), (90, 20))
    assert steel(supports="corners").support_points == ((0, 0), (0, 300), (400, 0), (400, 300))
    assert [(one.x_mm, one.y_mm) for one in steel(supports="edges").support_list] == [
        (0, None), (400, None), (None, 0), (None, 300),
    ]  # fmt: skip


def test_a_spring_of_a_line_is_shared_along_it() -> None:
    """A plate that is as good as rigid sinks by F / 2 k in the middle between two lines with springs of k."""
    thick = steel(thickness_mm=50.0, supports=[{"x_mm": 0, "stiffness_n_per_mm": 7}, {"x_mm": 400}],
        support_stiffness_n_per_mm=3.0)  # fmt: skip
    corner, middle = [0.0, 150.0], [200.0, 150.0]
    found = influence(thick, [corner, middle, [400.0, 150.0]], [middle])
    assert found[0] == pytest.approx([0.5 / 7, (0.5 / 7 + 0.5 / 3) / 2, 0.5 / 3], rel=1e-2)
    assert influence(thick, [corner], [corner])[0, 0] == pytest.approx(1 / 7, rel=1e-2)
