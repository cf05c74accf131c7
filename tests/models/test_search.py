"""The search by position error: its objective is the accuracy limit, it finds the best layout, what a spare is worth.

`test_place_command.py` holds its layouts to the rules of the scene.
"""

from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.arrays import Indices
from beamtouch_models.design.accuracy import limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.placement.layout_rules import LayoutRules, equal_layout
from beamtouch_models.design.placement.placing import place
from beamtouch_models.design.placement.position_error import SPARE_NOTICES, PositionError, Sampling, position_error_of
from beamtouch_models.design.placement.search import first_best, search_from
from beamtouch_models.design.scene import Scene, change_scene
from beamtouch_models.names import SEARCHES
from beamtouch_models.runtime.error_model import Errors
from support.surfaces.example_scenes import paper_scene
from support.surfaces.stated_problems import problem_in

pytestmark = pytest.mark.long

ERRORS = Errors(0.002, 0.003, 0.001)
LENGTH_MM = 400


def scene_of(supports: str = "simply-supported", **sensors: object) -> Scene:
    return change_scene(paper_scene(**sensors), beam={"supports": supports}, contact={"force_n": (2.0, 20.0)})


def objective_of(scene: Scene, spare: int, count: int = 3) -> tuple[PositionError, Indices]:
    """Return an objective and the layout of the eigenvalue product."""
    influence, rules = problem_in(scene)
    product = np.searchsorted(rules.place_mm[:, 0], place(influence, rules, count, 0).positions_mm)
    equal = equal_layout(rules, np.array([LENGTH_MM]), count)
    return position_error_of(influence, rules, equal, Sampling(ERRORS), 0, spare=spare, reference=product), product


def every_layout(rules: LayoutRules) -> Indices:
    every = np.array(list(combinations(range(len(rules.place_mm[:, 0])), 3)), dtype=np.intp)
    return every[rules.allowed(every)]


@pytest.mark.parametrize(
    ("supports", "spare"), [("cantilever", 0), pytest.param("simply-supported", 1, marks=pytest.mark.soak)]
)
def test_the_searches_reach_the_least_error_of_all_layouts(supports: str, spare: int) -> None:
    objective, reference = objective_of(scene_of(supports, grid_mm=25, min_distance_mm=30), spare)
    # A start that the rules do not allow is left out.
    assert len(search_from([np.array([0, 1, 2]), reference], objective, "exchange", 0)) == 1
    best = objective.scores(every_layout(objective.rules)).max()
    for search in SEARCHES:
        found = first_best(search_from([reference, reference], objective, search, 0))
        assert found.score == pytest.approx(best, rel=0.002), search
        assert list(found.scores) == sorted(found.scores), search


def test_layouts_against_the_rules_or_that_notice_less_than_the_reference_have_no_score() -> None:
    objective, reference = objective_of(scene_of(grid_mm=25, min_distance_mm=40), 0, count=4)
    every = np.array(list(combinations(range(len(objective.rules.place_mm[:, 0])), 4)), dtype=np.intp)
    scores = objective.scores(every)
    notices = np.array([np.all(objective.others.noticed(layout) >= objective.least) for layout in every])
    assert np.array_equal(np.isfinite(scores), objective.rules.allowed(every) & notices)
    assert 0 < np.isfinite(scores).sum() < objective.rules.allowed(every).sum()
    assert objective.scores(reference[None])[0] == -objective.error_mm(reference)


def test_with_a_spare_the_score_is_the_worst_failure_less_what_is_noticed() -> None:
    objective, layout = objective_of(scene_of("cantilever", grid_mm=5), 1)
    failed = [objective.error_mm(np.delete(layout, index)) for index in range(3)]
    worth = 1 - SPARE_NOTICES * objective.others.noticed(layout).mean()
    assert objective.scores(layout[None])[0] == pytest.approx(-max(failed) * worth, rel=1e-12)


@pytest.mark.parametrize(
    ("force_n", "errors"),
    [
        ((10.0, 10.0), Errors(0.03)),
        pytest.param((2.0, 20.0), Errors(0.01), marks=pytest.mark.soak),
        pytest.param((2.0, 20.0), Errors(0.004, 0.02, 0.005), marks=pytest.mark.soak),
        ((2.0, 20.0), Errors(0.004, 0.003, 0.001, 3.0)),
    ],
    ids=["force known", "noise", "gain and zero", "mounting"],
)
def test_the_objective_orders_layouts_as_the_limit_does(force_n: object, errors: Errors) -> None:
    influence, rules = problem_in(change_scene(paper_scene(), contact={"force_n": force_n}))
    one = position_error_of(influence, rules, equal_layout(rules, np.array([LENGTH_MM]), 3), Sampling(errors), 0)
    layouts = np.array([[49, 199, 349], [87, 199, 311], [99, 149, 299], [59, 219, 339], [119, 199, 279]])
    ratios = [
        one.error_mm(layout)
        / (4 * limit.accuracy_limit(Prior.of(influence, rules.place_mm[layout], errors), 1_000, 3).value)
        for layout in layouts
    ]
    # The width of posteriors of samples without errors is a little less than that of samples with them.
    assert min(ratios) > 0.85
    assert max(ratios) < 1.1
    assert max(ratios) < 1.06 * min(ratios)
