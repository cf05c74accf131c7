"""Parts of the posterior graph by themselves: the ends of intervals, and the least of squares over the position."""

from collections.abc import Callable

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.estimators.onnx_graph import Graph, model, to_bytes
from beamtouch_models.design.estimators.posterior.answers import lowest_of, reaching
from beamtouch_models.runtime.metadata import INPUTS
from beamtouch_models.runtime.session import runner

GIVEN = INPUTS[0]


def run(numbers: list[list[float]], build: Callable[[Graph], list[str]]) -> list[Floats]:
    """Return the outputs of a graph that is built on numbers (batch, n), which stand for a deflection."""
    graph = Graph()
    outputs = [graph.apply("Identity", name, output=f"out_{place}") for place, name in enumerate(build(graph))]
    given = np.array(numbers)
    answers = runner(to_bytes(model(graph, given.shape[1], outputs)))(given, np.zeros((*given.shape, given.shape[1])))
    return [answers[name].astype(np.float64) for name in outputs]


QUANTILES = {
    # Median, 2.5 %, 97.5 %, 3.5 % and 96.5 % of the way along 100 mm; then what is stated.
    "in the middle": ([51.0, 40.0, 62.0, 41.0, 60.0], [51.0, 40.0, 62.0]),
    # It leaves out twice what the other end has between its quantiles: that end takes the inner one.
    "at the low end": ([20.0, 2.0, 50.0, 2.5, 49.0], [20.0, 0.0, 49.0]),
    # 4.5 times is halfway between 3 and 6.
    "near the low end": ([20.0, 4.5, 50.0, 5.0, 49.0], [20.0, 2.25, 49.5]),
    "no longer near it": ([20.0, 6.1, 50.0, 7.0, 49.0], [20.0, 6.1, 50.0]),
    "at the high end": ([80.0, 50.0, 98.0, 51.0, 97.5], [80.0, 51.0, 100.0]),
    "near the high end": ([80.0, 50.0, 95.5, 51.0, 95.0], [80.0, 50.5, 97.75]),
    "anywhere": ([50.0, 2.5, 97.5, 3.5, 96.5], [50.0, 0.0, 100.0]),
    "near both ends": ([50.0, 9.0, 86.0, 13.0, 84.0], [50.0, 0.5 * (9.0 + (5 / 6) * 4.0), 100 - (14 + 0.5 * 2.0) / 6]),
}


@pytest.mark.parametrize("case", QUANTILES)
def test_an_interval_goes_on_to_an_end_of_the_range_that_it_nearly_reaches(case: str) -> None:
    quantiles, stated = QUANTILES[case]
    (found,) = run([quantiles, QUANTILES["in the middle"][0]], lambda graph: [reaching(graph, GIVEN, (7.0, 107.0))])
    assert found[0] == pytest.approx(7 + np.array(stated), abs=1e-4)
    assert found[1] == pytest.approx([58.0, 47.0, 69.0], abs=1e-4)


@pytest.mark.parametrize("case", QUANTILES)
def test_of_two_axes_each_reaches_to_the_ends_of_its_own_range(case: str) -> None:
    quantiles, stated = QUANTILES[case]

    def build(graph: Graph) -> list[str]:
        place = graph.apply("Reshape", GIVEN, graph.ints(-1, 2, 5))
        return [reaching(graph, place, (-30.0, 70.0), (7.0, 107.0))]

    (found,) = run([[*QUANTILES["at the low end"][0], *quantiles]], build)
    assert found[0, 0] == pytest.approx([-10.0, -30.0, 19.0], abs=1e-4)
    assert found[0, 1] == pytest.approx(7 + np.array(stated), abs=1e-4)


@pytest.mark.parametrize(("low_mm", "high_mm"), [(0.1, 0.7), (0.3, 0.6), (60.3, 939.7)])
def test_an_end_of_the_range_is_never_rounded_past_a_contact_there(low_mm: float, high_mm: float) -> None:
    share = np.array(QUANTILES["anywhere"][0]) / 100
    (found,) = run([list(share * (high_mm - low_mm))], lambda graph: [reaching(graph, GIVEN, (low_mm, high_mm))])
    low, high = found[0, 1:].astype(np.float32)
    assert float(low) <= low_mm < float(np.nextafter(low, np.float32(np.inf)))
    assert float(np.nextafter(high, np.float32(-np.inf))) < high_mm <= float(high)


def test_the_least_square_over_the_position_is_that_of_a_parabola_through_the_best_three_cells() -> None:
    cells = np.arange(12.0)
    rows = [30.0 + 1.7 * (cells - 5.3) ** 2, 4.0 + 0.9 * (cells - 7.8) ** 2, 11.0 + 2.0 * (cells - 3.0) ** 2]

    def build(graph: Graph) -> list[str]:
        return list(lowest_of(graph, graph.apply("Unsqueeze", GIVEN, graph.ints(1))))

    least, twice = run([list(row) for row in rows], build)
    assert least.ravel() == pytest.approx([row.min() for row in rows], rel=1e-6)
    assert twice.ravel() == pytest.approx([60.0, 8.0, 22.0], rel=1e-5)
