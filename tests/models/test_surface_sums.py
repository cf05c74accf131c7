"""What follows from a scene by plain arithmetic: the scale of its sensors, and where sensors may stand."""

import numpy as np
import pytest

from beamtouch_models import change_scene, resolve
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.influence_function import InfluenceFunction, Travel
from beamtouch_models.design.scene import Scene, parse_scene
from beamtouch_models.design.surface import Surface, _sensor_of, rules_of
from beamtouch_models.errors import SceneError
from beamtouch_models.places import grid_of, on_axis
from models.loaded_string import STRING
from support.surfaces.example_scenes import PAPER, paper_scene


def scene_of(**sensors: object) -> Scene:
    return paper_scene(noise_percent_of_max=None, noise_mm=0.01, range_mm=(1.0, 4.0), **sensors)


def travel(fall_mm: float, lift_mm: float = 0.0) -> Travel:
    return Travel(lift_mm=lift_mm, fall_mm=fall_mm, slope=0.01, force_n=20.0)


@pytest.mark.parametrize(("bits", "steps"), [(None, 65535), (12, 4095), (10, 1023)])
def test_the_range_of_a_sensor_takes_the_middle_eight_tenths_of_the_scale(bits: int | None, steps: int) -> None:
    """3 mm are eight tenths of 3.75 mm, which begin 0.375 mm before the range."""
    sensor = _sensor_of(scene_of(adc_bits=bits, rate_hz=321.0), travel(1.0))
    assert sensor.gain_mm_per_count == pytest.approx(3.75 / steps)
    assert sensor.offset_mm == pytest.approx(0.625)
    assert (sensor.adc_bits, sensor.rate_hz, sensor.range_mm) == (bits or 16, 321.0, (1.0, 4.0))


@pytest.mark.parametrize(("fall_mm", "lift_mm", "standoff_mm"), [(1.0, 0.0, 3.0), (2.0, 0.5, 3.25), (0.25, 1.5, 1.875)])
def test_a_gap_is_centred_so_that_fall_and_lift_end_as_far_from_the_range(
    fall_mm: float, lift_mm: float, standoff_mm: float
) -> None:
    sensor = _sensor_of(scene_of(), travel(fall_mm, lift_mm))
    assert sensor.standoff_mm == pytest.approx(standoff_mm)
    assert (standoff_mm - fall_mm) - 1 == pytest.approx(4 - (standoff_mm + lift_mm))


@pytest.mark.parametrize(
    ("fall_mm", "lift_mm", "stated_mm", "said"),
    [
        (2.0, 1.0, None, ""),
        (
            2.0,
            1.0001,
            None,
            "at 20 N the beam travels 3 mm and leaves sensors.range_mm = \\[1, 4\\]; end contact.force_n",
        ),
        (
            4.0,
            2.0,
            None,
            "travels 6 mm .* end contact.force_n at 10 N, make the beam 2 times as stiff, or use a sensor",
        ),
        (4.123456, 2.0, None, r"travels 6\.123 mm and leaves"),
        (2.0, 0.51234, 2.9, r"write standoff_mm = 3\.244, or leave it out"),
        (2.0, 0.5, 3.0, ""),
        (2.0, 0.5, 3.5, ""),
        (
            2.0,
            0.5,
            2.99,
            "from sensors.standoff_mm = 2.99 the beam leaves .* write standoff_mm = 3.25, or leave it out",
        ),
        (2.0, 0.5, 3.51, "from sensors.standoff_mm = 3.51 the beam leaves sensors.range_mm = \\[1, 4\\]"),
    ],
)
def test_a_beam_stays_within_the_range_of_its_sensors(
    fall_mm: float, lift_mm: float, stated_mm: float | None, said: str
) -> None:
    scene = scene_of(standoff_mm=stated_mm)
    if not said:
        assert stated_mm is None or _sensor_of(scene, travel(fall_mm, lift_mm)).standoff_mm == stated_mm
        return
    with pytest.raises(SceneError, match=said):
        _sensor_of(scene, travel(fall_mm, lift_mm))


def test_sensors_on_a_plate_of_ones_own_stand_on_a_grid_within_its_rim() -> None:
    size_mm = np.array([400.0, 150.0])
    rules = rules_of(scene_of(grid_mm=25.0, size_mm=10.0, min_distance_mm=12.0), size_mm)
    ticks = [np.arange(5.0, 396.0, 25.0), np.arange(5.0, 146.0, 25.0)]
    assert rules.place_mm == pytest.approx(grid_of(ticks))
    assert (rules.min_distance_mm, rules.fixed.tolist()) == (12.0, [])
    # A finer grid than a hundredth of the longer side takes long and wins nothing.
    fine = rules_of(scene_of(grid_mm=1.0, size_mm=0.0), size_mm)
    assert [len(np.unique(column)) for column in fine.place_mm.T] == [101, 38]
    assert fine.place_mm.max(axis=0) == pytest.approx([400.0, 148.0])


