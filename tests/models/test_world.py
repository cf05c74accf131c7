"""The world of a simulated surface, as the rig and `challenge` play it: sensors, ADC, departures and motion."""

import math
from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.physics.motion import first_frequency_hz
from beamtouch_models.design.scene import change_scene, load_scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.world import Motion, World, counts_of_output, output_of_gap
from beamtouch_models.errors import SceneError
from beamtouch_models.lab.challenge import contacts
from beamtouch_models.lab.challenge.challenge import distances
from beamtouch_models.lab.challenge.play import DrawnContacts, SimulatedSurface
from beamtouch_models.lab.rig.loads import NOTHING, Load
from beamtouch_models.lab.rig.surface import PERFECT, Imperfections, VirtualSurface
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.departures import Calibration, Departures
from beamtouch_models.runtime.metadata_parts import Sensor
from models.scene_limits import BEAM, made
from support.surfaces.example_scenes import SCENES, paper_scene

SCENE, _ = load_scene(SCENES / "bench.toml")
READINGS = 1000
"""Enough for the mean of a channel to 3 % of its noise, and for the noise to 2 %."""
LOAD = Load(150.0, 12.0)


def sensor_of(bits: int) -> Sensor:
    """Linear from 1 to 4 mm over the middle 80 % of the scale, worked out by hand."""
    gain = 3 / (0.8 * (2**bits - 1))
    return Sensor(
        rate_hz=100, range_mm=(1, 4), standoff_mm=3.5, adc_bits=bits, gain_mm_per_count=gain, offset_mm=1 - 0.375
    )


@pytest.mark.parametrize("bits", [8, 16])
def test_the_characteristic_is_linear_from_1_to_4_mm_and_levels_off_beyond(bits: int) -> None:
    sensor, full_scale = sensor_of(bits), 2**bits - 1

    def counts(gap_mm: Floats) -> Floats:
        return counts_of_output(sensor, output_of_gap(sensor, gap_mm)).astype(np.float64)

    gap = np.linspace(1, 4, 1001)
    assert np.abs(counts(gap) - (0.1 + 0.8 * (gap - 1) / 3) * full_scale).max() <= 0.5 + 1e-6
    assert counts(np.array([-1e6, 1e6])).tolist() == [0, full_scale]
    beyond = counts(np.array([0.8, 4.2])) / full_scale
    assert 0 < beyond[0] < 0.1
    assert 0.9 < beyond[1] < 1


def test_readings_have_the_errors_that_are_asked_for(surface: SimulatedSurface) -> None:
    draws, random, world = 200, np.random.default_rng(5), surface.world
    drawn = DrawnContacts.of(surface, draws, random)
    clean = np.repeat(drawn.deflection_mm[:, None], 60, axis=1)
    exact, stated_mm = drawn.perfect, surface.metadata.noise.reading_mm
    readings, sensor = world.readings(clean, exact, random), world.sensor
    counts = (sensor.standoff_mm - readings - sensor.offset_mm) / sensor.gain_mm_per_count
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
    noise = readings - clean
    assert noise.std() == pytest.approx(stated_mm, rel=0.015)
    assert abs(np.mean(noise[:, 1:] * noise[:, :-1])) < 0.02 * stated_mm**2
    gone = np.zeros((draws, 4), np.bool_)
    gone[:, 2] = True
    assert (np.isnan(world.readings(clean, replace(exact, missing=gone), random)).all(axis=1) == gone).all()
    beyond = np.isnan(world.readings(3 * clean, exact, random))
    assert (beyond == (sensor.standoff_mm - 3 * clean < 1.0)).mean() > 0.99
    apart = (world.measured(clean, surface.honest(draws, random)) - clean)[:, 0].std(axis=0)
    expected = np.sqrt(((0.003 * clean[:, 0]) ** 2 + 0.001**2).mean(axis=0))
    np.testing.assert_allclose(apart, expected, rtol=0.2)


def test_departures_undo_what_they_do() -> None:
    stated = {"gain": [0.95, 1.0, 1.04], "offset_mm": [0.02, -0.03, 0.0], "curve_per_mm": 0.03}
    departures = Departures.none(3).model_copy(update=stated)
    linear = np.random.default_rng(3).uniform(-1.0, 3.0, (50, 3))
    measured = departures.measure(linear)
    # As its line says: y + curve y^2 is the deflection with its gain, and y is measured without the offset.
    y = measured - np.array([0.02, -0.03, 0.0])
    assert y + 0.03 * y**2 == pytest.approx(linear, abs=1e-12)
    assert departures.linear_mm(measured) == pytest.approx(linear, abs=1e-12)


