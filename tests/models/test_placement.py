import numpy as np
import pytest

from beamtouch_models.errors import SceneError
from beamtouch_models.placement import place, score_positions
from example_scenes import paper_scene


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("count", "optimum"), [(2, (122, 278)), (4, (68, 156, 244, 332))])
def test_the_search_finds_the_known_optimum(seed: int, count: int, optimum: tuple[float, ...]) -> None:
    assert place(paper_scene(), count, seed).positions_mm == optimum


def test_the_same_seed_gives_the_same_search_and_convergence_never_falls() -> None:
    first, second = place(paper_scene(), 3, 5), place(paper_scene(), 3, 5)
    assert first == second
    assert list(first.convergence) == sorted(first.convergence)
    assert first.log_eigenvalue_product == score_positions(paper_scene(), np.array(first.positions_mm))


def test_eight_sensors_on_four_components_merge_into_four() -> None:
    # The paper's figure 5; published: 68, 69, 156, 157, 243, 244, 331, 332.
    found = place(paper_scene(), 8, 0, leading=4)
    expected = np.array([68.5, 156.5, 243.5, 331.5])
    assert np.array(found.positions_mm).reshape(4, 2).mean(axis=1) == pytest.approx(expected, abs=3)


def test_keep_outs_fixed_sensors_grid_and_distance_hold() -> None:
    scene = paper_scene(keep_out_mm=[(110, 130), (270, 290)], fixed_mm=[200.5], grid_mm=5, min_distance_mm=40)
    found = np.array(place(scene, 4, 0).positions_mm)
    assert 200.5 in found
    assert not np.any((found > 110) & (found < 130))
    assert not np.any((found > 270) & (found < 290))
    assert np.all(np.diff(found) >= 40)
    others = found[found != 200.5]
    assert np.all(others % 5 == 0)


def test_rules_that_leave_no_room_are_refused() -> None:
    with pytest.raises(SceneError, match="more than the 1 to be placed"):
        place(paper_scene(fixed_mm=[100, 200]), 1, 0)
    with pytest.raises(SceneError, match="min_distance_mm"):
        place(paper_scene(min_distance_mm=300), 4, 0)
    with pytest.raises(SceneError, match="fewer than two positions"):
        place(paper_scene(keep_out_mm=[(0, 400)]), 2, 0)
