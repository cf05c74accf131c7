"""Figures 5 and 6 of the reproduction, of searches whose course is known."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.placement.search import SearchRun
from beamtouch_models.lab.reproduction import figures
from beamtouch_models.lab.reproduction.figures import figures_5_and_6
from beamtouch_models.lab.reproduction.paper import Figure

EQUAL_MM = [44, 89, 133, 178, 222, 267, 311, 356]
"""Eight sensors at equal pitch, on the grid."""
PAPERS_MM = [68, 69, 156, 157, 243, 244, 331, 332]
"""Read off the paper's figure 5."""
GRID_MM = np.arange(1.0, 400.0)
"""Where the paper's sensors may be."""


@dataclass
class Searches:
    """Stands for the paper's searches: the first ends at some positions, and others where they began.

    They have a step for each score but the first.
    """

    end_mm: Sequence[int]
    scores: list[list[float]]

    def __post_init__(self) -> None:
        self.starts = list[SearchRun]()
        self.drawn = list[float]()

    def __call__(self, _product: object, start: SearchRun, rng: np.random.Generator) -> SearchRun:
        scores = self.scores[len(self.starts)]
        self.starts.append(start)
        self.drawn.append(float(rng.random()))
        steps = [EQUAL_MM] * (len(scores) - 1) + [self.end_mm if len(self.starts) == 1 else EQUAL_MM]
        return SearchRun(tuple(np.searchsorted(GRID_MM, step) for step in steps), tuple(scores), 1)


def shown(monkeypatch: pytest.MonkeyPatch, searches: Searches, seed: int = 3) -> tuple[Figure, Figure]:
    monkeypatch.setattr(figures, "paper_search", searches)
    monkeypatch.setattr(figures, "OTHER_SEEDS", len(searches.scores) - 1)
    return figures_5_and_6(seed)


def gaining(steps: int, idle: int = 0) -> list[float]:
    """Return scores that grow so many times, less and less, and then stay."""
    grown = [-60 - 4 * 0.5**step for step in range(steps + 1)]
    return grown + grown[-1:] * idle


def verdicts(figure: Figure) -> dict[str, bool]:
    return {row.quantity: row.verdict == "agrees" for row in figure.rows if row.paper}


PLACES, PAIRS, SYMMETRIC, ITERATIONS = (
    "fig. 5: positions that eight sensors converge to, mm",
    "fig. 5: eight sensors merge into four",
    "fig. 5: symmetric about the middle of the beam",
    "fig. 6: iterations to convergence",
)


@pytest.mark.parametrize(
    ("end_mm", "off_mm", "pair_mm", "asymmetry_mm"),
    [
        (PAPERS_MM, 0, 1, 0),
        ([68, 69, 156, 156, 243, 244, 331, 332], 1, 1, 1),
        ([66, 67, 156, 157, 243, 244, 331, 332], 2, 1, 2),
        ([65, 66, 156, 157, 243, 244, 331, 332], 3, 1, 3),
        ([68, 69, 156, 157, 243, 244, 331, 333], 1, 2, 1),
        ([68, 69, 156, 157, 240, 244, 331, 332], 3, 4, 3),
    ],
)
def test_positions_agree_up_to_a_millimetre_and_their_symmetry_up_to_two(
    monkeypatch: pytest.MonkeyPatch, end_mm: list[int], off_mm: int, pair_mm: int, asymmetry_mm: int
) -> None:
    fifth, _ = shown(monkeypatch, Searches(end_mm, [gaining(19, idle=4), gaining(3)]))
    numbers = fifth.numbers
    assert [numbers[name] for name in ("off_mm", "pair_mm", "asymmetry_mm")] == [off_mm, pair_mm, asymmetry_mm]
    said = {PLACES: off_mm <= 1, PAIRS: pair_mm <= 1, SYMMETRIC: asymmetry_mm <= 2, ITERATIONS: True}
    assert verdicts(fifth) == said
    assert numbers["places"] == ", ".join(map(str, end_mm))


@pytest.mark.parametrize(
    ("end_mm", "groups"), [(PAPERS_MM, 4), ([60, 70, 80, 91, 200, 300, 310, 321], 5), (list(range(30, 110, 10)), 1)]
)
def test_sensors_up_to_a_centimetre_apart_are_one_group(
    monkeypatch: pytest.MonkeyPatch, end_mm: list[int], groups: int
) -> None:
    fifth, _ = shown(monkeypatch, Searches(end_mm, [gaining(19)]))
    assert fifth.numbers["groups"] == groups


