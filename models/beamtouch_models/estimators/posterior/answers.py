"""The answers of a posterior graph, from the scores of its cells; see `graph` for the symbols."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.estimators.posterior.force import Posteriors, log_mass, state_force
from beamtouch_models.estimators.posterior.scoring import Scored, state_log_odds
from beamtouch_models.estimators.posterior.tempering import Tempered
from beamtouch_models.metadata import FORCE_OUTPUTS, POSITION_OUTPUTS

QUANTILES = (0.5, 0.025, 0.975, 0.05, 0.95)
"""Of the first posterior, the median; of the second, the ends of the interval and those that keep the median in it."""
SMALLEST_MASS = 1e-26
"""Keeps the place within an empty cell finite, and avoids subnormal numbers, which are slow."""


@dataclass(frozen=True)
class Grid:
    """The cells of the position range, from `low_mm` on; names of (1, 1, N) or (batch, 1, N)."""

    width: str
    """w, in mm"""
    log_share: str
    """log(s)"""
    low_mm: float
    kind: DTypeLike = np.float32
    """Number type of sums of widths."""


def state_answers(
    graph: Graph, prior: Prior, found: Scored, grid: Grid, widened: Tempered | None = None, *, with_force: bool
) -> list[str]:
    """Add every answer except for the misfit, and return the names of all outputs."""
    root = graph.apply("Sqrt", found.precision)
    mass = log_mass(graph, prior.force_n, root, found.force, widened.widening if widened else None)
    weighted = graph.apply("Sub", grid.log_share, found.misfit)
    if found.widened is not None:
        mass = graph.apply("Sub", mass, found.widened)
    state_log_odds(graph, found, weighted)
    if widened is not None:
        weighted = graph.apply("Sub", grid.log_share, graph.apply("Div", found.misfit, widened.widening))
    posterior = _posteriors(graph, prior, weighted, mass, found)
    contraction = None if widened is None else widened.contraction(posterior)
    _state_position(graph, prior, grid, posterior, widened, contraction)
    if not with_force:
        return list(POSITION_OUTPUTS)
    median, ends = (posterior, posterior) if prior.force_is_known else graph.split(posterior, 2, 1)
    if contraction is not None and not prior.force_is_known:
        contraction = graph.split(contraction, 2, 1)[1]
    state_force(graph, prior.force_n, found, root, Posteriors(median, ends, contraction))
    return [*POSITION_OUTPUTS, *FORCE_OUTPUTS]


def _posteriors(graph: Graph, prior: Prior, weighted: str, mass: str, scored: Scored) -> str:
    """Return the posteriors of the median and of the interval, (batch, 2, N); a single one if the force is known."""
    score = graph.apply("Add", weighted, mass)
    if not prior.force_is_known:
        ends = graph.apply("Mul", graph.apply("Log", scored.precision), graph.constant(-0.5))
        ends = graph.apply("Add", weighted, ends)
        if scored.widened is not None:
            ends = graph.apply("Sub", ends, scored.widened)
        score = graph.apply("Concat", score, ends, axis=1)
    every = graph.apply("Softmax", score, axis=2)
    return graph.apply("Max", every, graph.constant(SMALLEST_MASS))


def _state_position(
    graph: Graph, prior: Prior, grid: Grid, posterior: str, widened: Tempered | None, contraction: str | None
) -> None:
    """Add median and interval from the posteriors over the cells, contracted about their medians if tempered."""
    many = grid.kind == np.float64
    before = graph.apply("CumSum", posterior, graph.index(2), exclusive=1)
    known = prior.force_is_known
    rows, levels = graph.ints(*([0] * 3 if known else [0, 1, 1, 1, 1])), QUANTILES[:3] if known else QUANTILES
    if not known:
        posterior, before = (graph.apply("Gather", one, rows, axis=1) for one in (posterior, before))
    place = _quantile(graph, grid, posterior, before, levels)
    if widened is not None and contraction is not None:
        median = _quantile(graph, grid, posterior, before, (0.5,) * len(levels))
        centre = widened.centre(posterior, median) if many else median
        part = graph.apply("Sqrt", graph.apply("Squeeze", contraction, graph.ints(2)))
        part = graph.apply("Gather", part, rows, axis=1)
        part = graph.cast(part, grid.kind) if many else part
        place = graph.apply("Add", centre, graph.apply("Mul", graph.apply("Sub", place, median), part))
    place = graph.cast(place, np.float32) if many else place
    names = (POSITION_OUTPUTS[0] if known else None, *POSITION_OUTPUTS[1:3], None, None)[: len(levels)]
    found = [graph.apply("Gather", place, graph.index(i), axis=1, output=name) for i, name in enumerate(names)]
    if not known:
        middle = graph.apply("Max", found[0], found[3])
        graph.apply("Min", middle, found[4], output=POSITION_OUTPUTS[0])


def _quantile(graph: Graph, grid: Grid, posterior: str, before: str, levels: tuple[float, ...]) -> str:
    """Return a quantile of each posterior, (batch, 5)."""
    part = graph.apply("Sub", graph.constant(np.array(levels).reshape(1, -1, 1)), before)
    part = graph.apply("Clip", graph.apply("Div", part, posterior), graph.constant(0.0), graph.constant(1.0))
    along = graph.apply("Mul", part, grid.width)
    # A matrix-vector product of the built-in kernels would be three times slower.
    along = along if grid.kind == np.float32 else graph.cast(along, grid.kind)
    place = graph.apply("ReduceSum", along, graph.ints(2), keepdims=0)
    return graph.apply("Add", place, graph.constant(grid.low_mm, grid.kind)) if grid.low_mm else place
