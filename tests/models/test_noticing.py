"""The shares of loads other than one contact that a layout notices, against plain sums, fits and simulations."""

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.limit import accuracy_limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.placement.placing import place, place_by_position_error
from beamtouch_models.design.placement.position_error import FORCES, PLACES, SLACK, OtherLoads, Sampling, other_loads
from beamtouch_models.design.scene import Scene, change_scene
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors
from models.handbook import deflection_per_newton
from support.surfaces.example_scenes import paper_scene
from support.surfaces.stated_problems import problem_in

pytestmark = pytest.mark.long

LOW_MM, HIGH_MM, FORCE_N = 20.0, 390.0, (2.0, 20.0)
NOISE_MM, GAIN, ZERO_MM = 0.0015, 0.003, 0.001
ERRORS = Errors(NOISE_MM, GAIN, ZERO_MM)
LAYOUTS = [[68.0, 156.0, 244.0, 332.0], [90.0, 200.0, 310.0]]


def scene_of(**sensors: object) -> Scene:
    return change_scene(paper_scene(**sensors), contact={"position_mm": (LOW_MM, HIGH_MM), "force_n": FORCE_N})


def loads_of(errors: Errors) -> tuple[OtherLoads, Floats]:
    influence, rules = problem_in(scene_of())
    return other_loads(influence, rules, Sampling(errors)), rules.place_mm[:, 0]


def plain_loads(sensor_mm: Floats) -> Floats:
    """Deflections (loads, sensors) under all loads, by the closed form of the beam: pairs and spread, by force."""
    half = (HIGH_MM - LOW_MM) / 2
    found = []
    for force in np.linspace(*FORCE_N, 2 * FORCES + 1)[1::2]:
        for parts in (np.array([0.0, half]), np.linspace(0, half, 401)[:-1] + half / 800):
            for first in LOW_MM + half * (np.arange(PLACES) + 0.5) / PLACES:
                each = deflection_per_newton(sensor_mm, (first + parts)[:, None])
                found.append(force * each.mean(axis=0))
    return np.array(found)


def best_fit(whitened: Floats, shapes: Floats) -> Floats:
    """Squares that the best contact leaves of whitened samples; `shapes` (contacts, sensors) likewise whitened."""
    along = np.maximum(whitened @ shapes.T, 0.0)
    left: Floats = (whitened**2).sum(axis=1) - (along**2 / (shapes**2).sum(axis=1)).max(axis=1)
    return left


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_share_is_that_of_simulated_samples_with_a_fit_each(layout: list[float]) -> None:
    others, candidates = loads_of(ERRORS)
    sensor_mm, rng = np.array(layout), np.random.default_rng(3)
    shapes = deflection_per_newton(sensor_mm, np.linspace(LOW_MM, HIGH_MM, 801)[:, None])
    threshold = others.threshold(len(layout))
    shares = []
    for z in plain_loads(sensor_mm):
        s = np.sqrt(NOISE_MM**2 + ZERO_MM**2 + (GAIN * z) ** 2)
        samples = z / s + rng.normal(size=(200, len(layout)))
        shares.append((best_fit(samples, shapes / s) > threshold).mean())
    found = others.noticed(np.searchsorted(candidates, sensor_mm))
    pairs, spread = np.reshape(shares, (FORCES, 2, PLACES)).mean(axis=(0, 2))
    print(f"{layout}: {found}, simulated {pairs:.4f} and {spread:.4f}")
    assert found == pytest.approx([pairs, spread], abs=0.015)
    assert pairs > 0.05


def test_one_or_two_sensors_notice_nothing_however_precise_they_are() -> None:
    # The loads between two places look like a contact between them.
    others, candidates = loads_of(Errors(1e-6))
    for layout in ([122.0, 278.0], [150.0, 160.0], [200.0]):
        assert others.noticed(np.searchsorted(candidates, layout)) == pytest.approx([0.0, 0.0], abs=1e-4)


def test_the_mounting_counts_as_displaced_sensors_scatter() -> None:
    influence, rules = problem_in(scene_of())
    sensor_mm, errors, rng = np.array(LAYOUTS[0]), Errors(0.001, mounting_mm=1.0), np.random.default_rng(1)
    layout = np.searchsorted(rules.place_mm[:, 0], sensor_mm)
    moved = [plain_loads(sensor_mm + rng.normal(size=4)) for _ in range(300)]
    deviation = np.sqrt(np.var(moved, axis=0) + errors.noise_mm**2)
    found = 1 / np.sqrt(other_loads(influence, rules, Sampling(errors)).precision[:, layout])
    assert found == pytest.approx(deviation, rel=0.12)


@pytest.mark.promise(
    "docs/how-to/design.md",
    "among those that detect two simultaneous contacts, and distributed loads, as often as the paper's layout does.",
)
def test_the_layout_of_the_least_error_notices_as_much_as_that_of_the_product_and_errs_less() -> None:
    influence, rules = problem_in(scene_of(grid_mm=2, min_distance_mm=12))
    others = other_loads(influence, rules, Sampling(ERRORS))
    product = place(influence, rules, 4, 0).positions_mm
    found = place_by_position_error(influence, rules, 4, 0, Sampling(ERRORS)).positions_mm
    shares = [others.noticed(np.searchsorted(rules.place_mm[:, 0], layout)) for layout in (product, found)]
    percent = [
        accuracy_limit(Prior.of(influence, on_axis(np.array(layout)), ERRORS), 2_000, 9).value
        for layout in (product, found)
    ]
    print(f"{product}, {found}: noticed {shares}, error {percent}")
    assert np.all(shares[1] >= shares[0] - SLACK)
    assert percent[1] < 0.98 * percent[0]
