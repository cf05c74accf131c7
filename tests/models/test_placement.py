"""Placement by the eigenvalue product: its searches, and the rules that every layout keeps."""

import numpy as np
import pytest

from beamtouch_models.errors import SceneError
from beamtouch_models.names import SearchName
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement.placing import place, recommended_count, score_positions
from beamtouch_models.scene import change_scene
from example_scenes import paper_scene
from stated_problems import problem_in

# Two and four sensors as published; three and five from an independent enumeration of all layouts of the grid.
OPTIMA = {
    2: ((122, 278), -21.6047),
    3: ((88, 200, 312), -37.5336),
    4: ((68, 156, 244, 332), -55.4483),
    5: ((56, 128, 200, 272, 344), -74.9065),
}


@pytest.mark.parametrize("search", ["exact", pytest.param("paper", marks=pytest.mark.soak)])
@pytest.mark.parametrize("count", OPTIMA)
def test_every_seed_reaches_the_optimum(count: int, search: SearchName) -> None:
    positions, log_product = OPTIMA[count]
    for seed in range(5 if search == "exact" else 10):  # a miss from one start in three passes once in 58 times
        found = place(*problem_in(paper_scene()), count, seed, search=search)
        assert found.positions_mm == positions
        assert found.log_eigenvalue_product == pytest.approx(log_product, abs=5e-5)


def test_eight_sensors_on_four_components_merge_into_four_pairs() -> None:
    # The paper's figure 5, which `reproduce` draws with the paper's search.
    for seed in range(2):
        found = place(*problem_in(paper_scene()), 8, seed, leading=4)
        assert found.positions_mm == (68, 69, 156, 157, 243, 244, 331, 332)


@pytest.mark.parametrize("search", ["exact", "paper"])
def test_the_same_seed_gives_the_same_search(search: SearchName) -> None:
    first, second = (place(*problem_in(paper_scene()), 3, 5, search=search) for _ in range(2))
    assert first == second
    scored = score_positions(influence_of(paper_scene()), np.array(first.positions_mm))
    assert first.log_eigenvalue_product == pytest.approx(scored, abs=1e-12)


@pytest.mark.parametrize("search", ["exact", "paper"])
def test_layouts_keep_keep_outs_fixed_sensors_grid_and_distance(search: SearchName) -> None:
    scene = paper_scene(keep_out_mm=[(110, 130), (270, 290)], fixed_mm=[200.5], grid_mm=5, min_distance_mm=40)
    found = np.array(place(*problem_in(scene), 4, 0, search=search).positions_mm)
    assert 200.5 in found
    assert not np.any((found > 110) & (found < 130))
    assert not np.any((found > 270) & (found < 290))
    assert np.all(np.diff(found) >= 40)
    others = found[found != 200.5]
    assert np.all(others % 5 == 0)
    # Without a keep-out the left sensor stands at 122 mm; its housing of 8 mm touches the keep-out now.
    beside = place(*problem_in(paper_scene(keep_out_mm=[(110, 130)], size_mm=8.0)), 2, 0, search=search).positions_mm
    assert beside[0] in {106, 134}


def test_rules_that_allow_no_layout_are_refused() -> None:
    refused = {
        "more than the 1 to be placed": (paper_scene(fixed_mm=[100, 200]), 1),
        "min_distance_mm": (paper_scene(min_distance_mm=300), 4),
        "no layout of 3 sensors": (paper_scene(fixed_mm=[100], size_mm=150), 3),
        "no layout of 5 sensors": (paper_scene(grid_mm=80), 5),
        "fewer than two positions": (paper_scene(keep_out_mm=[(0, 400)]), 2),
        "more than 20000 positions": (paper_scene(grid_mm=1e-6), 2),
    }
    for said, (scene, count) in refused.items():
        with pytest.raises(SceneError, match=said):
            place(*problem_in(scene), count, 0)
    with pytest.raises(SceneError, match="2 sensors have 2 components, not 3"):
        place(*problem_in(paper_scene()), 2, 0, leading=3)


def test_a_fixed_sensor_on_a_grid_of_a_tenth_is_not_counted_twice() -> None:
    # 1003 * 0.1 is not 100.3 in binary, but they are the same position.
    found = place(*problem_in(paper_scene(grid_mm=0.1, fixed_mm=[100.3])), 2, 0)
    assert found.positions_mm[0] == 100.3
    assert found.positions_mm[1] - 100.3 > 50


def test_a_free_end_may_carry_a_sensor() -> None:
    cantilever = change_scene(
        paper_scene(), beam={"supports": "cantilever"}, contact={"force_n": 1, "position_mm": (1, 400)}
    )
    assert place(*problem_in(cantilever), 2, 0).positions_mm[-1] == 400


def test_the_recommended_number_falls_with_the_noise_and_rises_with_the_force() -> None:
    # The components of figure 3 are 1, 1/16, 1/81 ... of 0.51 x sqrt(8) of the largest deflection.
    of_largest = 1.1287477954
    influence = influence_of(paper_scene())
    counts = [recommended_count(influence, percent / 100 * of_largest) for percent in (0, 0.1, 0.5, 2, 10, 1e6)]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] == 8
    assert counts[3] == counts[-1] == 2
    strong, weak = (
        recommended_count(influence_of(change_scene(paper_scene(), contact={"force_n": force_n})), 0.01)
        for force_n in (20.0, 2.0)
    )
    assert strong >= weak