@pytest.mark.parametrize(
    ("size_mm", "min_distance_mm", "mounting_tolerance_mm", "apart_mm"),
    [(10.0, 0.0, 0.0, 10.0), (10.0, 12.0, 3.0, 12.0), (10.0, 12.0, 20.0, 20.02), (0.0, 0.0, 0.0, 0.0)],
)
def test_sensors_are_apart_by_their_housings_their_distance_and_more_than_their_tolerance(
    size_mm: float, min_distance_mm: float, mounting_tolerance_mm: float, apart_mm: float
) -> None:
    rules = rules_of(
        scene_of(
            size_mm=size_mm,
            min_distance_mm=min_distance_mm,
            mounting_tolerance_mm=mounting_tolerance_mm,
            fixed_mm=[120.0, 300.0],
        ),
        np.array([400.0]),
    )
    assert rules.min_distance_mm == pytest.approx(apart_mm)
    assert rules.place_mm[rules.fixed][:, 0].tolist() == [120.0, 300.0]


@pytest.fixture(scope="module")
def surface() -> Surface:
    return resolve(parse_scene(PAPER.replace("10.0", "[2.0, 20.0]"), "paper.toml"))


def test_the_words_for_a_surface_have_its_size_its_contacts_and_its_noise(surface: Surface) -> None:
    noise_mm = surface.errors.noise_mm
    assert repr(surface) == (
        f"Surface(400 mm long, contacts at 1..399 mm with 2..20 N, {noise_mm:.3g} mm of noise a sample)"
    )
    assert surface.contact_width_mm == 0
    assert surface.held_mm == (0.0, 400.0)
    assert surface.slowest_period == 0
    assert surface.ringing is None
    prior = surface.prior(np.array([100.0, 300.0]))
    assert (prior.channels, prior.errors) == (2, surface.errors)


def test_a_surface_is_checked_before_its_sensors_are_placed(surface: Surface) -> None:
    resolve(paper_scene()).check(64)
    with pytest.raises(SceneError, match="sensors = 65: give at most 64 sensors"):
        surface.check(65)
    spaced = resolve(paper_scene(min_distance_mm=150.0))
    spaced.check(3)
    with pytest.raises(SceneError, match="no layout of 4 sensors keeps the rules of sensors"):
        spaced.check(4)
    with pytest.raises(SceneError, match="no layout of 4 sensors"):
        resolve(paper_scene(min_distance_mm=150.0, count=4)).check()
    # If the number is open, one that is possible will do.
    resolve(paper_scene(min_distance_mm=150.0, count=(3, 9))).check()
    silent = resolve(paper_scene(noise_percent_of_max=0.0))
    with pytest.raises(SceneError, match="with a noise of 0 there are no intervals; state the noise of a reading"):
        silent.check()


def test_neighbours_are_farther_apart_than_their_tolerance() -> None:
    surface = resolve(paper_scene(mounting_tolerance_mm=5.0))
    surface.check_spacing(np.array([[100.0], [105.1], [300.0]]))
    surface.check_spacing(np.array([[100.0, 50.0], [103.0, 54.1]]))
    with pytest.raises(SceneError, match=r"two of the sensors are 4\.57 mm apart; measure"):
        surface.check_spacing(np.array([[100.0], [104.56789], [300.0]]))
    for places_mm in ([[300.0, 0.0], [100.0, 0.0], [105.0, 0.0]], [[100.0, 50.0], [103.0, 54.0]]):
        with pytest.raises(
            SceneError, match=r"sensors.mounting_tolerance_mm = 5: two of the sensors are 5 mm apart; meas"
        ):
            surface.check_spacing(np.array(places_mm))


def test_an_influence_of_ones_own_takes_the_place_of_a_beam(surface: Surface) -> None:
    scene = surface.scene

    def at(sensor_mm: Floats, load_mm: Floats) -> Floats:
        return STRING.at(on_axis(sensor_mm), on_axis(load_mm))

    own = InfluenceFunction(400.0, np.linspace(1, 399, 399), (2.0, 20.0), at)
    with pytest.raises(SceneError, match=r"^beam: an influence function .* with change_scene\(scene, beam=None\)"):
        resolve(scene, influence=own)
    without = change_scene(scene, beam=None, sensors={"noise_percent_of_max": None, "noise_mm": 0.01})
    found = resolve(without, influence=own)
    assert found.influence is own
    assert found.travel.largest_mm == pytest.approx(20.0, rel=1e-6)  # 1 mm per newton in the middle
    assert (found.slowest_period_ms, found.ringing, found.held_mm) == (None, None, ())
