"""Modes of beams, ringing and motion, against closed forms."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.physics.motion import (
    MODES,
    Modes,
    beyond_rest,
    first_frequency_hz,
    slowest_period_ms,
    swings,
)
from beamtouch_models.design.scene import load_scene
from beamtouch_models.design.scene.beam import Beam
from support.surfaces.example_scenes import SCENES

BENCH = load_scene(SCENES / "bench.toml")[0].beam
SENSORS = np.array([68.0, 156.0, 244.0, 332.0])
LOADS = np.array([40.0, 130.0, 371.0])


def modes_of(beam: Beam, width_mm: float = 0.0) -> Modes:
    found = Modes.of(beam, width_mm)
    assert found is not None
    return found


@pytest.mark.parametrize("name", ["foundation", "stepped", "two-spans", "wide-contact"])
def test_the_modes_of_any_beam_add_up_to_its_deflection_at_rest(name: str) -> None:
    scene = load_scene(SCENES / f"{name}.toml")[0]
    width_mm, length = scene.contact.width_mm, scene.beam.length_mm
    sensors, loads = np.array([0.3, 0.62, 0.9]) * length, np.array([0.22, 0.45, 0.8]) * length
    modes = modes_of(scene.beam, width_mm)
    found = swings(modes.at(sensors), modes.under(loads), modes.square_s2, np.full(3, 7.0), np.full(3, 0.3))
    exact = 7.0 * influence(scene.beam, sensors, loads, width_mm)
    np.testing.assert_allclose(found.share_mm.sum(axis=2), exact, atol=3e-4 * np.abs(exact).max())


def test_a_weight_much_heavier_than_the_beam_swings_on_it_as_on_a_spring() -> None:
    modes, weight = modes_of(BENCH), np.array([1000.0])
    found = swings(modes.at(SENSORS), modes.under(LOADS[:1]), modes.square_s2, np.ones(1), weight)
    spring_n_per_m = 1e3 / influence(BENCH, LOADS[:1], LOADS[:1])[0, 0]
    assert found.omega.min() == pytest.approx(math.sqrt(spring_n_per_m / 1000.0), rel=2e-3)


def series_mm(seconds: float, load_mm: float, zeta: float) -> np.ndarray:
    """Deflection after a sudden force of 1 N: the sines of a simply supported beam, each an oscillator."""
    first = first_frequency_hz(BENCH)
    assert first is not None
    length, total = BENCH.length_mm, np.zeros(len(SENSORS))
    for k in range(1, MODES + 1):
        omega = 2 * math.pi * first * k * k
        damped = omega * math.sqrt(1 - zeta**2)
        still = 2 * length**3 / (math.pi**4 * k**4 * BENCH.rigidity_n_mm2)
        still *= math.sin(k * math.pi * load_mm / length)
        moved = 1 - math.exp(-zeta * omega * seconds) * (
            math.cos(damped * seconds) + zeta * omega / damped * math.sin(damped * seconds)
        )
        total += still * moved * np.sin(k * math.pi * SENSORS / length)
    return total


@pytest.mark.parametrize("zeta", [0.01, 0.3])
def test_a_sudden_force_rings_as_the_series_of_the_textbook(zeta: float) -> None:
    modes = modes_of(BENCH)
    assert modes.square_s2.shape == (24,)
    found = swings(modes.at(SENSORS), modes.under(LOADS), modes.square_s2, np.ones(3), np.zeros(3))
    seconds = np.array([-0.01, 0.0, 0.0021, 0.0113, 0.05])
    moved = influence(BENCH, SENSORS, LOADS)[:, None] * (seconds >= 0)[:, None]
    moved = moved + found.ringing_mm(np.tile(seconds, (3, 1)), zeta)
    assert not moved[:, 0].any()
    for row, load_mm in zip(moved, LOADS, strict=True):
        exact = [series_mm(at, load_mm, zeta) for at in seconds[1:]]
        np.testing.assert_allclose(row[1:], exact, atol=3e-3 * np.abs(exact).max())


def test_a_force_that_grows_rings_as_the_mean_of_sudden_ones() -> None:
    modes = modes_of(BENCH)
    found = swings(modes.at(SENSORS), modes.under(LOADS[:1]), modes.square_s2, np.ones(1), np.zeros(1))
    for since in (0.01, 0.03, 0.041):
        grown = found.ringing_mm(np.array([[since]]), 0.01, 0.03)[0, 0]

        def sudden(at: float) -> float:
            return float(found.ringing_mm(np.array([[at]]), 0.01)[0, 0, 1])

        mean = quad(sudden, max(since - 0.03, 0.0), since, limit=400)[0] / 0.03
        assert grown[1] == pytest.approx(mean, rel=1e-4)
    assert not found.ringing_mm(np.array([[-0.01]]), 0.01, 0.03).any()


def test_a_mode_under_a_force_that_crosses_the_beam_moves_as_fryba_found() -> None:
    """Fryba, Vibration of Solids and Structures under Moving Loads, 1999, ch. 1: without damping, from rest."""
    omega, pace, step_s = np.array([276.0, 1105.0]), np.array([31.0, 62.0]), 1e-4
    seconds = np.arange(2000) * step_s
    target = np.sin(pace * seconds[:, None])[None]
    exact = (
        omega**2
        / (omega**2 - pace**2)
        * (np.sin(pace * seconds[:, None]) - pace / omega * np.sin(omega * seconds[:, None]))
    )
    found = target + beyond_rest(target, step_s, omega, 1e-9)
    np.testing.assert_allclose(found[0], exact, atol=1e-4)


def test_the_slowest_period_is_that_of_the_beam_with_the_heaviest_load_on_it() -> None:
    # The lowest root of 1 = m w^2 sum phi_k^2 / (w_k^2 - w^2), of a mass m = 20 N / g in the middle of the bench beam,
    # which weighs 0.2355 kg and has modes w_k = k^2 2 pi 43.9754 / s with phi_k^2 = 2 sin^2(k pi / 2) / 0.2355 kg.
    order = np.arange(1, 400, 2)
    squares, phi = (2 * math.pi * 43.9754 * order**2) ** 2, 2 / 0.2355

    def left(square: float) -> float:
        return float(1 - 20 / 9.80665 * square * np.sum(phi / (squares - square)))

    exact_ms = 1e3 * 2 * math.pi / math.sqrt(brentq(left, 1.0, 0.99 * squares[0]))
    scene, _ = load_scene(SCENES / "bench.toml")
    assert exact_ms <= (slowest_period_ms(scene) or 0.0) <= 1.03 * exact_ms


@pytest.mark.parametrize(
    ("name", "period_ms"),
    [
        # The second mode of the conveyor's rail swings at 96 Hz, 4 Hz from the 100 readings per second. It would seem
        # to need 0.25 s for a period, but at 1 % of damping it rings for 1 / (0.01 x 2 pi x 96) = 0.166 s.
        ("conveyor", 166),
        # The paper's beam swings at 43.975 Hz. At 100 readings per second these alternate between two sides, and their
        # amplitude has a period of 1 / (50 - 43.975) s, so that two readings in a row may agree while the beam rings.
        ("paper", 1e3 / (50 - 43.9749)),
    ],
)
def test_a_mode_near_the_rate_of_the_readings_or_half_of_it_seems_slow(name: str, period_ms: float) -> None:
    assert slowest_period_ms(load_scene(SCENES / f"{name}.toml")[0]) == pytest.approx(period_ms, rel=0.01)
