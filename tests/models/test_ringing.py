"""Ringing of the rig: the solution against theory and scipy, and the surfaces that ring."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim, lti

from beamtouch_models import modelfile
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.motion import first_frequency_hz
from beamtouch_models.rig.imperfections import Imperfections
from beamtouch_models.rig.script import Load
from beamtouch_models.rig.surface import PERFECT, Ringing, VirtualSurface, ringing_of
from beamtouch_models.scene import Scene, load_scene
from beamtouch_models.surface import Surface
from example_scenes import SCENES, paper_scene

scene, _ = load_scene(SCENES / "bench.toml")


def after_a_step(ringing: Ringing, times: Floats) -> Floats:
    """Deflections of a beam at rest at 0, with a static deflection of 1 applied from the first time on."""
    ringing.at(float(times[0]), np.zeros(1))
    return np.array([ringing.at(float(time), np.ones(1))[0] for time in times])


@pytest.mark.parametrize("frequency_hz", [1e-6, 0.3, 44.0, 99.9, 100.0, 1234.5, 1e5])
@pytest.mark.parametrize("zeta", [1e-4, 0.01, 0.5, 0.99])
def test_the_step_response_is_the_closed_form_at_any_spacing_of_conversions(frequency_hz: float, zeta: float) -> None:
    times = np.cumsum(np.random.default_rng(1).uniform(0.001, 0.009, 200))
    omega, since = 2 * math.pi * frequency_hz, times - times[0]
    damped = omega * math.sqrt(1 - zeta**2)
    # Step response of a second-order system; Ogata, Modern Control Engineering, sec. 5-3.
    swing = np.cos(damped * since) + zeta / math.sqrt(1 - zeta**2) * np.sin(damped * since)
    closed = 1 - np.exp(-zeta * omega * since) * swing
    tolerance = 1e-12 * max(1.0, omega * since[-1])  # the phase is a product of a float64 with the time
    np.testing.assert_allclose(after_a_step(Ringing(frequency_hz, zeta), times), closed, atol=tolerance)


def test_the_response_to_moving_loads_agrees_with_scipy() -> None:
    omega, zeta = 2 * math.pi * 44.0, 0.01
    times = np.arange(400) / 200.0
    static = np.where(times < 0.5, 0.0, np.sin(3 * times))
    ringing = Ringing(44.0, zeta)
    found = np.array([ringing.at(float(time), np.array([value]))[0] for time, value in zip(times, static, strict=True)])
    # Each static deflection acts from the conversion before it; scipy holds each from its own time on.
    system = lti([omega**2], [1, 2 * zeta * omega, omega**2])
    _, expected, _ = lsim(system, np.append(static[1:], 0.0), times, interp=False)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_mode_much_faster_than_the_conversions_follows_at_once_and_a_much_slower_one_hardly_moves() -> None:
    times = np.arange(100) / 200.0
    np.testing.assert_allclose(after_a_step(Ringing(1e9, 0.01), times)[1:], np.ones(99), rtol=1e-15)
    np.testing.assert_allclose(after_a_step(Ringing(1e300, 0.5), times)[1:], np.ones(99), rtol=1e-15)
    assert np.abs(after_a_step(Ringing(1e-9, 0.01), times)).max() < 1e-16


def test_two_conversions_at_the_same_time_measure_the_same() -> None:
    ringing = Ringing(44.0, 0.01)
    ringing.at(0.0, np.zeros(1))
    assert ringing.at(0.01, np.ones(1)) == ringing.at(0.01, np.ones(1))


def mean_deflection(
    model: Path, times: Floats, imperfections: Imperfections = PERFECT, *, rings: bool = True
) -> Floats:
    """Deflection over the static one, averaged over channels; the load comes right after the first conversion."""
    metadata = modelfile.load(model).metadata
    surface, sensor = VirtualSurface(scene, metadata, 1, imperfections, rings=rings), metadata.sensor
    loads = [Load(None, 0.0)] + [Load(200.0, 8.0)] * (len(times) - 1)
    counts = np.array([surface.counts(load, float(time)) for load, time in zip(loads, times, strict=True)])
    deflection = sensor.standoff_mm - (sensor.offset_mm + sensor.gain_mm_per_count * counts)
    static = VirtualSurface(scene, metadata, 1)._static_mm(Load(200.0, 8.0))  # the final deflection
    mean: Floats = deflection.mean(axis=1) / static.mean()
    return mean


@pytest.mark.parametrize(("imperfections", "damping"), [(PERFECT, 0.01), (Imperfections(damping_ratio=0.05), 0.05)])
def test_a_surface_rings_about_its_static_deflection_with_the_damping_of_its_scene_unless_told_otherwise(
    bench_model: Path, imperfections: Imperfections, damping: float
) -> None:
    """The bench states no damping, so that of a bare metal beam is assumed."""
    times = np.arange(2000) / 200.0
    frequency = first_frequency_hz(scene.beam) or 0.0
    expected = after_a_step(Ringing(frequency, damping), times)
    found = mean_deflection(bench_model, times, imperfections)
    np.testing.assert_allclose(found, expected, atol=0.03)  # six times the noise of a mean of four channels
    assert found.max() > 1.7
    np.testing.assert_allclose(found[-100:], 1.0, atol=0.03)


def test_a_surface_that_does_not_ring_follows_at_once(bench_model: Path) -> None:
    found = mean_deflection(bench_model, np.arange(50) / 200.0, rings=False)
    np.testing.assert_allclose(found[1:], 1.0, atol=0.03)


def ringing(scene: Scene, damping_ratio: float | None = None) -> Ringing | None:
    return ringing_of(Surface.of(scene), damping_ratio)


def test_a_scene_rings_unless_its_noise_makes_ringing_negligible() -> None:
    assert ringing(scene) is not None
    heavy_noise = scene.model_dump()
    heavy_noise["sensors"]["noise_percent_of_max"] = None
    heavy_noise["sensors"]["noise_mm"] = 100.0
    assert ringing(type(scene).model_validate(heavy_noise)) is None
    assert ringing(paper_scene()) is None
    with pytest.raises(SceneError, match="density_kg_m3"):
        ringing(paper_scene(), 0.01)


def test_without_noise_every_beam_rings() -> None:
    quiet = scene.model_dump()
    quiet["sensors"]["noise_percent_of_max"] = None
    quiet["sensors"]["noise_mm"] = 0.0
    assert ringing(type(scene).model_validate(quiet)) is not None


def test_ringing_below_the_steps_of_an_adc_is_left_out_also_without_other_noise() -> None:
    stiff = scene.model_dump()
    stiff["sensors"] |= {"noise_percent_of_max": None, "noise_mm": 0.0, "adc_bits": 6}
    stiff["beam"] |= {"thickness_mm": 40.0}
    assert ringing(Scene.model_validate(stiff)) is None


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_scene_can_ring(path: Path) -> None:
    other, _ = load_scene(path)
    assert ringing(other) is not None
