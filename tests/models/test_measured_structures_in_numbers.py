"""A measured structure, its fit and its departures in numbers: a table of a string whose influence is known."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beamtouch_models import Scene, SceneError, make_scene
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.characteristic_fit import Characteristic
from beamtouch_models.design.physics.measured_structure import (
    MeasuredStructure,
    measured_influence_of,
    measured_structure_of,
)
from beamtouch_models.design.physics.place_table import PlaceTable
from beamtouch_models.design.physics.structure import (
    changed,
    characteristics_of,
    influence,
    size_of,
    structure_of,
    yields_alike,
)
from beamtouch_models.runtime.departures import Departures
from models.scene_limits import BEAM, PLATE, beam, made

SENSORS_MM = {"right": 390.0, "left": 80.0, "middle": 210.0}
ORDER = ("left", "middle", "right")
LOADS_MM = np.array([10.0, 60, 130, 190, 240, 310, 350, 420, 480])


def shown(load_mm: Floats) -> Floats:
    """Return what the sensors show per newton (loads, sensors), in the order of the table: waves that differ."""
    at = np.array(list(SENSORS_MM.values()))
    waves: Floats = 0.02 * np.cos((load_mm[:, None] - at) / 160) + 0.03
    return waves


def scene_of(**measured: Any) -> Scene:  # noqa: ANN401
    rows = np.column_stack([LOADS_MM, shown(LOADS_MM)]).tolist()
    head = ",".join(["position_mm", *(f"{name}_mm_per_n" for name in SENSORS_MM)])
    table = "\n".join([head, *(",".join(f"{value:.9g}" for value in row) for row in rows)])
    return make_scene(
        measured={"influence": table, "sensors_mm": SENSORS_MM, "length_mm": 500} | measured,
        contact={"force_n": [2, 8], "position_mm": [20, 470]},
        sensors={"noise_mm": 0.004, "range_mm": [1, 9]},
    )


@pytest.fixture(scope="module")
def structure() -> MeasuredStructure:
    return measured_structure_of(scene_of())


def test_sensors_are_in_order_and_each_shows_what_its_column_says(structure: MeasuredStructure) -> None:
    assert (structure.names, structure.length_mm, structure.axes) == (ORDER, 500, 1)
    assert structure.sensor_mm.tolist() == [[80], [210], [390]]
    assert structure.spacing_mm == 70
    places = np.array([33.0, 200.0, 460.0])
    wanted = shown(places)[:, [1, 2, 0]]
    assert structure.influence(structure.sensor_mm, places) == pytest.approx(wanted, rel=2e-3)
    # Each sensor is the nearest one that was measured.
    assert structure.influence([500.0, 150.0, 144.0], places) == pytest.approx(
        structure.influence([390.0, 210.0, 80.0], places)
    )
    with pytest.raises(SceneError, match=r"load_mm: must be finite from 0 to 500 \(given: 501\)"):
        structure.influence([80.0], [501.0])


def test_a_structure_that_yields_more_errs_as_much_more(structure: MeasuredStructure) -> None:
    softer, at, loads = structure.scaled(1.7).scaled(2), structure.sensor_mm, np.array([[33.0], [460.0]])
    assert softer.influence(at, loads) == pytest.approx(3.4 * structure.influence(at, loads))
    assert softer.deviation(at, loads) == pytest.approx(3.4 * structure.deviation(at, loads))
    assert softer.scatter(at, loads) == pytest.approx(3.4 * structure.scatter(at, loads))
    both = structure.deviation(at, loads) ** 2 + structure.scatter(at, loads) ** 2
    assert structure.variance(at, loads) == pytest.approx(both)


def test_the_structure_is_that_of_its_fit_between_the_places_where_it_was_evaluated(
    structure: MeasuredStructure,
) -> None:
    loads = np.array([[20.0], [33.3], [246.1], [470.0], [495.0], [3.0]])
    mean, deviation = structure.fit.at(loads)
    assert structure.influence(structure.sensor_mm, loads) == pytest.approx(mean, rel=1e-4)
    assert structure.deviation(structure.sensor_mm, loads) == pytest.approx(deviation, rel=0.1)
    assert structure.scatter(structure.sensor_mm, loads[:1])[0] == pytest.approx(structure.fit.repeatability)
    ticks = structure.ticks_mm[0]
    inside = ticks[(ticks >= 20) & (ticks <= 470)]
    assert len(inside) == 201
    assert np.diff(inside) == pytest.approx(np.full(200, 2.25))
    assert (ticks[0], ticks[1], ticks[-1], len(ticks)) == (0, 0.5, 500, 281)


def test_what_lies_beyond_an_end_by_rounding_is_as_well_known_as_the_end(structure: MeasuredStructure) -> None:
    ends, beyond = np.array([[0.0], [500.0]]), np.array([[-1e-9], [500 + 1e-9]])
    assert structure.deviation(structure.sensor_mm, beyond) == pytest.approx(
        structure.deviation(structure.sensor_mm, ends)
    )


def test_a_drawn_structure_agrees_with_the_table_and_is_another_one(structure: MeasuredStructure) -> None:
    rng, loads = np.random.default_rng(2), np.array([[95.0], [275.0], [452.0]])
    mean, deviation = structure.fit.at(loads)
    off = np.array([(structure.draw(rng).influence(structure.sensor_mm, loads) - mean) / deviation for _ in range(60)])
    assert np.abs(off.mean(axis=0)).max() < 0.5
    assert 0.6 < off.std(axis=0).min() < off.std(axis=0).max() < 1.5


class Tilted:
    """A fit that draws a tilted plane for each sensor, and keeps at which places."""

    asked = np.empty((0, 2))

    def draw(self, place_mm: Floats, _rng: np.random.Generator) -> Floats:
        self.asked = place_mm
        return np.asarray(place_mm @ [[1.0, 2.0, 0.3], [0.5, -1.0, 0.2]])


def test_a_skin_is_drawn_at_some_hundred_places_up_to_all_of_its_edges(structure: MeasuredStructure) -> None:
    ticks, fit = (np.linspace(0, 60, 82), np.linspace(0, 40, 80)), Tilted()
    mean = PlaceTable(ticks, np.zeros((82 * 80, 3)))
    skin: Any = replace(
        structure, size_mm=(60.0, 40.0), sensor_mm=np.arange(6.0).reshape(3, 2), ticks_mm=ticks, mean=mean
    )
    drawn = replace(skin, fit=fit).draw(np.random.default_rng(1))
    assert 300 < len(fit.asked) < 600
    assert (fit.asked.min(axis=0).tolist(), fit.asked.max(axis=0).tolist()) == ([0, 0], [60, 40])
    at = np.array([[13.1, 7.7], [59.0, 39.9]])
    assert drawn.influence(skin.sensor_mm, at) == pytest.approx(fit.draw(at, np.random.default_rng(1)))
    assert drawn.ticks_mm is ticks


def test_what_a_loads_scatter_is_has_the_part_that_grows_with_the_influence(structure: MeasuredStructure) -> None:
    other = replace(structure, shares=np.array([0.03, 0.0, 0.1]), repeatability=np.array([0.001, 0.002, 0.0]))
    loads = np.array([[120.0]])
    moved = structure.influence(structure.sensor_mm, loads)[0]
    wanted = [math.hypot(0.03 * moved[0], 0.001), 0.002, 0.1 * moved[2]]
    assert other.scatter(structure.sensor_mm, loads)[0] == pytest.approx(wanted)
    assert structure.loadings.shape[0] == 3
    assert structure.shared(structure.sensor_mm[[2, 0]]) == pytest.approx(structure.loadings[[2, 0]])


def test_curved_sensors_err_more_where_their_characteristic_is_steep(structure: MeasuredStructure) -> None:
    def sensor(slope: float) -> Characteristic:
        """Return a characteristic that rises with this slope beyond 0.01 mm."""
        shown_mm = np.array([-1.0, 0.0, 0.01, *np.linspace(0.02, 3, 200)])
        return Characteristic(shown_mm, np.where(shown_mm > 0.01, 0.01 + slope * (shown_mm - 0.01), shown_mm))

    flat = replace(structure, characteristics=(sensor(1.0), sensor(1.0), sensor(0.5)))
    assert flat.steepest(((20.0, 470.0),), (2.0, 8.0)) == pytest.approx(1.0)
    steep = replace(structure, characteristics=(sensor(1.0), sensor(3.0), sensor(0.5)))
    assert steep.steepest(((20.0, 470.0),), (4.0, 8.0)) == pytest.approx(3.0, rel=0.02)


def test_the_influence_function_of_a_table_is_that_of_its_structure(structure: MeasuredStructure) -> None:
    own = measured_influence_of(scene_of())
    assert (own.length_mm, own.position_mm, own.force_n) == (500, (20, 470), (2, 8))
    assert len(own.load_mm) == 361
    assert own.unit_mm_per_n == pytest.approx(0.05, rel=2e-3)
    assert own.interpolation is not None
    assert own.interpolation.spacing_mm == 70
    at, loads = structure.sensor_mm, np.array([[120.0]])
    assert own.interpolation.deviation_at(at, loads) == pytest.approx(structure.deviation(at, loads))
    assert own.interpolation.repeats is not None
    assert own.interpolation.repeats(at, loads) == pytest.approx(structure.scatter(at, loads))


def test_a_load_that_is_spread_is_the_mean_over_the_part_on_the_structure(structure: MeasuredStructure) -> None:
    fine = np.linspace(-15, 15, 3001)
    for place in (5.0, 245.0):
        loads = np.clip(place + fine, 0, 500)
        wanted = structure.influence(structure.sensor_mm, loads).mean(axis=0)
        found = influence(structure, structure.sensor_mm, [place], 30.0)
        assert found[0] == pytest.approx(wanted, rel=1e-3)
    assert influence(structure, structure.sensor_mm, [245.0]) == pytest.approx(
        structure.influence(structure.sensor_mm, [245.0])
    )


def test_what_departs_on_a_measured_structure_is_its_scale_only(structure: MeasuredStructure) -> None:
    none, loads = Departures.none(3), np.array([120.0])
    at = structure.sensor_mm
    stiffer = changed(structure, none.model_copy(update={"rigidity": 1.6}))
    assert influence(stiffer, at, loads) == pytest.approx(influence(structure, at, loads) / 1.6)
    for update, said in (
        ({"fixity": (0.0, 0.1)}, "fixity: the supports of a measured structure are not known; give 0 for both"),
        ({"spring_stiffness": [1.0]}, "spring_stiffness is for a plate; leave it out"),
    ):
        with pytest.raises(SceneError) as refused:
            changed(structure, none.model_copy(update=update))
        assert str(refused.value) == said
    with pytest.raises(SceneError, match="spring_stiffness is for a plate"):
        changed(made(BEAM).solid, none.model_copy(update={"spring_stiffness": [1.0]}))


def test_contacts_go_no_farther_than_a_theory() -> None:
    at_mm = np.array([30.0, 110, 240, 450])
    rows = np.column_stack([at_mm, np.full(4, 4.0), 4 * shown(at_mm)]).tolist()
    head = ",".join(["position_mm", "force_n", *(f"{name}_deflection_mm" for name in SENSORS_MM)])
    theory_mm = np.linspace(25, 460, 30)
    by_theory = np.column_stack([theory_mm, shown(theory_mm)]).tolist()
    theory = ",".join(["position_mm", *(f"{name}_mm_per_n" for name in SENSORS_MM)])
    influence, theory = (
        "\n".join([first, *(",".join(f"{number:.9g}" for number in row) for row in table)])
        for first, table in ((head, rows), (theory, by_theory))
    )
    with pytest.raises(SceneError) as refused:
        measured_structure_of(scene_of(influence=influence, theory=theory))
    assert str(refused.value) == (
        "contact.position_mm goes from 20 to 470 mm, but measured.theory from 25 to 460 mm; compute it over the whole "
        "range"
    )


def test_structures_say_their_size_and_whether_all_of_them_yields_alike(structure: MeasuredStructure) -> None:
    assert size_of(structure) == (500,)
    assert size_of(made(BEAM).solid) == (400,)
    assert size_of(made(PLATE).solid) == (400, 300)
    assert [yields_alike(one) for one in (structure, made(PLATE).solid, made(BEAM).solid)] == [True] * 3
    assert not yields_alike(made(BEAM, beam(foundation_n_mm2=1)).solid)
    assert not yields_alike(made(BEAM, beam(shear_modulus_gpa=80)).solid)
    assert structure_of(made(BEAM)) == made(BEAM).beam
    assert characteristics_of(made(BEAM), np.array([80.0])) == ()
    assert characteristics_of(scene_of(), np.array([80.0])) == ()


def test_curved_sensors_need_a_noise_and_loads_as_heavy_as_their_contacts() -> None:
    place, force = np.repeat(LOADS_MM, 3), np.tile([2.0, 4.0, 8.0], 9)
    table = np.column_stack([place, force, force[:, None] * shown(place)]).tolist()
    head = ",".join(["position_mm", "force_n", *(f"{name}_deflection_mm" for name in SENSORS_MM)])
    text = "\n".join([head, *(",".join(f"{value:.9g}" for value in row) for row in table)])

    def curved(force_n: list[float], **sensors: float) -> Scene:
        return make_scene(
            measured={"influence": text, "sensors_mm": SENSORS_MM, "length_mm": 500, "curved": True},
            contact={"force_n": force_n, "position_mm": [20, 470]},
            sensors={"range_mm": [1, 9], **sensors},
        )

    found = measured_structure_of(curved([2, 8.4], noise_mm=0.0003, zero_drift_mm=0.0004))
    assert len(found.characteristics) == 3
    assert characteristics_of(curved([2, 8.4], noise_mm=0.0003, zero_drift_mm=0.0004), np.array([390.0, 80.0])) == (
        found.characteristics[2],
        found.characteristics[0],
    )
    with pytest.raises(SceneError) as refused:
        measured_structure_of(curved([2, 8.41], noise_mm=0.001))
    assert str(refused.value) == (
        "contact.force_n goes to 8.41 N, but the heaviest load of the table is 8 N, and nobody knows what a curved "
        "sensor shows beyond it; end contact.force_n at 8, or record heavier loads"
    )
    needs = "measured.curved needs sensors.noise_mm, as what a sensor shows begins beyond it; state it"
    for sensors in ({"noise_percent_of_max": 1.0}, {"noise_mm": 0.0}):
        with pytest.raises(SceneError) as refused:
            measured_structure_of(curved([2, 8], **sensors))
        assert str(refused.value) == needs
