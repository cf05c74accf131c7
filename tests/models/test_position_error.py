"""Placement by position error: its objective against the accuracy limit, and its layouts.

`test_place_command.py` holds its layouts to the rules of the scene.
"""

import numpy as np
import pytest
from scipy import stats

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement.layout import equal_layout
from beamtouch_models.placement.placing import place_by_position_error
from beamtouch_models.placement.position_error import PositionError, mean_distances, position_error_of
from beamtouch_models.scene import Scene
from example_scenes import paper_scene
from stated_problems import problem_in

pytestmark = pytest.mark.long

NOISE_MM = 0.02 * 1.1287477954


def limit_of(
    scene: Scene, layout: tuple[float, ...], noise_mm: float = NOISE_MM, draws: int = 4_000
) -> limit.MeanError:
    return limit.accuracy_limit(Prior.of(influence_of(scene), np.array(layout), noise_mm), draws, 77)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.soak)])
def test_two_sensors_have_a_lower_limit_than_by_the_eigenvalue_product(seed: int) -> None:
    found = place_by_position_error(*problem_in(paper_scene()), 2, seed, SampleErrors(NOISE_MM))
    # From independent code: 3.78 % near 107 and 293 mm, 4.12 % at the optimum of the product.
    assert np.array(found.positions_mm) == pytest.approx([107, 293], abs=14)
    assert limit_of(paper_scene(), found.positions_mm).percent == pytest.approx(3.78, abs=0.06)
    assert limit_of(paper_scene(), (122.0, 278.0)).percent > 3.95


@pytest.mark.soak
def test_at_little_noise_the_layout_is_no_worse_than_equal_pitch_or_the_product() -> None:
    noise_mm = 1e-5
    found = place_by_position_error(*problem_in(paper_scene()), 2, 0, SampleErrors(noise_mm))
    equal = limit_of(paper_scene(), (133.0, 267.0), noise_mm)
    product = limit_of(paper_scene(), (122.0, 278.0), noise_mm)
    assert limit_of(paper_scene(), found.positions_mm, noise_mm).percent <= min(equal.percent, product.percent)


def objective_of(scene: Scene, count: int, errors: SampleErrors) -> PositionError:
    influence, rules = problem_in(scene)
    return position_error_of(influence, rules, equal_layout(rules, influence.length_mm, count), errors, 0)


@pytest.mark.parametrize(
    ("force_n", "errors"),
    [
        (10.0, SampleErrors(0.03)),
        pytest.param((2.0, 20.0), SampleErrors(0.01), marks=pytest.mark.soak),
        pytest.param((2.0, 20.0), SampleErrors(0.004, 0.02, 0.005), marks=pytest.mark.soak),
        ((2.0, 20.0), SampleErrors(0.004, 0.003, 0.001, 3.0)),
    ],
    ids=["force known", "noise", "gain and zero", "mounting"],
)
def test_the_objective_orders_layouts_as_the_limit_does(force_n: object, errors: SampleErrors) -> None:
    base = paper_scene().model_dump()
    scene = Scene.model_validate({**base, "contact": {"force_n": force_n, "position_mm": (1, 399)}})
    one, influence = objective_of(scene, 3, errors), influence_of(scene)
    layouts = np.array([[49, 199, 349], [87, 199, 311], [99, 149, 299], [59, 219, 339], [119, 199, 279]])
    ratios = [
        one.error_mm(layout)
        / (4 * limit.accuracy_limit(Prior.real(influence, one.rules.position_mm[layout], errors), 1_000, 3).percent)
        for layout in layouts
    ]
    # The width of posteriors of samples without errors is a little less than that of samples with them.
    assert min(ratios) > 0.85
    assert max(ratios) < 1.1
    assert max(ratios) < 1.06 * min(ratios)


@pytest.mark.parametrize("sigma_mm", [0.6, 3.0, 30.0])
def test_the_mean_distance_of_a_density_on_cells_is_that_of_scipy(sigma_mm: float) -> None:
    edges = np.unique(np.concatenate([np.linspace(0, 400, 200), np.linspace(90, 110, 57)]))
    middles = (edges[1:] + edges[:-1]) / 2
    found = mean_distances(edges, stats.norm(101.0, sigma_mm).logpdf(middles)[None])
    assert found[0] == pytest.approx(stats.norm(0, sigma_mm).expect(np.abs), rel=0.02)
