"""Sensors that stand beside their positions: intervals on truly displaced ones, and the limit by plain integration."""

import numpy as np
import pytest

from beamtouch_models.design.accuracy.limit import accuracy_limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.layout import place_sensors
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.placement.placing import Aim
from beamtouch_models.design.scene import change_scene, load_scene, parse_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.errors import SceneError
from beamtouch_models.places import on_axis
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.error_model import Errors
from models.handbook import deflection_per_newton
from models.posterior_cases import answers_of, graph_of
from support.surfaces.example_scenes import SCENES, paper_scene
from support.surfaces.stated_problems import real_prior

SURFACES, CONTACTS = 80, 50
TOLERANCE_MM = 1.0


@pytest.mark.parametrize("name", ["bench", "cantilever", "stepped"])
def test_intervals_hold_the_truth_on_displaced_sensors(name: str) -> None:
    stated, _ = load_scene(SCENES / f"{name}.toml")
    scene = change_scene(stated, sensors={"mounting_tolerance_mm": TOLERANCE_MM})
    sensors = place_sensors(resolve(scene), aim=Aim("eigenvalue-product"))
    prior, influence, noise_mm = sensors.prior, sensors.surface.influence, sensors.surface.errors.noise_mm
    (gain_error, *_), (zero_error_mm, *_) = sensors.surface.errors.of_channels(1)
    assert sensors.surface.errors.mounting_mm == TOLERANCE_MM
    rng = np.random.default_rng(5)
    position, reading = [], []
    for _ in range(SURFACES):
        # As a surface is mounted: its sensors stay where they are, and so do gains and zeros.
        offset, gain, zero = (rng.normal(size=prior.channels) for _ in range(3))
        at_mm = np.clip(np.array(sensors.placement.positions_mm) + TOLERANCE_MM * offset, 0.0, prior.diagonal_mm)
        load = rng.uniform(*prior.extent.range_mm, size=CONTACTS)
        deflection = rng.uniform(*prior.force_n, size=CONTACTS)[:, None] * influence.at(on_axis(at_mm), on_axis(load))
        noise = noise_mm * rng.normal(size=deflection.shape)
        position.append(load)
        reading.append((1 + gain_error * gain) * deflection + zero_error_mm * zero + noise)
    truth = np.concatenate(position)
    answers = answers_of(graph_of(prior), prior, np.concatenate(reading))
    held = (answers["position_low_mm"] <= truth) & (truth <= answers["position_high_mm"])
    print(f"{name}: {held.mean():.4f} held, {sensors.placement.positions_mm}")
    assert held.mean() >= 0.93


@pytest.mark.long
@pytest.mark.parametrize(("gain", "tolerance_mm"), [pytest.param(0.0, 8.0, marks=pytest.mark.soak), (0.05, 5.0)])
def test_the_limit_with_gains_and_mounting_is_that_of_a_plain_bayes_integral(gain: float, tolerance_mm: float) -> None:
    """Gains and places of the sensors are integrated out by Gauss-Hermite quadrature, with the true beam."""
    # On one half of the beam, where a known force has one place.
    sensor_mm, noise_mm, force_n, draws = np.array([80.0, 160.0]), 0.0113, 10.0, 800
    rng, grid = np.random.default_rng(2), np.linspace(20, 190, 341)
    node, weight = np.polynomial.hermite_e.hermegauss(11)
    weight = np.outer(weight, weight).ravel() / weight.sum() ** 2
    beside, off = (values.ravel() for values in np.meshgrid(tolerance_mm * node, gain * node))
    truth = rng.uniform(20, 190, draws)
    log_posterior = np.zeros((draws, len(grid)))
    for at_mm in sensor_mm:
        true_mm = at_mm + tolerance_mm * rng.normal(size=draws)
        clean = (1 + gain * rng.normal(size=draws)) * force_n * deflection_per_newton(true_mm, truth)
        reading = clean + noise_mm * rng.normal(size=draws)
        means = (1 + off) * force_n * deflection_per_newton(at_mm + beside, grid[:, None])
        for row, value in enumerate(reading):
            likelihood = np.exp(-(((value - means) / noise_mm) ** 2) / 2) @ weight
            log_posterior[row] += np.log(np.maximum(likelihood, 1e-300))
    posterior = np.exp(log_posterior - log_posterior.max(axis=1, keepdims=True))
    posterior /= posterior.sum(axis=1, keepdims=True)
    median = grid[(np.cumsum(posterior, axis=1) >= 0.5).argmax(axis=1)]
    error = (posterior * np.abs(grid - median[:, None])).sum(axis=1) / 4
    influence = influence_of(change_scene(paper_scene(), contact={"position_mm": (20, 190)}))
    found, ideal = (
        accuracy_limit(Prior.of(influence, on_axis(sensor_mm), some), 4_000, 3).value
        for some in (Errors(noise_mm, gain, 0.0, tolerance_mm), Errors(noise_mm))
    )
    standard_error = error.std() / np.sqrt(draws)
    print(f"{error.mean():.4f} +- {standard_error:.4f}, limit {found:.4f}, without errors {ideal:.4f}")
    assert found == pytest.approx(error.mean(), abs=4 * standard_error)
    assert ideal < error.mean() - 8 * standard_error


def test_neighbours_stand_farther_apart_than_their_tolerance() -> None:
    stated, _ = load_scene(SCENES / "cantilever.toml")
    scene = change_scene(stated, sensors={"mounting_tolerance_mm": 2.0, "size_mm": 0.0})
    positions = place_sensors(resolve(scene)).placement.positions_mm
    assert min(np.diff(positions)) > 2
    with pytest.raises(SceneError, match="mounting_tolerance_mm"):
        place_sensors(resolve(change_scene(scene, sensors={"fixed_mm": [100.0, 101.0]})))


def test_the_prior_of_a_model_knows_the_mounting_of_its_sensors(bench: ModelFile) -> None:
    """So `evaluate` and `build` state the same error."""
    text = bench.metadata.scene.replace("count = 4", "count = 4\nmounting_tolerance_mm = 2")
    stated = parse_scene(text, "scene.toml")
    prior = prior_of_model(bench.metadata.model_copy(update={"scene": text}))
    layout = np.array([channel.position_mm for channel in bench.metadata.layout])
    expected = real_prior(stated, layout, bench.metadata.noise.sample_mm)
    at, force = np.array([[50.0], [200.0], [390.0]]), np.array([5.0, 20.0, 2.0])
    assert prior.sampled(at, force)[1] == pytest.approx(expected.sampled(at, force)[1], rel=1e-12)
    exact = prior_of_model(bench.metadata)
    assert np.all(prior.sampled(at, force)[1] > exact.sampled(at, force)[1])
    assert not prior.at_noise(0.0).sampled(at, force)[1].any()
