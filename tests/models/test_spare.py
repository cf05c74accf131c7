"""Layouts with a spare sensor, against the best of all layouts on coarse grids."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.errors import SceneError
from beamtouch_models.placement.noticing import other_loads
from beamtouch_models.placement.placing import Aim, place, place_by_position_error
from beamtouch_models.placement.position_error import SLACK, SPARE_NOTICES
from beamtouch_models.scene import Scene
from example_scenes import paper_scene
from stated_problems import problem_in

pytestmark = pytest.mark.long

DRAWS = 500
"""Draws by which all layouts are compared."""
SCATTER = 1.01
"""How much the ratio of the error that is searched by to the limit differs between layouts."""
FEW_DRAWS, FAR = 64, 1.4
"""Draws by which layouts are left out, and how many times the least error they have: many standard errors more."""


def scene_of(supports: str, force_n: object, position_mm: tuple[float, float], **sensors: object) -> Scene:
    base = paper_scene(**sensors).model_dump()
    beam = {**base["beam"], "supports": supports}
    return Scene.model_validate({**base, "beam": beam, "contact": {"force_n": force_n, "position_mm": position_mm}})


SCENES = {
    "propped, force open": (scene_of("propped", (2.0, 20.0), (1, 399), grid_mm=57), 3, SampleErrors(0.002)),
    "simple, off the middle": (scene_of("simply-supported", 10.0, (1, 330), grid_mm=60), 3, SampleErrors(0.02)),
    "cantilever, gains": (scene_of("cantilever", (0.5, 2.0), (20, 400), grid_mm=57), 3, SampleErrors(0.01, 0.02)),
    "propped, mounting": (
        scene_of("propped", (2.0, 20.0), (1, 399), grid_mm=57),
        3,
        SampleErrors(0.002, 0.003, 0.001, 2),
    ),
}
QUICK = {"propped, force open", "cantilever, gains"}


class EveryLayout:
    """The mean errors of layouts of a scene; each set of sensors is measured once."""

    def __init__(self, scene: Scene, errors: SampleErrors) -> None:
        self.influence, self.rules = problem_in(scene)
        self._errors, self.others = errors, other_loads(self.influence, self.rules, errors)
        self.percent = cache(self._percent)

    def _percent(self, kept: tuple[int, ...], draws: int) -> float:
        # Without a sensor, the limit is that of the others: a prior of its own, not one with a channel less.
        prior = Prior.real(self.influence, self.rules.position_mm[list(kept)], self._errors)
        return accuracy_limit(prior, draws, 0).percent

    def worst(self, layout: tuple[int, ...], draws: int, spare: int) -> float:
        """Return the error, with a spare the largest with one failed, less what noticing other loads is worth then."""
        failed = combinations(layout, len(layout) - 1) if spare else [layout]
        worth = SPARE_NOTICES * float(self.others.noticed(np.array(layout)).mean()) if spare else 0.0
        return max(self.percent(kept, draws) for kept in failed) * (1 - worth)

    def admitted(self, count: int, spare: int) -> list[tuple[int, ...]]:
        """Return the layouts that notice other loads as well as the eigenvalue product's; all of them with a spare."""
        every = list(combinations(range(len(self.rules.position_mm)), count))
        if spare:
            return every
        product = place(self.influence, self.rules, count, 0).positions_mm
        least = self.others.noticed(np.searchsorted(self.rules.position_mm, product)) - SLACK
        return [layout for layout in every if np.all(self.others.noticed(np.array(layout)) >= least)]

    def best(self, count: int, spare: int) -> tuple[int, ...]:
        """Return the layout with the least error; those that err much more by few draws are left out."""
        every = self.admitted(count, spare)
        roughly = [self.worst(layout, FEW_DRAWS, spare) for layout in every]
        near = [layout for layout, one in zip(every, roughly, strict=True) if one < FAR * min(roughly)]
        return min(near, key=lambda layout: self.worst(layout, DRAWS, spare))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.soak) for name in SCENES]
)
def test_no_layout_of_a_coarse_grid_is_clearly_better(name: str) -> None:
    scene, count, errors = SCENES[name]
    every = EveryLayout(scene, errors)
    for spare in (0, 1):
        best = every.best(count, spare)
        found = place_by_position_error(every.influence, every.rules, count, 0, errors, spare=spare)
        layout = tuple(np.searchsorted(every.rules.position_mm, found.positions_mm).tolist())
        least, reached = every.worst(best, DRAWS, spare), every.worst(layout, DRAWS, spare)
        print(f"{name}, spare {spare}: {reached / least:.4f} of the least")
        assert reached <= SCATTER * least, spare


@pytest.mark.soak
def test_a_search_of_many_layouts_is_within_a_hundredth_of_the_best() -> None:
    scene, errors = scene_of("propped", (2.0, 20.0), (1, 399), grid_mm=22), SampleErrors(0.002)
    every = EveryLayout(scene, errors)
    layouts = combinations(range(len(every.rules.position_mm)), 3)
    least = min(every.worst(layout, DRAWS, 1) for layout in layouts)
    found = place_by_position_error(every.influence, every.rules, 3, 0, errors, spare=1)
    layout = np.searchsorted(every.rules.position_mm, found.positions_mm)
    assert every.worst(tuple(layout.tolist()), DRAWS, 1) <= SCATTER * least


@pytest.mark.soak
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
    with pytest.raises(SceneError, match="spare = 1 needs at least 2 sensors, not 1"):
        place_by_position_error(*problem, 1, 0, SampleErrors(0.01), spare=1)
    with pytest.raises(SceneError, match="spare = 1: give 0, or 1, which places by position error"):
        Aim("eigenvalue-product", spare=1)