OFF = Imperfections(
    position_offset_mm=(1.0, -1.0, 0.5, 0.0),
    gain=(1.03, 0.97, 1.0, 1.01),
    offset_mm=(0.01, 0.0, -0.02, 0.0),
    curve_per_mm=0.02,
    fixity=(0.05, 0.0),
    rigidity=1.1,
)


@pytest.mark.parametrize("imperfections", [PERFECT, OFF], ids=["as the scene", "with departures"])
def test_the_rig_sends_counts_of_the_gaps_and_the_noise_of_its_scene(
    bench: ModelFile, imperfections: Imperfections
) -> None:
    surface, sensor = VirtualSurface(SCENE, bench.metadata, 1, imperfections), bench.metadata.sensor
    counts = np.array([surface.counts(LOAD, 0.0) for _ in range(READINGS)])
    if imperfections is PERFECT:
        seen = gap = sensor.standoff_mm - 12 * influence(SCENE.beam, bench.metadata.layout_mm, [150.0])[0]
    else:  # by hand, from the keys above
        ends = [{"at_mm": 0.0, "fixity": 0.05}, {"at_mm": 400.0}]
        beam = Beam.model_validate({**SCENE.beam.model_dump(), "youngs_modulus_gpa": 231.0, "supports": ends})
        linear = 12 * influence(beam, bench.metadata.layout_mm + np.array([1, -1, 0.5, 0]), [150.0])[0]
        linear = np.array([1.03, 0.97, 1.0, 1.01]) * linear
        seen = sensor.standoff_mm - (np.sqrt(1 + 4 * 0.02 * linear) - 1) / (2 * 0.02)
        gap = seen + np.array([0.01, 0, -0.02, 0])
    noise = 0.002 * bench.metadata.max_deflection_mm
    measured = sensor.offset_mm + sensor.gain_mm_per_count * counts
    assert measured.mean(axis=0) == pytest.approx(gap, abs=5 * noise / np.sqrt(READINGS))
    assert measured.std(axis=0) == pytest.approx(np.full(4, noise), rel=0.1)
    assert VirtualSurface(SCENE, bench.metadata, 1, imperfections).counts(LOAD, 0.0) == counts[0].tolist()


def test_a_calibrated_surface_measures_what_its_model_expects(bench: ModelFile) -> None:
    departures = Departures(
        position_offset_mm=[1.0, -2.0, 0.5, 0.0], gain=[1.02, 0.97, 1.0, 1.01], offset_mm=[0.1, 0.0, -0.05, 0.02],
        curve_per_mm=0.02, rigidity=1.1,
    )  # fmt: skip
    calibration = Calibration(
        departures=departures, fitted=["gain"], loads=9, residual_mm=0.0, error_before_mm=9.0, error_after_mm=1.0
    )
    metadata = bench.metadata.model_copy(update={"calibration": calibration})
    calibrated, prior = SimulatedSurface.of(metadata), prior_of_model(metadata)
    np.testing.assert_allclose(calibrated.world.sensor_mm - metadata.layout_mm, [1.0, -2.0, 0.5, 0.0])
    drawn = DrawnContacts.of(calibrated, 20, np.random.default_rng(10))
    clean = drawn.deflection_mm
    measured = calibrated.world.measured(clean[:, None], drawn.perfect)[:, 0]
    linear = drawn.force_n[:, None] * prior.influence_at(drawn.place_mm)
    np.testing.assert_allclose(measured, prior.measured(linear), rtol=1e-5)
    every = np.ones(measured.shape, np.bool_)
    assert distances(calibrated, measured, every).max() < 0.05
    assert distances(calibrated, clean, every).min() > 1


def test_a_structure_whose_mass_is_not_stated_neither_rings_nor_has_inertia() -> None:
    world = World.of(made(BEAM), sensor_of(12), np.array([100.0, 210.0, 300.0]), 1e-3)
    with pytest.raises(ValueError, match="a beam without a mass does not ring"):
        world.ringing_mm(np.array([150.0]), np.array([7.0]), np.array([[0.1, 0.2]]))
    assert (world.inertia_mm(np.array([[150.0, 151.0]]), np.array([7.0]), 1e-3) == np.zeros((1, 2, 3))).all()


