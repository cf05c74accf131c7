"""The misfit of the best force of each cell, and the log odds of contact; see `graph` for the symbols."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.forces import MAX_FORCE_RATIO
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.metadata import INPUTS

MIN_PRECISION = np.pi / MAX_FORCE_RATIO**2
"""Added to a, over the square of the largest force: a cell that says nothing of the force has a best force, too."""
FLATTEST = 1e-26
"""Smallest curvature or square of a change, so that nothing is divided by 0."""
WIDEST = 1e4
"""Samples are clipped to this multiple of the largest deflection, so that nothing overflows."""


@dataclass(frozen=True)
class Whitened:
    """Names of the sample, and of the sample and its whitening over the root of 2."""

    reading: str
    """z, bounded, (batch, channels)"""
    sample: str
    """y, (batch, channels, 1)"""
    whitening: str
    """(batch, channels, channels), over the root of 2"""


@dataclass(frozen=True)
class Scored:
    """Names of results, (batch, 1, N) unless stated otherwise."""

    sample: str
    """y, (batch, channels, 1)"""
    own: str
    """y as each cell sees it, (batch, channels, 1) or (batch, channels, N): in the deviations of the cell."""
    shape: str
    """H, (batch, channels, N)"""
    precision: str
    """a"""
    force: str
    """f"""
    misfit: str
    """R, half the misfit"""
    widened: str | None
    """Factor by which the mounting of the sensors widens the errors; None if it does not."""


def whitened(graph: Graph, largest_mm: float) -> Whitened:
    """Whiten the sample; `largest_mm` is the largest deflection of the scene."""
    deflection, given = INPUTS
    bound = WIDEST * largest_mm
    whitening = graph.apply("Mul", given, graph.constant(0.5**0.5))
    reading = graph.apply("Clip", deflection, graph.constant(-bound), graph.constant(bound))
    sample = graph.apply("MatMul", whitening, graph.apply("Unsqueeze", reading, graph.ints(2)))
    return Whitened(reading, sample, whitening)


def scored(graph: Graph, seen: Whitened, largest_n: float, influence: str, uncertain: str | None) -> Scored:
    """Return the misfit of the best force of each cell.

    `influence` is (channels, N) or (batch, channels, N) in mm/N, and `uncertain` the square of its deviation.
    """
    sample, shape = seen.sample, graph.apply("MatMul", seen.whitening, influence)
    if uncertain is None:
        return Scored(sample, sample, shape, *_fitted(graph, sample, shape, largest_n), None)
    # The likeliest force says how much the mounting of the sensors adds to the variance of each channel.
    _, force, _ = _fitted(graph, sample, shape, largest_n)
    given = INPUTS[1]
    moved = graph.apply("MatMul", graph.apply("Mul", given, given), uncertain)
    moved = graph.apply("Mul", moved, graph.apply("Mul", force, force))
    wider = graph.apply("Sqrt", graph.apply("Add", moved, graph.constant(1.0)))
    shape = graph.apply("Div", shape, wider)
    each = graph.apply("Div", sample, wider)
    found = _fitted(graph, each, shape, largest_n, own=True)
    return Scored(sample, each, shape, *found, graph.apply("ReduceProd", wider, axes=[1], keepdims=1))


def _fitted(graph: Graph, sample: str, shape: str, largest_n: float, *, own: bool = False) -> tuple[str, str, str]:
    """Return precision, best force and half the misfit of each cell; `own`: each cell has its own sample."""
    if own:
        along = graph.apply("ReduceSum", graph.apply("Mul", shape, sample), graph.ints(1), keepdims=1)
    else:
        along = graph.apply("MatMul", graph.apply("Transpose", sample, perm=[0, 2, 1]), shape)
    precision = graph.apply("ReduceSumSquare", shape, axes=[1], keepdims=1)
    precision = graph.apply("Add", precision, graph.constant(MIN_PRECISION / largest_n**2))
    force = graph.apply("Div", along, precision)
    force = graph.apply("Clip", force, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * largest_n))
    residual = graph.apply("Sub", sample, graph.apply("Mul", force, shape))
    return precision, force, graph.apply("ReduceSumSquare", residual, axes=[1], keepdims=1)


@dataclass(frozen=True)
class Lowest:
    """Names of the smallest of a row of squares, (batch, 1, 1)."""

    cell: str
    """The smallest at the middle of a cell."""
    twice: str
    """Twice the smallest over the position: that of a parabola through the best three cells, which are neighbours."""


def lowest_of(graph: Graph, squares: str) -> Lowest:
    """Return the smallest of squares (batch, 1, N)."""
    three = graph.top(squares, 3, 2, largest=False)
    # Least value, twice that, slope and curvature, scaled so that the parabola is lowest at 2 R - slope^2 / curvature.
    parabola: Floats = np.array([[1.0, 2.0, 0.0, -2.0], [0.0, 0.0, -0.5, 1.0], [0.0, 0.0, 0.5, 1.0]])
    least, value, slope, curvature = graph.split(graph.apply("MatMul", three, graph.constant(parabola)), 4, 2)
    # Of the smallest of three, the curvature is at least twice the slope, but for rounding.
    curvature = graph.apply("Max", curvature, slope, graph.constant(FLATTEST))
    drop = graph.apply("Mul", slope, graph.apply("Div", slope, curvature))
    return Lowest(least, graph.apply("Sub", value, drop))


def state_log_odds(graph: Graph, scored: Scored, likely: str, least: str) -> None:
    """Add the log odds of contact; `likely` is s_i exp(least R - R_i)."""
    axes = graph.ints(1, 2)
    touched = graph.apply("ReduceLogSum", likely, axes=[1, 2], keepdims=1)
    rest = graph.apply("ReduceSumSquare", scored.sample, axes=[1, 2], keepdims=1)
    odds = graph.apply("Add", touched, graph.apply("Sub", rest, least))
    graph.apply("Squeeze", odds, axes, output="contact_log_odds")
