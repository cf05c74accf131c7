"""The searches on objectives whose best layout is known: which layouts they try and count, and where they end."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.placement.search import (
    SearchRun,
    first_best,
    jump,
    near_steps,
    paper_search,
    refine,
    search_from,
)
from beamtouch_models.places import grid_of, on_axis

NONE = np.array([], dtype=np.intp)


@dataclass
class Near:
    """Layouts score by how near they are to a target, and by what a barrier in the middle costs."""

    rules: LayoutRules
    target: Indices
    at_once: int = 5
    barrier: float = 0.0
    """Costs a layout each sensor within 3 places of the middle."""
    asked: list[Indices] = field(default_factory=list)
    batches: list[int] = field(default_factory=list)

    def scores(self, layouts: Indices, _above: float = -np.inf) -> Floats:
        self.asked += list(layouts)
        self.batches.append(len(layouts))
        assert np.all(np.diff(layouts, axis=1) >= 0)
        off = self.rules.place_mm[layouts] - self.rules.place_mm[self.target]
        middle = self.rules.place_mm.mean(axis=0)[0]
        within = np.abs(self.rules.place_mm[layouts][..., 0] - middle) <= 3
        scores = -1.0 - (off**2).sum(axis=(1, 2)) - self.barrier * within.sum(axis=1)
        return np.where(self.rules.allowed(layouts), scores, -np.inf)


def line(target: Sequence[int], length: int = 101, *, fixed: Sequence[int] = (), **options: float) -> Near:
    rules = LayoutRules(on_axis(np.arange(float(length))), np.array(fixed, dtype=np.intp), 0.0)
    return Near(rules, np.array(target, dtype=np.intp), **options)  # type: ignore[arg-type]


def plane(target: Sequence[tuple[int, int]]) -> Near:
    rules = LayoutRules(grid_of([np.arange(30.0), np.arange(20.0)]), NONE, 0.0)
    return Near(rules, np.sort(np.array([20 * x + y for x, y in target], dtype=np.intp)))


def started(objective: Near, layout: Sequence[int]) -> SearchRun:
    start = np.array(layout, dtype=np.intp)
    return SearchRun((start,), (float(objective.scores(start[None])[0]),), 1)


@pytest.mark.parametrize("search", ["exchange", "paper"])
def test_both_searches_reach_the_target_on_a_line_and_on_a_plane(search: str) -> None:
    for objective, start in ((line([7, 40, 93]), [1, 2, 3]), (plane([(3, 17), (25, 4)]), [0, 1])):
        (run,) = search_from([np.array(start)], objective, search, 1)  # type: ignore[arg-type]
        assert run.layout.tolist() == objective.target.tolist()
        assert run.score == -1.0
        assert list(run.scores) == sorted(run.scores)
        assert len(run.layouts) == len(run.scores)
        for layout, score in zip(run.layouts, run.scores, strict=True):
            assert float(objective.scores(layout[None])[0]) == score


@pytest.mark.parametrize("search", ["exchange", "paper"])
def test_a_search_counts_each_layout_that_it_scores(search: str) -> None:
    for objective, start in ((line([7, 40, 93]), [1, 2, 3]), (plane([(3, 17), (25, 4)]), [0, 1])):
        (run,) = search_from([np.array(start)], objective, search, 1)  # type: ignore[arg-type]
        assert run.evaluations == len(objective.asked)


def test_an_exchange_tries_each_move_of_one_sensor_and_of_two_once_where_none_gains() -> None:
    """At the best layout a step tries both ways of each sensor, and all four ways of each pair."""
    objective = line([20, 50, 80])
    run = refine(objective, objective.target, 10_000, 4)
    tried = {tuple(layout) for layout in objective.asked[1:]}
    expected = set[tuple[int, ...]]()
    for step in (4, 2, 1):
        for sensor in range(3):
            for sign in (-1, 1):
                expected.add(tuple(objective.target + sign * step * np.eye(3, dtype=int)[sensor]))
        for pair in combinations(range(3), 2):
            for signs in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
                moved = objective.target.copy()
                moved[list(pair)] += step * np.array(signs)
                expected.add(tuple(moved))
    assert tried == expected
    assert run.evaluations == 1 + 3 * (6 + 12) == len(objective.asked)
    assert len(run.layouts) == 1
    # They are scored in groups, as many at once as are best scored together.
    assert objective.batches == [1, *([5, 5, 5, 3] * 3)]


def test_no_sensor_moves_beyond_an_end() -> None:
    """From the left end a sensor moves to the right alone, and with the other to either side."""
    objective = line([0, 50])
    refine(objective, objective.target, 10_000, 1)
    tried = sorted(layout.tolist() for layout in objective.asked[1:])
    assert tried == [[0, 49], [0, 51], [1, 49], [1, 50], [1, 51]]


def test_of_more_than_eight_sensors_only_neighbours_move_together() -> None:
    for sensors, pairs in ((8, 28), (9, 8)):
        objective = line(range(10, 10 + 10 * sensors, 10))
        refine(objective, objective.target, 10_000, 1)
        assert len(objective.asked) == 1 + 2 * sensors + 4 * pairs


def test_on_a_plane_a_sensor_moves_along_both_axes() -> None:
    objective = plane([(10, 10), (20, 5)])
    refine(objective, objective.target, 10_000, 3)
    x, y = (np.array(objective.asked)[1 : 1 + 8] // 20, np.array(objective.asked)[1 : 1 + 8] % 20)
    steps = {tuple(row) for row in np.column_stack([x - [10, 20], y - [10, 5]]).tolist()}
    assert steps == {
        *((sign * 3, 0, 0, 0) for sign in (-1, 1)),
        *((0, sign * 3, 0, 0) for sign in (-1, 1)),
        *((0, 0, sign * 3, 0) for sign in (-1, 1)),
        *((0, 0, 0, sign * 3) for sign in (-1, 1)),
    }
    assert len(objective.asked) == 1 + 2 * (8 + 16)


def test_no_smaller_step_is_tried_after_the_most_layouts() -> None:
    per_step = 2 * 2 + 4
    for most, steps in ((1, 0), (2, 1), (1 + per_step, 1), (2 + per_step, 2), (2 + 2 * per_step, 3)):
        objective = line([30, 60])
        assert refine(objective, objective.target, most, 8).evaluations == 1 + steps * per_step


def test_a_refinement_begins_with_a_sixty_fourth_of_the_places() -> None:
    assert [near_steps(line([1], length).rules) for length in (20, 64, 127, 128, 640)] == [1, 1, 1, 2, 10]
    objective = line([300, 400], 640)
    refine(objective, objective.target, 10_000)
    assert objective.asked[1].tolist() in ([290, 400], [310, 400])


def test_a_search_begins_with_a_quarter_of_the_distance_of_equal_pitch_and_ends_with_the_finest() -> None:
    for finest in (1, 2, 4):
        objective = line([300, 400], 640)
        search_from([objective.target], objective, "exchange", 0, effort=Effort(0.02), finest=finest)
        alone = [np.abs(layout - objective.target) for layout in objective.asked[1:] if 300 in layout or 400 in layout]
        steps = {int(off.max()) for off in alone[: 2 * 80]}
        assert max(steps & {160, 80, 40, 20, 10, 5}) == 80
        assert min(off.max() for off in alone) == {1: 1, 2: 2, 4: 5}[finest]


def test_where_steps_meet_a_barrier_a_sensor_jumps_over_it() -> None:
    objective = line([20, 93], barrier=1e6)
    stuck = refine(objective, np.array([15, 30]), 10_000, 4)
    assert stuck.layout.tolist() == [20, 46]
    asked = len(objective.asked)
    run = jump(objective, stuck, 10_000)
    assert run.layout.tolist() == [20, 93]
    assert run.evaluations == stuck.evaluations + len(objective.asked) - asked
    assert [layout.tolist() for layout in run.layouts[: len(stuck.layouts)]] == [one.tolist() for one in stuck.layouts]
    # Each sensor is tried at 24 places over the line; the last round gains nothing.
    tried = np.array(objective.asked[asked : asked + 48])
    assert tried.min() == 0
    assert tried.max() == 100
    others = [sorted({*row} - {20, 46}) for row in tried.tolist()]
    assert {place for other in others for place in other} >= {0, 4, 9, 13, 96, 100}
    assert all(20 in row or 46 in row for row in tried.tolist())
    # A run that may score nothing more is given back.
    assert jump(objective, stuck, 0) is stuck


def test_a_jump_takes_the_largest_gain_of_its_round() -> None:
    objective = line([20, 91], barrier=1e6)
    objective.at_once = 1
    stuck = started(objective, [20, 46])
    run = jump(objective, stuck, 1, finest=1000)
    assert run.layouts[1].tolist() == [20, 91]
    assert run.evaluations == 1 + 48


def test_the_paper_s_search_varies_a_layout_less_while_nothing_gains_and_gives_up() -> None:
    """From 101 places and 2 sensors the increment is 25.25, and times 0.6 eight times it is below 0.5."""
    objective = line([30, 60])
    run = paper_search(objective, started(objective, [30, 60]), np.random.default_rng(3))
    shrinks = 1 + int(np.ceil(np.log(0.5 / 25.25) / np.log(0.6)))
    assert len(run.scores) == 1 + shrinks - 1 + 5
    assert run.evaluations == 1 + 36 * (len(run.scores) - 1) == len(objective.asked)
    first = np.array(objective.asked[1:37]) - [30, 60]
    moved = (first != 0).sum(axis=1)
    # A third of the clones move all sensors, a third one, a third two; here, all are two. None stays where it was,
    # but at the ends.
    assert np.bincount(moved, minlength=3)[1] >= 12
    assert (moved > 0).all()
    assert 10 < first.std() < 40
    last = np.array(objective.asked[-36:]) - [30, 60]
    assert np.abs(last).max() <= 3


def test_of_the_clones_a_third_move_all_sensors_a_third_one_and_a_third_two() -> None:
    """In the last round the increment is half a place, and a sensor that is to move moves."""
    objective = line([20, 50, 80])
    paper_search(objective, started(objective, [20, 50, 80]), np.random.default_rng(3))
    steps = np.array(objective.asked[-36:]) - [20, 50, 80]
    assert (steps != 0).sum(axis=1).tolist() == [3, 1, 2] * 12
    assert (steps < 0).sum() == pytest.approx(36, abs=15)


def test_many_sensors_get_eight_clones_each_and_fixed_ones_stay() -> None:
    objective = line([10, 20, 30, 40, 50], fixed=[30])
    run = paper_search(objective, started(objective, [1, 2, 3, 4, 30]), np.random.default_rng(3))
    assert run.layout.tolist() == [10, 20, 30, 40, 50]
    assert objective.batches[1:] == [40] * (len(objective.batches) - 1)
    assert all(30 in layout for layout in objective.asked)
    whole = line([10, 30], fixed=[10, 30])
    assert paper_search(whole, started(whole, [10, 30]), np.random.default_rng(3)).layout.tolist() == [10, 30]


def test_starts_count_once_and_those_that_break_a_rule_not_at_all() -> None:
    told, objective = list[float](), line([7, 40], fixed=[7])
    starts = [np.array(start) for start in ([40, 7], [7, 40], [3, 4], [7, 90])]
    runs = search_from(starts, objective, "paper", 0, told.append)
    assert [run.layouts[0].tolist() for run in runs] == [[7, 40], [7, 90]]
    assert told == pytest.approx([0, 1 / 3, 2 / 3])


def test_only_the_best_run_jumps() -> None:
    objective = line([20, 93], barrier=1e6)
    # Steps of a quarter of equal pitch do not pass the barrier from here; the second is nearer to the target.
    runs = search_from([np.array([15, 30]), np.array([19, 40])], objective, "exchange", 0)
    assert [run.layout.tolist() for run in runs].count([20, 93]) == 1


def test_of_runs_that_are_as_good_the_first_counts() -> None:
    runs = [
        SearchRun((np.array([number]),), (score,), 1) for number, score in enumerate((-3.0, -2.0 - 1e-9, -2.0, -1.9))
    ]
    assert first_best(runs).layout == np.array([3])
    assert first_best(runs[:3]).layout == np.array([1])
    assert first_best([*runs[:1], SearchRun((np.array([9]),), (-2.0 - 1e-8,), 1), runs[2]]).layout == np.array([2])
    assert first_best([SearchRun((np.array([5]),), (0.0,), 1)]).layout == np.array([5])
