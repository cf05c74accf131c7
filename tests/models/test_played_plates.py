"""What `challenge` plays of plates, and of sensors beside their places, by the places that it asks the theory for."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.lab.challenge import faults, plates
from beamtouch_models.lab.challenge.play import DrawnContacts, SimulatedSurface
from beamtouch_models.runtime import load
from models.bench_contacts import drawn

LOW_MM, HIGH_MM = np.array([10.0, 10.0]), np.array([390.0, 290.0])


@pytest.fixture(scope="module")
def plate_surface(plate_model: Path) -> SimulatedSurface:
    return SimulatedSurface.of(load(plate_model).metadata)


@pytest.fixture
def pressed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Floats, Floats]]:
    """The places and forces of loads, in the order in which a play presses them."""
    under, asked = SimulatedSurface.under, list[tuple[Floats, Floats]]()

    def recorded(self: SimulatedSurface, place_mm: Floats, force_n: Floats) -> Floats:
        asked.append((place_mm.copy(), force_n.copy()))
        return under(self, place_mm, force_n)

    monkeypatch.setattr(SimulatedSurface, "under", recorded)
    return asked


def test_two_contacts_on_a_plate_lie_so_far_apart_in_any_direction(
    plate_surface: SimulatedSurface, pressed: list[tuple[Floats, Floats]]
) -> None:
    at = DrawnContacts.of(plate_surface, 400, np.random.default_rng(5))
    faults.two_contacts(at, apart=0.5, ratio=4.0)
    (first, weak_n), (second, strong_n) = pressed
    assert strong_n == pytest.approx(4 * weak_n)
    assert weak_n + strong_n == pytest.approx(at.force_n)
    ways = (second - first) / (HIGH_MM - LOW_MM)
    assert np.linalg.norm(ways, axis=1) == pytest.approx(np.full(400, 0.5))
    # A quarter of them in each quarter, and all angles in it.
    signs, counts = np.unique(np.sign(ways), axis=0, return_counts=True)
    assert len(signs) == 4
    assert counts == pytest.approx(np.full(4, 100), abs=35)
    angles = np.degrees(np.arctan2(*np.abs(ways).T))
    assert np.quantile(angles, [0.0, 0.25, 0.5, 0.75, 1.0]) == pytest.approx([0, 22.5, 45, 67.5, 90], abs=5)
    for place in (first, second):
        assert np.all((place >= LOW_MM) & (place <= HIGH_MM))
        assert np.ptp(place, axis=0) == pytest.approx(HIGH_MM - LOW_MM, rel=0.05)


def test_two_contacts_at_the_quarters_of_a_plate_lie_on_its_diagonal(
    plate_surface: SimulatedSurface, pressed: list[tuple[Floats, Floats]]
) -> None:
    faults.two_at_the_quarters(DrawnContacts.of(plate_surface, 3, np.random.default_rng(5)))
    ((places, force_n),) = pressed
    assert places == pytest.approx(np.array([[105.0, 80.0], [295.0, 220.0]]))
    assert force_n == pytest.approx([0.4 * plate_surface.metadata.ranges.force_n[1]] * 2)


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Floats, Floats, float]]:
    """Sensors, loads and widths for which faults ask the theory, which answers with zeros."""
    asked = list[tuple[Floats, Floats, float]]()

    def influence(_structure: object, sensor_mm: Floats, load_mm: Floats, width_mm: float) -> Floats:
        asked.append((np.array(sensor_mm), np.array(load_mm), width_mm))
        return np.zeros((len(load_mm), len(sensor_mm)))

    monkeypatch.setattr(faults, "influence", influence)
    return asked


@pytest.mark.parametrize(("part", "side_mm"), [(0.1, 30.0), (0.5, 150.0)])
def test_a_load_is_spread_over_a_square_that_lies_within_the_range(
    plate_surface: SimulatedSurface, computed: list[tuple[Floats, Floats, float]], part: float, side_mm: float
) -> None:
    faults.distributed(DrawnContacts.of(plate_surface, 300, np.random.default_rng(5)), part=part)
    ((_, middle, width_mm),) = computed
    assert width_mm == pytest.approx(side_mm)
    assert np.all((middle >= LOW_MM + side_mm / 2) & (middle <= HIGH_MM - side_mm / 2))
    assert np.ptp(middle, axis=0) == pytest.approx(HIGH_MM - LOW_MM - side_mm, rel=0.05)


def test_a_load_that_is_wider_than_the_range_has_its_middle_in_that_of_the_range(
    surface: SimulatedSurface, computed: list[tuple[Floats, Floats, float]]
) -> None:
    ranges = surface.metadata.ranges.model_copy(update={"position_mm": (100.0, 250.0)})
    short = replace(surface, metadata=surface.metadata.model_copy(update={"ranges": ranges}))
    faults.distributed(drawn(short, 5), part=0.5)
    ((_, middle, width_mm),) = computed
    assert (width_mm, middle.tolist()) == (200.0, [175.0] * 5)


def at_the_ends(surface: SimulatedSurface, sensor_mm: Floats) -> SimulatedSurface:
    return replace(surface, world=replace(surface.world, sensor_mm=sensor_mm))


@pytest.mark.parametrize("axes", [1, 2])
def test_sensors_beside_their_places_stay_on_the_structure(
    surface: SimulatedSurface, plate_surface: SimulatedSurface, computed: list[tuple[Floats, Floats, float]], axes: int
) -> None:
    given = np.array([0.0, 150.0, 250.0, 400.0])
    if axes == 2:
        given = np.array([[0.0, 0.0], [150.0, 100.0], [250.0, 300.0], [400.0, 200.0]])
    at = drawn(at_the_ends(surface if axes == 1 else plate_surface, given), 300)
    faults.places_off(at)
    assert [load.ravel().tolist() for _, load, _ in computed] == at.place_mm.tolist()
    sensors = np.array([sensor_mm for sensor_mm, _, _ in computed])
    size_mm = 400.0 if axes == 1 else np.array([400.0, 300.0])
    assert np.all((sensors >= 0) & (sensors <= size_mm))
    off_mm = sensors - given
    middle = (given > 0) & (given < size_mm)
    assert off_mm[:, middle].std() == pytest.approx(1.0, rel=0.1)
    assert off_mm[:, middle].mean() == pytest.approx(0.0, abs=0.1)
    # Half of those at an end would be beyond it.
    assert (off_mm[:, ~middle] == 0).mean() == pytest.approx(0.5, abs=0.08)


def names_of(surface: SimulatedSurface) -> list[Callable[..., object]]:
    makes = [case.make for case in plates.plate_cases(surface)]
    return [make.func if isinstance(make, partial) else make for make in makes]


def test_a_plate_has_the_cases_that_its_scene_allows(
    surface: SimulatedSurface, plate_surface: SimulatedSurface
) -> None:
    spring, heat, rim = plates.spring_gives_way, plates.hot_above, plates.at_the_rim
    assert names_of(surface) == []
    assert names_of(plate_surface) == [spring, heat, heat, rim]
    plate = plate_surface.world.structure
    assert isinstance(plate, Plate)

    def of(structure: Plate, reach_mm: float = 10.0) -> SimulatedSurface:
        ranges = plate_surface.metadata.ranges.model_copy(
            update={"position_mm": (0.0, 400.0 - reach_mm), "across_mm": (0.0, 300.0)}
        )
        metadata = plate_surface.metadata.model_copy(update={"ranges": ranges})
        return replace(plate_surface, metadata=metadata, world=replace(plate_surface.world, structure=structure))

    rigid = tuple(one.model_copy(update={"stiffness_n_per_mm": None}) for one in plate.support_list)
    one_spring = (*rigid[:3], plate.support_list[3])
    assert names_of(of(plate.model_copy(update={"supports": rigid}))) == [heat, heat, rim]
    assert names_of(of(plate.model_copy(update={"supports": one_spring}))) == [spring, heat, heat, rim]
    assert names_of(of(plate, reach_mm=0.4)) == [spring, heat, heat]
    assert names_of(of(plate, reach_mm=0.6)) == [spring, heat, heat, rim]
    cold = plate.model_copy(update={"material": None, "expansion_um_per_m_k": None})
    assert names_of(of(cold)) == [spring, rim]
    assert all(not case.honest for case in plates.plate_cases(plate_surface))


def test_contacts_on_the_rim_are_as_often_at_an_edge_as_it_is_deep_and_up_to_so_deep(
    plate_surface: SimulatedSurface,
) -> None:
    """From 30 mm to 400 mm along x, and from 10 mm to 280 mm along y: depths of 30, 0, 10 and 20 mm."""
    ranges = plate_surface.metadata.ranges.model_copy(update={"position_mm": (30.0, 400.0), "across_mm": (10.0, 280.0)})
    inner = replace(plate_surface, metadata=plate_surface.metadata.model_copy(update={"ranges": ranges}))
    assert plates.beyond_mm(inner).tolist() == [[30.0, 0.0], [10.0, 20.0]]
    at = DrawnContacts.of(inner, 600, np.random.default_rng(5))
    there = plates.at_the_rim(at).truth_mm[:, -1]
    depths = np.column_stack([30 - there[:, 0], there[:, 0] - 400, 10 - there[:, 1], there[:, 1] - 280])
    beyond = depths > 0
    assert (beyond.sum(axis=1) == 1).all()
    assert beyond.mean(axis=0) == pytest.approx([0.5, 0.0, 1 / 6, 1 / 3], abs=0.06)
    for edge, most_mm in ((0, 30.0), (2, 10.0), (3, 20.0)):
        own = depths[beyond[:, edge], edge]
        assert own.max() == pytest.approx(most_mm, rel=0.06)
        assert own.max() <= most_mm
        assert own.mean() == pytest.approx(most_mm / 2, rel=0.15)
