"""Layouts with a spare sensor, against the best of all layouts on coarse grids."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.errors import SceneError
from beamtouch_models.placement import Aim, place, place_by_position_error
from beamtouch_models.placement.goal import SLACK
from beamtouch_models.placement.least_error import FINAL_DRAWS, MAX_LISTED
from beamtouch_models.placement.noticing import other_loads
from beamtouch_models.scene import Scene
from example_scenes import paper_scene
from stated_problems import problem_in

pytestmark = [pytest.mark.long, pytest.mark.untraced]

DRAWS = 500


def scene_of(supports: str, force_n: object, position_mm: tuple[float, float], **sensors: object) -> Scene:
    base = paper_scene(**sensors).model_dump()
    beam = {**base["beam"], "supports": supports}
    return Scene.model_validate({**base, "beam": beam, "contact": {"force_n": force_n, "position_mm": position_mm}})


SCENES = {
    "propped, force open": (scene_of("propped", (2.0, 20.0), (1, 399), grid_mm=45), 3, SampleErrors(0.002)),
    "simple, off the middle": (scene_of("simply-supported", 10.0, (1, 330), grid_mm=60), 3, SampleErrors(0.02)),
    "cantilever, gains": (scene_of("cantilever", (0.5, 2.0), (20, 400), grid_mm=50), 3, SampleErrors(0.01, 0.02)),
    "propped, mounting": (
        scene_of("propped", (2.0, 20.0), (1, 399), grid_mm=50),
        4,
        SampleErrors(0.002, 0.003, 0.001, 2),
    ),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("spare", [0, 1])
def test_the_layout_is_the_best_of_all_on_a_coarse_grid(name: str, spare: int) -> None:
    scene, count, errors = SCENES[name]
    influence, rules = problem_in(scene)

    @cache
    def error(*kept: int) -> float:
        prior = Prior.real(influence, rules.position_mm[list(kept)], errors)
        return accuracy_limit(prior, FINAL_DRAWS, 0).percent

    def objective(layout: tuple[int, ...]) -> tuple[float, float]:
        # Without a sensor, the limit is that of the others: a prior of its own, not one with a channel less.
        failed = combinations(layout, count - 1) if spare else [layout]
        return max(error(*kept) for kept in failed), error(*layout) if spare else 0.0

    others = other_loads(influence, rules, errors)
    product = place(influence, rules, count, 0).positions_mm
    least = others.noticed(np.searchsorted(rules.position_mm, product)) - SLACK
    every = combinations(range(len(rules.position_mm)), count)
    admitted = (layout for layout in every if spare or np.all(others.noticed(np.array(layout)) >= least))
    best = min(admitted, key=objective)
    found = place_by_position_error(influence, rules, count, 0, errors, spare=spare)
    assert found.positions_mm == tuple(rules.position_mm[list(best)])


def test_a_search_of_more_layouts_than_are_listed_is_within_a_hundredth_of_the_best() -> None:
    scene, errors = scene_of("propped", (2.0, 20.0), (1, 399), grid_mm=22), SampleErrors(0.002)
    influence, rules = problem_in(scene)

    @cache
    def error(*kept: int) -> float:
        return accuracy_limit(Prior.real(influence, rules.position_mm[list(kept)], errors), DRAWS, 0).percent

    every = list(combinations(range(len(rules.position_mm)), 3))
    assert len(every) > MAX_LISTED
    least = min(max(error(*kept) for kept in combinations(layout, 2)) for layout in every)
    found = place_by_position_error(influence, rules, 3, 0, errors, spare=1)
    layout = np.searchsorted(rules.position_mm, found.positions_mm)
    assert max(error(*kept) for kept in combinations(layout.tolist(), 2)) <= 1.01 * least


def test_one_failed_sensor_costs_less_with_a_spare() -> None:
    influence, rules = problem_in(scene_of("simply-supported", (2.0, 20.0), (1, 399), grid_mm=5))
    errors = SampleErrors(0.00226, 0.003, 0.001)

    def worst(positions_mm: tuple[float, ...]) -> float:
        prior = Prior.real(influence, np.array(positions_mm), errors)
        return max(accuracy_limit(prior.without(index), 4_000, 7).percent for index in range(3))

    plain, spare = (place_by_position_error(influence, rules, 3, 0, errors, spare=spare) for spare in (0, 1))
    assert worst(spare.positions_mm) < 0.9 * worst(plain.positions_mm)


def test_a_spare_needs_another_sensor_and_the_position_error() -> None:
    problem = problem_in(paper_scene(grid_mm=40))
    with pytest.raises(SceneError, match="--spare 1 needs at least 2 sensors, not 1"):
        place_by_position_error(*problem, 1, 0, SampleErrors(0.01), spare=1)
    with pytest.raises(SceneError, match="--spare 1 places by position error"):
        Aim("eigenvalue-product", spare=1)
