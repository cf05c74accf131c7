"""Beams in numbers of handbooks: their positions for sensors, small angles, sag, masses, and weights on them."""

import math
from typing import Any

import numpy as np
import pytest

from beamtouch_models import frequency_hz, make_scene
from beamtouch_models.design.physics.beam import check_small_angles, influence, load_positions_mm, sensor_positions_mm
from beamtouch_models.design.physics.influence_function import Travel
from beamtouch_models.design.physics.motion import (
    damping_of,
    first_frequency_hz,
    laden_period_s,
    point_masses,
    ringing_after_filter,
    sag_mm,
    slowest_period_ms,
)
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.tables import Sensors
from beamtouch_models.errors import SceneError
from beamtouch_models.runtime.metadata_parts import FilterChoice
from models.scene_limits import BEAM, PLATE, beam, contact, made, plate, sensors

GRAVITY = 9.80665


def places(length_mm: float = 100.0, held_mm: tuple[float, ...] = (), **keys: Any) -> list[float]:  # noqa: ANN401
    found: list[float] = sensor_positions_mm(Sensors(noise_mm=0.01, **keys), length_mm, held_mm).tolist()
    return found


def test_sensors_stand_on_the_grid_where_a_housing_has_room() -> None:
    assert places(grid_mm=10, size_mm=20) == list(range(10, 91, 10))
    assert places(grid_mm=10, size_mm=21) == list(range(20, 81, 10))
    assert places(grid_mm=10, size_mm=20, held_mm=(40.0,)) == [10, 20, 30, 50, 60, 70, 80, 90]
    assert places(grid_mm=10, size_mm=0, held_mm=(40.0,)) == [0, 10, 20, 30, 50, 60, 70, 80, 90, 100]
    assert places(grid_mm=10, size_mm=20, keep_out_mm=[[40, 50]]) == [10, 20, 30, 60, 70, 80, 90]
    assert places(grid_mm=30, size_mm=0) == [0, 30, 60, 90]
    # The third multiple of 0.1 is more than 0.3, and the end of a beam of 0.3 mm all the same.
    assert places(length_mm=0.3, grid_mm=0.1, size_mm=0) == [0, 0.1, 0.2, 0.3]


def test_fixed_sensors_stand_where_they_are_stated_and_the_grid_gives_way() -> None:
    assert places(grid_mm=50, size_mm=0, fixed_mm=[33.3, 50 + 4e-8]) == [0, 33.3, 50 + 4e-8, 100]
    assert places(grid_mm=50, size_mm=0, fixed_mm=[50 + 2e-7]) == [0, 50, 50 + 2e-7, 100]


def test_places_for_sensors_that_make_no_layout_are_refused() -> None:
    assert len(places(length_mm=100, grid_mm=0.005, size_mm=0)) == 20_001
    with pytest.raises(SceneError, match=r"grid_mm = 0\.0049 makes more than 20000 positions; make it coarser"):
        places(length_mm=100, grid_mm=0.0049, size_mm=0)
    assert places(grid_mm=45, size_mm=80, keep_out_mm=[[44, 45.0]], fixed_mm=[1, 2]) == [1, 2]
    with pytest.raises(SceneError, match="grid_mm, size_mm and keep_out_mm leave fewer than two positions; keep out"):
        places(grid_mm=45, size_mm=80)
    with pytest.raises(SceneError, match=r"sensors.fixed_mm: must be finite from 0 to 100 \(given: 101\)"):
        places(fixed_mm=[101])


def test_loads_of_a_beam_are_even_and_a_four_hundredth_of_it_apart() -> None:
    assert load_positions_mm(made(BEAM)) == pytest.approx(np.arange(20, 371))


