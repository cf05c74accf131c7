"""The first half of a graph: the force that fits a sample best in each cell, and what it leaves of the sample.

`answers` has the formulas; here are its y, H, a, f and R, with influence that is uncertain.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import MAX_FORCE_RATIO, Prior
from beamtouch_models.design.estimators.onnx_graph import Graph
from beamtouch_models.runtime.metadata import INPUTS

MIN_PRECISION = np.pi / MAX_FORCE_RATIO**2
"""Added to a, over the square of the largest force: a cell that says nothing of the force has a best force, too."""
WIDEST = 1e4
"""Samples are clipped to this multiple of the largest deflection, so that nothing overflows."""


@dataclass(frozen=True)
class Whitened:
    """Names of the sample, and of the sample and its whitening over the root of 2."""

    bounded: str
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
    residual: str
    """y - f H, (batch, channels, N)"""
    misfit: str
    """R, half the misfit"""
    widened: str | None
    """Factor by which the mounting of the sensors widens the errors; None if it does not."""


def whitened(graph: Graph, largest_mm: float) -> Whitened:
    """Whiten the sample; `largest_mm` is the largest deflection of the scene."""
    deflection, given = INPUTS
    bound = WIDEST * largest_mm
    whitening = graph.apply("Mul", given, graph.constant(0.5**0.5))
    bounded = graph.apply("Clip", deflection, graph.constant(-bound), graph.constant(bound))
    sample = graph.apply("MatMul", whitening, graph.apply("Unsqueeze", bounded, graph.ints(2)))
    return Whitened(bounded, sample, whitening)


def scored(graph: Graph, seen: Whitened, prior: Prior, influence: str, variance: str | None) -> Scored:
    """Return the misfit of the best force of each cell.

    `influence` is (channels, N) or (batch, channels, N) in mm/N, and `variance` that by mounting and interpolation.
    """
    largest_n, shared = prior.force_n[1], prior.shared
    sample, shape = seen.sample, graph.apply("MatMul", seen.whitening, influence)
    if variance is None:
        return Scored(sample, sample, shape, *_fitted(graph, sample, shape, largest_n), None)
    # The likeliest force says how much the mounting of the sensors adds to the variance of each channel.
    _, force, *_ = _fitted(graph, sample, shape, largest_n)
    own_variance = variance
    if shared is not None:
        own_variance = graph.apply("Mul", variance, graph.constant(1 - (shared**2).sum(axis=1)[:, None]))
    wider = widening(graph, force, own_variance)
    vectors = [graph.apply("Div", vector, wider) for vector in (shape, sample)]
    volume = graph.apply("ReduceProd", wider, axes=[1])
    if shared is not None:
        sources = _sources(graph, force, variance, shared)
        vectors += [graph.apply("Div", source, wider) for source in sources]
        for _ in sources:
            root, vectors = _without_source(graph, vectors)
            volume = graph.apply("Mul", volume, root)
    shape, own = vectors
    return Scored(sample, own, shape, *_fitted(graph, own, shape, largest_n, own=True), volume)


def _sources(graph: Graph, force: str, variance: str, shared: Floats) -> list[str]:
    """Return the errors by which each source moves the whitened sample, (batch, channels, N)."""
    moved = graph.apply("Mul", force, graph.apply("Sqrt", variance))
    return [
        graph.apply("MatMul", INPUTS[1], graph.apply("Mul", moved, graph.constant(loading[:, None])))
        for loading in shared.T
    ]


def _without_source(graph: Graph, vectors: list[str]) -> tuple[str, list[str]]:
    """Return (1 + c'c)^1/2, and (I + c c')^-1/2 of all vectors but the last one, which is the source c."""
    *others, source = vectors
    one, axes = graph.constant(1.0), graph.ints(1)
    square = graph.apply("ReduceSumSquare", source, axes=[1])
    root = graph.apply("Sqrt", graph.apply("Add", square, one))
    part = graph.apply("Div", source, graph.apply("Mul", root, graph.apply("Add", root, one)))

    def less(vector: str) -> str:
        along = graph.apply("ReduceSum", graph.apply("Mul", vector, source), axes)
        return graph.apply("Sub", vector, graph.apply("Mul", part, along))

    return root, [less(vector) for vector in others]


def widening(graph: Graph, force: str, variance: str) -> str:
    """Return the factors by which the mounting of the sensors widens the errors, (batch, channels, N).

    Only the diagonal of its covariance is taken, as in `likelihood.log_density`; sources that channels share come
    behind it.

    `force` is (batch, 1, N) or one number, and `variance` as that of `scored`.
    """
    given = INPUTS[1]
    moved = graph.apply("MatMul", graph.apply("Mul", given, given), variance)
    moved = graph.apply("Mul", moved, graph.apply("Mul", force, force))
    return graph.apply("Sqrt", graph.apply("Add", moved, graph.constant(1.0)))


def _fitted(graph: Graph, sample: str, shape: str, largest_n: float, *, own: bool = False) -> tuple[str, str, str, str]:
    """Return precision, best force, residual and half the misfit of each cell; `own`: each cell has its own sample."""
    if own:
        along = graph.apply("ReduceSum", graph.apply("Mul", shape, sample), graph.ints(1))
    else:
        along = graph.apply("MatMul", graph.apply("Transpose", sample, perm=[0, 2, 1]), shape)
    precision = graph.apply("ReduceSumSquare", shape, axes=[1])
    precision = graph.apply("Add", precision, graph.constant(MIN_PRECISION / largest_n**2))
    force = graph.apply("Div", along, precision)
    force = graph.apply("Clip", force, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * largest_n))
    residual = graph.apply("Sub", sample, graph.apply("Mul", force, shape))
    return precision, force, residual, graph.apply("ReduceSumSquare", residual, axes=[1])
