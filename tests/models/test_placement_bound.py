"""Bounds against plain enumeration, on coarse grids."""

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement.eigenvalue_product import eigenvalue_product_of, gap_of, largest_gap
from beamtouch_models.placement.placing import place
from beamtouch_models.scene import Scene
from example_scenes import paper_scene
from stated_problems import problem_in


def best_by_enumeration(scene: Scene, count: int, leading: int) -> float | None:
    """Return the largest log product over all allowed layouts, by numpy's singular values; None if there is none."""
    sensors, half = scene.sensors, scene.sensors.size_mm / 2
    grid = np.arange(1, np.ceil(400 / sensors.grid_mm)) * sensors.grid_mm
    for start, end in [*sensors.keep_out_mm, (0, 0), (400, 400)]:
        grid = grid[(grid + half <= start) | (grid - half >= end)]
    grid = np.union1d(grid, sensors.fixed_mm)
    apart = max(sensors.min_distance_mm, sensors.size_mm)
    layouts = [
        layout
        for layout in combinations(grid, count)
        if set(sensors.fixed_mm) <= set(layout) and np.all(np.diff(layout) >= apart)
    ]
    if not layouts:
        return None
    unit = 400**3 / (210e3 * 25 * 27 / 12)
    columns = influence_of(scene).matrix(grid.astype(np.float64)) / unit
    picked = np.moveaxis(columns[:, np.searchsorted(grid, np.array(layouts))], 1, 0)
    singular = np.linalg.svd(picked, compute_uv=False)[:, :leading]
    return float((2 * np.log(singular) - np.log(len(columns))).sum(axis=1).max())


@settings(max_examples=15)
@given(
    grid_mm=st.sampled_from([20, 25, 32]),
    count=st.integers(2, 4),
    fewer=st.integers(0, 2),
    size_mm=st.sampled_from([0, 24, 30]),
    min_distance_mm=st.sampled_from([0, 30, 64, 90]),
    keep_out_mm=st.lists(st.sampled_from([(90, 135), (200, 260), (330, 399)]), max_size=2, unique=True),
    fixed_mm=st.lists(st.sampled_from([47.0, 150.0, 301.0]), max_size=2, unique=True),
)
def test_no_layout_that_enumeration_finds_is_beyond_the_gap(count: int, fewer: int, **rules: Any) -> None:  # noqa: ANN401
    scene = paper_scene(**rules)
    leading = max(1, count - fewer)
    expected = best_by_enumeration(scene, count, leading) if count >= len(scene.sensors.fixed_mm) else None
    if expected is None:
        with pytest.raises(SceneError):
            place(*problem_in(scene), count, 0, leading)
        return
    found = place(*problem_in(scene), count, 0, leading)
    assert found.log_eigenvalue_product == pytest.approx(expected, abs=1e-8)
    # Of a layout that is not the best, the gap holds the best one as well.
    problem = eigenvalue_product_of(*problem_in(scene), count, leading)
    for layout in (np.searchsorted(problem.rules.position_mm, found.positions_mm), problem.equal):
        assert expected <= problem.exact_score(layout) + gap_of(problem, layout) + 1e-8


def gap(scene: Scene, count: int, leading: int | None = None) -> float:
    """The gap of the layout that a search finds."""
    found = place(*problem_in(scene), count, 0, leading)
    return largest_gap(*problem_in(scene), np.array(found.positions_mm), leading)


@pytest.mark.parametrize(
    ("count", "leading", "most"), [(2, 2, 2e-3), (3, 3, 2e-3), (4, 4, 2e-3), (5, 5, 2e-3), (8, 4, 2e-3), (8, 8, 0.1)]
)
def test_the_papers_problems_have_a_small_gap(count: int, leading: int, most: float) -> None:
    assert 0 <= gap(paper_scene(), count, leading) < most


def test_the_gap_of_a_layout_that_is_not_the_best_holds() -> None:
    problem = eigenvalue_product_of(*problem_in(paper_scene()), 4)
    equal = np.array([79, 159, 239, 319])
    shortfall = -55.4483 - problem.exact_score(equal)
    assert shortfall > 0.1
    assert shortfall - 5e-5 <= gap_of(problem, equal) < shortfall + 0.1
    # The best known layout of eight sensors, with -140.13847, lies within the gap.
    eight = eigenvalue_product_of(*problem_in(paper_scene()), 8)
    assert eight.exact_score(eight.equal) + gap_of(eight, eight.equal) >= -140.13847