def test_a_slope_beyond_small_angles_names_the_force_and_the_stiffness_that_keep_to_it() -> None:
    check_small_angles(Travel(1.0, 2.0, 0.1, 30.0))
    with pytest.raises(SceneError) as refused:
        check_small_angles(Travel(1.0, 2.0, 0.123, 30.0))
    # 30 N / 1.23 is 24.39 N.
    assert str(refused.value) == (
        "at 30 N the beam slopes by 0.123 rad, beyond the 0.1 rad of small-angle theory; end contact.force_n at 24 N, "
        "or make the beam 1.3 times as stiff"
    )
    with pytest.raises(SceneError) as refused:
        check_small_angles(Travel(1.0, 2.0, 0.123, 30.0), 1.5)
    assert str(refused.value) == (
        "at 30 N the beam slopes by 0.123 rad, beyond the 0.1 rad of small-angle theory, and travels 3 mm, beyond "
        "sensors.range_mm; end contact.force_n at 15 N, or make the beam 2 times as stiff"
    )
    with pytest.raises(SceneError, match=r"theory; end .* at 24 N"):
        check_small_angles(Travel(1.0, 2.0, 0.123, 30.0), 3.0)


STEEL = {"length_mm": 400.0, "material": "steel", "width_mm": 25.0, "thickness_mm": 3.0}
RIGIDITY_N_MM2 = 210e3 * 25 * 27 / 12
N_PER_MM = 7850e-9 * 75 * GRAVITY


@pytest.mark.parametrize(
    ("supports", "share"),
    [("simply-supported", 5 / 384), ("cantilever", 1 / 8), ("fixed-fixed", 1 / 384), ("propped", 0.00541613)],
)
def test_a_beam_sags_as_under_an_even_load(supports: str, share: float) -> None:
    """Gere & Goodno, app. H: shares of q l^4 / (E I); of the propped one at 0.5785 of the length from the wall."""
    sag = sag_mm(Beam.model_validate(STEEL | {"supports": supports}))
    assert sag == pytest.approx(share * N_PER_MM * 400**4 / RIGIDITY_N_MM2, rel=2e-3)


@pytest.mark.parametrize(
    ("supports", "root"),
    [("simply-supported", math.pi), ("cantilever", 1.875104), ("fixed-fixed", 4.730041), ("propped", 3.926602)],
)
def test_a_beam_swings_as_the_roots_of_its_ends_say_by_closed_form_and_by_points(supports: str, root: float) -> None:
    """Blevins, 1979, table 8-1: the square of a root over 2 pi l^2, times the root of E I / m."""
    hz = root**2 / (2 * math.pi * 0.4**2) * math.sqrt(RIGIDITY_N_MM2 * 1e-6 / (7850 * 75e-6))
    assert first_frequency_hz(Beam.model_validate(STEEL | {"supports": supports})) == pytest.approx(hz, rel=1e-6)
    # In two segments that are the same, and on a foundation that hardly carries, the beam has no closed form.
    softly = Beam.model_validate(STEEL | {"supports": supports, "foundation_n_mm2": 1e-9})
    assert first_frequency_hz(softly) == pytest.approx(hz, rel=3e-4)


def test_a_beam_of_two_sections_weighs_what_they_do() -> None:
    segments = [{"to_mm": 100}, {"to_mm": 400, "thickness_mm": 6}]
    points = point_masses(Beam.model_validate(STEEL | {"segments": segments}))
    assert points is not None
    place, mass = points
    assert mass.sum() == pytest.approx(7850e-9 * 25 * (3 * 100 + 6 * 300))
    assert mass[place < 100].sum() == pytest.approx(7850e-9 * 25 * 3 * 100)
    assert np.diff(place) == pytest.approx(np.ones(399))
    assert place[0] == pytest.approx(0.5)


def test_a_plate_weighs_what_it_does_in_cells_that_are_about_square() -> None:
    points = point_masses(made(PLATE, plate(length_y_mm=250), contact(y_mm=[20, 240])).solid)
    assert points is not None
    place, mass = points
    assert mass.sum() == pytest.approx(7850e-9 * 400 * 250 * 3)
    assert np.ptp(mass) == 0
    assert [len(np.unique(along)) for along in place.T] == [25, 16]
    assert place.min(axis=0) == pytest.approx([8, 250 / 32])
    assert place.max(axis=0) == pytest.approx([392, 250 - 250 / 32])
    narrow = point_masses(made(PLATE, plate(length_y_mm=20), contact(y_mm=[2, 18]), sensors(size_mm=4)).solid)
    assert narrow is not None
    assert [len(np.unique(along)) for along in narrow[0].T] == [89, 6]


