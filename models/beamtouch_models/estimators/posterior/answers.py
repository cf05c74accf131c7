"""The answers of a posterior graph, from the scores of its cells; see `graph` for the symbols."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.estimators.posterior.force import known_force, mass_of, state_force, state_known_force
from beamtouch_models.estimators.posterior.scoring import Scored, state_log_odds
from beamtouch_models.metadata import FORCE_OUTPUTS, POSITION_OUTPUTS

QUANTILES = (0.5, 0.025, 0.975)
"""The median, and the ends of the interval."""
MIN_MASS = 1e-26
"""Keeps the place within an empty cell finite, and avoids subnormal numbers, which are slow."""
MIN_EXPONENT = -50.0
"""Smallest logarithm of a likelihood over the largest, for the same reason; no quantile depends on smaller ones."""


@dataclass(frozen=True)
class Grid:
    """The cells of the position range, from `low_mm` on; names of (1, 1, N) or (batch, 1, N)."""

    width: str
    """w, in mm"""
    share: str
    """s"""
    low_mm: float
    fine: bool = False
    """Whether cells may be so narrow that plain sums in float32 would lose a digit of the interval."""


def state_answers(graph: Graph, prior: Prior, found: Scored, least: str, grid: Grid, *, with_force: bool) -> list[str]:
    """Add every answer except for the misfit, and return the names of all outputs; `least` is the smallest R."""
    root, force_n = graph.apply("Sqrt", found.precision), prior.force_n
    # Sums of exponentials and their logarithm take less time than the operations that do both.
    exponent = graph.apply("Sub", least, found.misfit)
    if not prior.force_is_known:
        exponent = graph.apply("Max", exponent, graph.constant(MIN_EXPONENT))
    likely = graph.apply("Mul", graph.apply("Exp", exponent), grid.share)
    state_log_odds(graph, found, likely, least)
    known = known_force(graph, force_n[1], found, root) if prior.force_is_known else None
    if known:
        likely = graph.apply("Mul", graph.apply("Add", known.known, known.tails), likely)
    if found.widened is not None:
        likely = graph.apply("Div", likely, found.widened)
    if not known:
        mass = mass_of(graph, force_n, root, found.force)
        likely = graph.apply("Mul", graph.apply("Div", likely, root), mass)
    posterior = graph.apply("LpNormalization", likely, axis=2, p=1)
    posterior = graph.apply("Max", posterior, graph.constant(MIN_MASS))
    _state_position(graph, grid, posterior)
    if not with_force:
        return list(POSITION_OUTPUTS)
    if known:
        state_known_force(graph, force_n[1], found, posterior, known)
    else:
        state_force(graph, force_n, found, posterior, fine=grid.fine)
    return [*POSITION_OUTPUTS, *FORCE_OUTPUTS]


def _state_position(graph: Graph, grid: Grid, posterior: str) -> None:
    """Add median and interval from the posteriors over the cells."""
    before = graph.apply("CumSum", posterior, graph.index(2), exclusive=1)
    part = graph.apply("Sub", graph.constant(np.array(QUANTILES).reshape(1, -1, 1)), before)
    part = graph.apply("Clip", graph.apply("Div", part, posterior), graph.constant(0.0), graph.constant(1.0))
    # A matrix-vector product of the built-in kernels would be three times slower.
    along = graph.apply("Mul", part, grid.width)
    along = graph.cast(along, np.float64) if grid.fine else along
    place = graph.apply("ReduceSum", along, graph.ints(2), keepdims=0)
    place = graph.cast(place, np.float32) if grid.fine else place
    place = graph.apply("Add", place, graph.constant(grid.low_mm)) if grid.low_mm else place
    graph.apply("Gather", place, graph.index(0), axis=1, output=POSITION_OUTPUTS[0])
    graph.apply("ReduceMin", place, axes=[1], keepdims=0, output=POSITION_OUTPUTS[1])
    graph.apply("ReduceMax", place, axes=[1], keepdims=0, output=POSITION_OUTPUTS[2])
