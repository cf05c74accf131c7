"""The answers of a posterior graph, from the scores of its cells; see `graph` for the symbols."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.estimators.posterior.force import mass_of, state_force
from beamtouch_models.estimators.posterior.known_force import known_force, state_known_force
from beamtouch_models.estimators.posterior.scoring import Lowest, Scored, state_log_odds
from beamtouch_models.estimators.posterior.tempering import Tempered
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
    kind: DTypeLike = np.float32
    """Number type of sums of widths."""


def state_answers(
    graph: Graph,
    prior: Prior,
    found: Scored,
    lowest: Lowest,
    grid: Grid,
    widened: Tempered | None = None,
    *,
    with_force: bool,
) -> list[str]:
    """Add every answer except for the misfit, and return the names of all outputs."""
    root, force_n = graph.apply("Sqrt", found.precision), prior.force_n
    # Sums of exponentials and their logarithm take less time than the operations that do both.
    exponent = graph.apply("Sub", lowest.cell, found.misfit)
    if not prior.force_is_known and widened is None:
        exponent = graph.apply("Max", exponent, graph.constant(MIN_EXPONENT))
    likely = graph.apply("Mul", graph.apply("Exp", exponent), grid.share)
    state_log_odds(graph, found, likely, lowest.cell)
    other = None
    if prior.force_is_known:
        known = known_force(graph, force_n[1], found, root, lowest, widened)
        both = graph.apply("Add", known.known, known.tails)
        if with_force or widened is not None:
            other = graph.apply("Div", known.tails, both)
        likely = graph.apply("Mul", both, likely if widened is None else grid.share)
        likely = graph.apply("Div", likely, found.widened) if found.widened else likely
    else:
        likely = _of_open_force(graph, force_n, found, root, exponent, likely, grid, widened)
    posterior = graph.apply("LpNormalization", likely, axis=2, p=1)
    posterior = graph.apply("Max", posterior, graph.constant(MIN_MASS))
    contraction = None if widened is None else widened.contraction(posterior, other)
    _state_position(graph, grid, posterior, widened, contraction)
    if not with_force:
        return list(POSITION_OUTPUTS)
    if other is not None:
        state_known_force(graph, force_n[1], found, posterior, other, contraction)
    else:
        state_force(graph, force_n, found, posterior, contraction)
    return [*POSITION_OUTPUTS, *FORCE_OUTPUTS]


def _of_open_force(
    graph: Graph,
    force_n: tuple[float, float],
    found: Scored,
    root: str,
    exponent: str,
    likely: str,
    grid: Grid,
    widened: Tempered | None,
) -> str:
    """Return the likelihood of each cell for the median and for each end of the interval, (batch, 3, N)."""
    mass = mass_of(graph, force_n, root, found.force, widened.widening if widened else None)
    if widened is not None:
        likely = graph.apply("Exp", graph.apply("Div", exponent, widened.widening))
        likely = graph.apply("Mul", likely, grid.share)
    if found.widened is not None:
        likely = graph.apply("Div", likely, found.widened)
    return graph.apply("Mul", graph.apply("Div", likely, root), mass)


def _state_position(
    graph: Graph, grid: Grid, posterior: str, widened: Tempered | None, contraction: str | None
) -> None:
    """Add median and interval from the posteriors over the cells, contracted about their medians if tempered."""
    many = grid.kind == np.float64
    before = graph.apply("CumSum", posterior, graph.index(2), exclusive=1)
    place = _quantile(graph, grid, posterior, before, QUANTILES)
    if widened is not None and contraction is not None:
        median = _quantile(graph, grid, posterior, before, (0.5,) * len(QUANTILES))
        centre = widened.centre(posterior, median) if many else median
        part = graph.apply("Sqrt", graph.apply("Squeeze", contraction, graph.ints(2)))
        part = graph.cast(part, grid.kind) if many else part
        place = graph.apply("Add", centre, graph.apply("Mul", graph.apply("Sub", place, median), part))
    place = graph.cast(place, np.float32) if many else place
    place = graph.apply("Add", place, graph.constant(grid.low_mm)) if grid.low_mm else place
    graph.apply("Gather", place, graph.index(0), axis=1, output=POSITION_OUTPUTS[0])
    graph.apply("ReduceMin", place, axes=[1], keepdims=0, output=POSITION_OUTPUTS[1])
    graph.apply("ReduceMax", place, axes=[1], keepdims=0, output=POSITION_OUTPUTS[2])


def _quantile(graph: Graph, grid: Grid, posterior: str, before: str, levels: tuple[float, ...]) -> str:
    """Return a quantile of each posterior, (batch, 3), from the left end of the range."""
    part = graph.apply("Sub", graph.constant(np.array(levels).reshape(1, -1, 1)), before)
    part = graph.apply("Clip", graph.apply("Div", part, posterior), graph.constant(0.0), graph.constant(1.0))
    along = graph.apply("Mul", part, grid.width)
    # A matrix-vector product of the built-in kernels would be three times slower.
    along = along if grid.kind == np.float32 else graph.cast(along, grid.kind)
    return graph.apply("ReduceSum", along, graph.ints(2), keepdims=0)
