"""The search by position error: it finds the largest score of all layouts, and what a spare is worth."""

from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.accuracy.prior import SampleErrors
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.errors import SceneError
from beamtouch_models.names import SEARCHES
from beamtouch_models.placement.layout import Candidates, equal_layout
from beamtouch_models.placement.placing import Aim, place, place_by_position_error
from beamtouch_models.placement.position_error import SPARE_NOTICES, PositionError, position_error_of
from beamtouch_models.placement.search import first_best, search_from
from beamtouch_models.scene import Scene
from example_scenes import paper_scene
from stated_problems import problem_in

pytestmark = pytest.mark.long

ERRORS = SampleErrors(0.002, 0.003, 0.001)
LENGTH_MM = 400


def scene_of(supports: str = "simply-supported", **sensors: object) -> Scene:
    base = paper_scene(**sensors).model_dump()
    contact = {"force_n": (2.0, 20.0), "position_mm": (1, 399)}
    return Scene.model_validate({**base, "beam": {**base["beam"], "supports": supports}, "contact": contact})


def objective_of(scene: Scene, spare: int, count: int = 3) -> tuple[PositionError, Indices]:
    """Return an objective and the layout of the eigenvalue product."""
    influence, rules = problem_in(scene)
    product = np.searchsorted(rules.position_mm, place(influence, rules, count, 0).positions_mm)
    equal = equal_layout(rules, LENGTH_MM, count)
    return position_error_of(influence, rules, equal, ERRORS, 0, spare=spare, reference=product), product


def every_layout(rules: Candidates, count: int = 3) -> Indices:
    every = np.array(list(combinations(range(len(rules.position_mm)), count)), dtype=np.intp)
    return every[rules.allowed(every)]


@pytest.mark.parametrize(
    ("supports", "spare"), [("cantilever", 0), pytest.param("simply-supported", 1, marks=pytest.mark.soak)]
)
def test_the_searches_reach_the_least_error_of_all_layouts(supports: str, spare: int) -> None:
    objective, reference = objective_of(scene_of(supports, grid_mm=25, min_distance_mm=30), spare)
    # A start that the rules do not allow is left out.
    assert len(search_from([np.array([0, 1, 2]), reference], objective, "exact", 0)) == 1
    best = objective.scores(every_layout(objective.rules)).max()
    for search in SEARCHES:
        found = first_best(search_from([reference, reference], objective, search, 0))
        assert found.score == pytest.approx(best, rel=0.002), search
        assert list(found.scores) == sorted(found.scores), search


class Valley:
    """Two hills with a support between them, where no sensor sees anything; the farther hill is the higher one."""

    at_once = 7
    rules = Candidates(np.arange(200.0), np.array([], np.intp), 5.0)

    def scores(self, layouts: Indices, above: float = -np.inf, /) -> Floats:
        assert above < np.inf
        near, far = (np.exp(-(((layouts - top) / 8.0) ** 2)) for top in (30, 170))
        each = np.where(np.abs(layouts - 100) < 40, 0.0, np.maximum(near, 2 * far))
        return np.where(self.rules.allowed(layouts), each.sum(axis=1), -np.inf)


def test_the_exchange_carries_a_sensor_over_a_support() -> None:
    (found,) = search_from([np.array([28, 34])], Valley(), "exact", 0)
    assert found.layout.tolist() in ([167, 172], [168, 173])
    (found,) = search_from([found.layout], Valley(), "exact", 0)
    assert len(found.scores) == 1


def test_layouts_against_the_rules_or_that_notice_less_than_the_reference_have_no_score() -> None:
    objective, reference = objective_of(scene_of(grid_mm=25, min_distance_mm=40), 0, count=4)
    every = np.array(list(combinations(range(len(objective.rules.position_mm)), 4)), dtype=np.intp)
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


@pytest.mark.soak
def test_of_layouts_with_nearly_the_least_error_one_that_notices_much_is_taken() -> None:
    objective, reference = objective_of(scene_of("cantilever", grid_mm=25, min_distance_mm=20), 1)
    every = every_layout(objective.rules)
    shares = np.array([objective.others.noticed(layout).mean() for layout in every])
    scores = objective.scores(every)
    worst = -scores / (1 - SPARE_NOTICES * shares)
    found = first_best(search_from([reference], objective, "exact", 0)).layout
    row, least = int(np.flatnonzero((every == found).all(axis=1))[0]), int(worst.argmin())
    print(f"{worst[row] / worst[least]:.4f} of the least, noticed {shares[row]:.2f}, {shares[least]:.2f}")
    assert scores[row] >= scores[least]
    assert shares[row] > shares[least] + 0.02


@pytest.mark.parametrize("spare", [0, pytest.param(1, marks=pytest.mark.soak)])
def test_the_only_layout_is_found_and_fixed_sensors_stay(spare: int) -> None:
    influence, rules = problem_in(scene_of(grid_mm=1, min_distance_mm=199))
    only = place_by_position_error(influence, rules, 3, 0, ERRORS, spare=spare).positions_mm
    assert only[0] <= 1
    assert np.diff(only).min() >= 199
    fixed = problem_in(scene_of(fixed_mm=[100.5, 300.0]))
    found = place_by_position_error(*fixed, 3, 0, ERRORS, spare=spare).positions_mm
    assert {100.5, 300.0} < set(found)
    every = problem_in(scene_of(fixed_mm=[100.5, 200.0, 300.0]))
    assert place_by_position_error(*every, 3, 0, ERRORS, spare=spare).positions_mm == (100.5, 200.0, 300.0)


def test_a_spare_needs_another_sensor_and_the_position_error() -> None:
    problem = problem_in(paper_scene(grid_mm=40))
    with pytest.raises(SceneError, match="spare = 1 needs at least 2 sensors, not 1"):
        place_by_position_error(*problem, 1, 0, ERRORS, spare=1)
    with pytest.raises(SceneError, match="spare = 1: give 0, or 1, which places by position error"):
        Aim("eigenvalue-product", spare=1)