@pytest.mark.parametrize(("gains", "agree"), [(13, False), (16, True), (20, True), (24, True), (27, False)])
def test_iterations_are_counted_up_to_the_last_gain_and_agree_near_twenty(
    monkeypatch: pytest.MonkeyPatch, gains: int, agree: bool
) -> None:
    fifth, _ = shown(monkeypatch, Searches(PAPERS_MM, [gaining(gains, idle=5), gaining(31, idle=2), gaining(9)]))
    numbers: dict[str, Any] = fifth.numbers
    assert numbers["iterations"] == [gains, 31, 9]
    assert (numbers["fewest"], numbers["most"], numbers["searches"]) == (9, 31, 3)
    assert verdicts(fifth)[ITERATIONS] == agree


def test_searches_start_at_equal_pitch_each_with_a_seed_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    searches = Searches(PAPERS_MM, [gaining(19)] * 4)
    shown(monkeypatch, searches, seed=3)
    assert searches.drawn == [np.random.default_rng(seed).random() for seed in (3, 4, 5, 6)]
    for start in searches.starts:
        ((layout,), (score,), evaluations) = start.layouts, start.scores, start.evaluations
        assert evaluations == 1
        assert GRID_MM[layout].tolist() == EQUAL_MM
        # Of the four largest eigenvalues.
        assert score == pytest.approx(np.log(eigenvalues(EQUAL_MM)[:4]).sum(), abs=1e-6)


def eigenvalues(sensor_mm: Sequence[float]) -> Floats:
    """Eigenvalues of eq. 2, descending, from eq. 1 with a Macaulay bracket and numpy's symmetric solver."""
    x, a = np.array(sensor_mm)[None, :] / 400, np.arange(1.0, 400.0)[:, None] / 400
    matrix = -((2 - a) * (a - 1) * a * x + (1 - a) * x**3 - np.maximum(x - a, 0) ** 3) / 6
    found: Floats = np.linalg.eigvalsh(matrix.T @ matrix / 399)[::-1]
    return found


def test_figure_5_has_a_track_for_each_sensor_and_the_papers_places_at_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    end_mm = [60, 70, 150, 160, 240, 250, 330, 340]
    fifth, _ = shown(monkeypatch, Searches(end_mm, [gaining(6)]))
    *tracks, read_off = fifth.chart.series
    for start_mm, last_mm, track in zip(EQUAL_MM, end_mm, tracks, strict=True):
        assert (list(track.x), list(track.y)) == ([start_mm] * 6 + [last_mm], [0, 1, 2, 3, 4, 5, 6])
    assert len({track.colour for track in tracks}) == 8
    assert (list(read_off.x), list(read_off.y), read_off.style) == (PAPERS_MM, [6] * 8, "ring")
    assert fifth.chart.x_range == (0.0, 400.0)


@pytest.mark.parametrize(
    ("scores", "half", "falls"),
    [
        ([0.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0], 1, True),
        ([0.0, 0.2, 2.0, 2.0, 2.0, 2.0, 2.0], 2, True),  # of six iterations
        ([0.0, 0.1, 0.2, 2.0, 2.0, 2.0, 2.0], 3, False),
        ([0.0, 1.9, 1.8, 2.0, 2.0, 2.0, 2.0], 1, False),
    ],
)
def test_the_performance_falls_steadily_and_half_of_the_way_in_the_first_third(
    monkeypatch: pytest.MonkeyPatch, scores: list[float], half: int, falls: bool
) -> None:
    _, sixth = shown(monkeypatch, Searches(PAPERS_MM, [scores, gaining(4)]))
    numbers = sixth.numbers
    assert (numbers["half"], verdicts(sixth)) == (half, {"fig. 6: course of the performance value m": falls})
    # The inverse product of eigenvalues, of whose logarithm the score is the sum.
    assert numbers["first_over_last"] == pytest.approx(np.exp(2.0), rel=1e-6)
    assert numbers["log_eigenvalue_product"] == [0.0, 2.0]
    course, converged = sixth.chart.series
    assert list(course.x) == [0, 1, 2, 3, 4, 5, 6]
    assert list(course.y) == pytest.approx([np.exp(2.0 - score) for score in scores], rel=1e-6)
    assert (list(converged.x), converged.style) == ([20, 20], "dashed")
    assert list(converged.y) == [1.0, pytest.approx(np.exp(2.0))]
    assert course.colour != converged.colour
    assert sixth.chart.whole_x
