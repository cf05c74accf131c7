"""The cells of the position range, and the posterior on cells that are the same for every sample."""

from dataclasses import dataclass

import numpy as np
import onnx

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.onnx_graph import Graph, model
from beamtouch_models.design.estimators.posterior.answers import Grid, likely_misfit, lowest_of, state_answers
from beamtouch_models.design.estimators.posterior.fitted_cells import scored, whitened
from beamtouch_models.places import on_axis

FINE = 20_001
"""Positions from which the spacing of the cells is computed."""
LOUDNESS = (60.0, 600.0)
"""Ratios of the largest deflection to the noise; above each, the ends of the beam need the next number in MIN_CELLS."""
MIN_CELLS = (128, 192, 256)
STEP, MAX_CELLS = 64, 512
"""The number of cells is a multiple of STEP. Above MAX_CELLS, a window around the contact takes less time, and sums of
widths in float32 would lose a digit of the interval."""
POSITION_SHARE = (0.5, 1.0)
"""For an exact and an open force: weight of an even spacing relative to the change of the sample."""
SIZE_SHARE = (0.0, 0.05)
"""Likewise: weight of a change in the logarithm of the deflection's size."""
FLOOR = 1e-4
"""Smallest deflection, relative to the largest, whose direction counts."""
LARGEST_STEP = (1.2, 2.5)
"""Likewise: largest cell in deviations of the posterior, for sums over cells to be right."""
SHARP = 12.0
"""Precision over that of the force with which the ends of a posterior that is as wide as the range are resolved."""


@dataclass(frozen=True)
class Cells:
    """Cells of the position range, side by side."""

    edges_mm: Floats
    """(cells + 1,)"""
    influence: Floats
    """(cells, channels) mm/N, at the middles of the cells: half way in the change of the sample."""
    variance: Floats | None
    """(cells, channels) (mm/N)^2, of the influence at the middles; None if the sensors' positions are exact."""


@dataclass(frozen=True)
class InfluencePath:
    """The influence along the position range, and how far a contact of the largest force moves the sample there."""

    position_mm: Floats
    """(positions,)"""
    influence: Floats
    """(positions, channels) mm/N"""
    moved: Floats
    """(positions - 1,) change that no likely force explains, in deviations, floor included."""
    size: Floats
    """(positions,) size of the sample, in deviations."""


def resolving_cells(prior: Prior) -> int | None:
    """Return how many cells keep the error at the limit; None if MAX_CELLS do not.

    The sample follows a curve as the contact moves; no cell may be a longer piece of it than its step.
    """
    path, largest = influence_path_of(prior), _between(LARGEST_STEP, prior)
    along = np.concatenate([[0.0], np.cumsum(path.moved)])
    least = MIN_CELLS[int(np.searchsorted(LOUDNESS, float(path.size.max())))]
    for count in range(least, MAX_CELLS + 1, STEP):
        edges = np.searchsorted(path.position_mm, cells_of(prior, count, path).edges_mm).clip(0, FINE - 1)
        if float(np.diff(along[edges]).max()) <= largest:
            return count
    return None


def influence_path_of(prior: Prior) -> InfluencePath:
    """Return the path of a prior's sample."""
    fine = np.linspace(*prior.extent.range_mm, FINE)
    influence = prior.influence_table(on_axis(fine))
    force = prior.force_n[1]
    deviation = prior.tabled_deviation_mm(on_axis(fine), force)
    within = (deviation[1:] + deviation[:-1]) / 2
    shape = force * (influence[1:] + influence[:-1]) / 2 / within
    change = force * np.diff(influence, axis=0) / within
    size = np.linalg.norm(force * influence / deviation, axis=1)
    square = (shape**2).sum(axis=1) + (FLOOR * size.max()) ** 2
    along = (change * shape).sum(axis=1)
    change -= shape * (along / square)[:, None]
    # The change along the sample itself counts as far as the force does not explain it.
    precision = SHARP * force**2 * prior.force_range.precision_per_n2
    left = along / np.sqrt(square) * np.sqrt(precision / (square + precision))
    return InfluencePath(fine, influence, np.hypot(np.linalg.norm(change, axis=1), left), size)


def _between(exact_and_open: tuple[float, float], prior: Prior) -> float:
    """Return the value for the force of a prior from those for an exact and an open one."""
    return float(np.interp(prior.force_range.openness, (0.0, 1.0), exact_and_open))


def cells_of(prior: Prior, count: int, path: InfluencePath | None = None) -> Cells:
    """Return `count` cells, spaced evenly in a metric of the change of sample, position and log of the size."""
    path = path or influence_path_of(prior)
    metric = path.moved**2 + (path.moved.sum() * _between(POSITION_SHARE, prior) / (FINE - 1)) ** 2
    size = np.hypot(path.size, FLOOR * path.size.max())
    metric += (_between(SIZE_SHARE, prior) * path.size.max() * np.diff(np.log(size))) ** 2
    along = np.concatenate([[0.0], np.cumsum(np.sqrt(metric))])
    marks = np.linspace(0, along[-1], 2 * count + 1)
    table = np.stack([np.interp(marks, along, column) for column in path.influence.T], axis=1)
    places = np.interp(marks, along, path.position_mm)
    variance = None if prior.variance_table is None else prior.variance_table(on_axis(places[1::2]))
    return Cells(places[::2], table[1::2], variance)


def fixed_cells_graph(prior: Prior, count: int, *, with_force: bool) -> onnx.ModelProto:
    """Return the graph on `count` cells that are the same for every sample."""
    graph, cells = Graph(), cells_of(prior, count)
    variance = None if cells.variance is None else graph.constant(cells.variance.T)
    seen = whitened(graph, prior.largest_mm)
    fit = scored(graph, seen, prior, graph.constant(cells.influence.T), variance)
    least, misfit = lowest_of(graph, likely_misfit(graph, prior.force_range, fit))
    if not prior.force_range.is_open:
        least = graph.apply("ReduceMin", fit.misfit, axes=[1, 2])
    # Rounding may put the bottom below 0.
    graph.apply("ReduceL1", misfit, axes=[1, 2], keepdims=0, output="misfit")
    width = np.diff(cells.edges_mm)
    share = np.maximum(width / width.sum(), np.finfo(np.float32).tiny)
    grid = Grid(graph.constant(width), graph.constant(share), float(cells.edges_mm[0]))
    outputs = state_answers(graph, prior, fit, least, grid, with_force=with_force)
    return model(graph, prior.channels, outputs)