@pytest.mark.parametrize("name", ["bench", "cantilever", "two-spans"])
def test_the_rig_rings_in_all_modes_as_challenge_does(name: str) -> None:
    scene, _ = load_scene(SCENES / f"{name}.toml")
    length_mm = scene.beam.length_mm
    world = World.of(scene, sensor_of(12), np.array([0.3, 0.62, 0.9]) * length_mm, 1e-3)
    place_mm, times = 0.41 * length_mm, np.cumsum(np.random.default_rng(1).uniform(0.001, 0.009, 200))
    motion = Motion(world)
    motion.at(times[0], place_mm, 0.0)
    found = np.array([motion.at(seconds, place_mm, 7.0) for seconds in times[1:]])
    # The load acts since the first instant.
    place, force = np.array([place_mm]), np.array([7.0])
    expected = world.under(place, force) + world.ringing_mm(place, force, times[None, 1:] - times[0])[0]
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    assert (motion.at(times[-1], place_mm, 7.0) == found[-1]).all()  # two conversions at the same time


@pytest.mark.promise(
    "docs/reference/rig.md",
    "with the damping that the scene states in `damping_ratio` (1 % of critical if it states none)",
)
@pytest.mark.parametrize(
    ("imperfections", "rings", "zeta"),
    [(PERFECT, True, 0.01), (Imperfections(damping_ratio=0.05), True, 0.05), (PERFECT, False, 1.0)],
)
def test_a_rig_swings_with_the_damping_of_its_scene_unless_told_otherwise(
    bench: ModelFile, imperfections: Imperfections, rings: bool, zeta: float
) -> None:
    """The bench states no damping, so that of a bare metal beam is assumed; its other modes hold 1 % of the motion."""
    metadata, period_s = bench.metadata, 1 / (first_frequency_hz(SCENE.beam) or 0.0)
    surface, sensor = VirtualSurface(SCENE, metadata, 1, imperfections, rings=rings), metadata.sensor
    # Right after the first conversion the load comes; then, each crest and each trough of the first mode.
    counts = np.array([surface.counts(LOAD if at else NOTHING, at * period_s / 2) for at in range(20)])
    mean_mm = (sensor.standoff_mm - sensor.offset_mm - sensor.gain_mm_per_count * counts).mean(axis=1)
    still_mm = float(12 * influence(SCENE.beam, metadata.layout_mm, [150.0]).mean())
    half = np.arange(1, 20)
    swing = -((-1.0) ** half) * np.exp(-zeta * math.pi * half) if rings else 0.0 * half
    np.testing.assert_allclose(mean_mm[1:] / still_mm, 1 + swing, atol=0.06)


def test_zeros_drift_from_the_start_on_in_the_direction_of_the_load(bench: ModelFile) -> None:
    """With the same seed the noise is the same, so that the difference is the drift, to a count."""
    sensor, drifting = bench.metadata.sensor, Imperfections(drift_um_per_min=(60.0, -30.0, 0.0, 300.0))
    for seconds in (0.0, 20.0):
        steady, moved = (
            VirtualSurface(SCENE, bench.metadata, 1, imperfections, rings=False).counts(NOTHING, seconds)
            for imperfections in (PERFECT, drifting)
        )
        closed_um = 1e3 * sensor.gain_mm_per_count * (np.array(steady) - moved)
        expected_um = np.array([60.0, -30.0, 0.0, 300.0]) * seconds / 60
        assert closed_um == pytest.approx(expected_um, abs=1e3 * sensor.gain_mm_per_count)


def test_a_rig_that_cannot_be_as_stated_is_refused(bench: ModelFile) -> None:
    VirtualSurface(paper_scene(), bench.metadata, 1)  # of no stated mass: it follows each load at once
    with pytest.raises(SceneError, match="density_kg_m3"):
        VirtualSurface(paper_scene(), bench.metadata, 1, Imperfections(damping_ratio=0.01))
    propped = change_scene(SCENE, beam={"supports": "propped"})
    with pytest.raises(SceneError, match="already fixed"):
        VirtualSurface(propped, bench.metadata, 1, Imperfections(fixity=(0.1, 0.0)))


def test_a_slow_load_is_where_it_is_at_rest_and_a_fast_one_swings_around_it(surface: SimulatedSurface) -> None:
    def away_mm(speed_mm_per_s: float) -> float:
        play = contacts.moves(DrawnContacts.of(surface, 20, np.random.default_rng(6)), speed_mm_per_s=speed_mm_per_s)
        # The force is the same at all times, so the deflection of the first reading tells it.
        shape = surface.world.influence(play.truth_mm[..., 0])
        force = np.linalg.norm(play.deflection_mm[:, :1], axis=2) / np.linalg.norm(shape[:, :1], axis=2)
        return float(np.abs(play.deflection_mm - shape * force[:, :, None]).max())

    assert away_mm(10.0) < 0.002
    assert 0.01 < away_mm(1000.0) < 0.1