def test_without_its_mass_a_structure_has_no_frequency_and_says_what_to_state() -> None:
    for scene, said in (
        (made(BEAM), "beam: state density_kg_m3, width_mm and thickness_mm; they set its frequency"),
        (
            made(PLATE, plate(material=None, youngs_modulus_gpa=70)),
            "plate: state density_kg_m3; it sets its frequency",
        ),
    ):
        assert first_frequency_hz(scene.solid) is None
        assert (laden_period_s(scene), slowest_period_ms(scene), sag_mm(scene.solid)) == (None, None, None)
        with pytest.raises(SceneError) as refused:
            frequency_hz(scene)
        assert str(refused.value) == said
    with pytest.raises(SceneError, match="beam: its mass cannot be computed; check density, width and thickness"):
        first_frequency_hz(Beam.model_validate(STEEL | {"density_kg_m3": 1e-305}))
    stiff = {"width_mm": 1e-3, "thickness_mm": 1e-3, "segments": [{"to_mm": 400, "flexural_rigidity_n_mm2": 1e300}]}
    assert first_frequency_hz(Beam.model_validate(STEEL | stiff)) is None


def test_a_weight_makes_a_beam_slower_as_dunkerley_says() -> None:
    """A weight of 20 N in the middle: the squares of the periods of the beam and of the weight on a spring add up."""
    scene = made(BEAM, beam(supports="simply-supported", density_kg_m3=7850))
    hz = math.pi / (2 * 0.4**2) * math.sqrt(RIGIDITY_N_MM2 * 1e-6 / (7850 * 75e-6))
    spring_n_per_m = 48 * RIGIDITY_N_MM2 / 400**3 * 1e3
    period_s = math.hypot(1 / hz, 2 * math.pi * math.sqrt(20 / GRAVITY / spring_n_per_m))
    assert laden_period_s(scene) == pytest.approx(period_s, rel=1e-4)
    fast = made(BEAM, beam(supports="simply-supported", density_kg_m3=7850), sensors(rate_hz=1e4))
    assert slowest_period_ms(fast) == pytest.approx(1e3 * period_s, rel=1e-4)


def test_a_damping_is_as_stated_or_a_hundredth() -> None:
    assert damping_of(made(BEAM).solid) == 0.01
    assert damping_of(made(BEAM, beam(damping_ratio=0.03)).solid) == 0.03


def test_what_rings_after_a_filter_is_what_its_mean_leaves_of_a_sine_that_decays() -> None:
    for hz, window in ((44.0, 4), (93.0, 7), (260.0, 3)):
        chosen = FilterChoice(kind="moving-average", window=window, settling_ms=35.0)
        readings = np.exp(2j * math.pi * hz / 500 * np.arange(window))
        wanted = abs(readings.mean()) * math.exp(-0.02 * 2 * math.pi * hz * 0.035)
        assert ringing_after_filter(hz, 0.02, chosen, 500.0) == pytest.approx(wanted)
    # At the rate of the readings all of them are alike.
    assert ringing_after_filter(500.0, 0.02, chosen, 500.0) == pytest.approx(
        math.exp(-0.02 * 2 * math.pi * 500 * 0.035)
    )


def test_influence_scales_with_the_cube_of_the_length_and_the_rigidity() -> None:
    """On springs at the ends, with steps and over a width, as a beam of another size in the same shape."""
    steps = [0.4, 1.0]

    def moved(size: float, rigidity: float) -> float:
        shape = Beam.model_validate(
            {
                "length_mm": 300 * size,
                "supports": [{"at_mm": 0, "fixity": 0.3}, {"at_mm": 250 * size}],
                "segments": [
                    {"to_mm": 300 * size * to, "flexural_rigidity_n_mm2": rigidity * (1 + to)} for to in steps
                ],
                "foundation_n_mm2": 0.02 * rigidity / size**4 / 1e7,
            }
        )
        found = influence(shape, [110 * size, 290 * size], [170 * size], 33 * size)
        assert found.shape == (1, 2)
        return float(found[0, 0])

    assert moved(7.3, 3.1e7) == pytest.approx(7.3**3 / 3.1 * moved(1.0, 1e7), rel=1e-9)


def test_scenes_of_one_axis_and_of_two_have_their_own_places() -> None:
    scene = make_scene(**BEAM)
    assert influence(scene.beam, [400.0], [400.0])[0, 0] == pytest.approx(400**3 / (3 * RIGIDITY_N_MM2))
