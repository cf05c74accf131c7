"""Windows around places, and the posterior on a few cells there: for a posterior that no fixed cells resolve.

A first stage names nodes of a table of the influence along the range. Positions count nodes, z is the sample and W its
whitening.

    n = the node for z                               g = influence, t = its change per node, both at n
    H = W g    T = W t, without its part along H     f = H . W z / |H|^2
    d = T . (W z - f H) / (f |T|^2)                  a Gauss-Newton step
    s = 1 / (f |T|)                                  the deviation of its end
    a, b = n + d -+ (WITHIN s + DOUBTED |d|)         the window

Where two places bend the beam nearly alike, as on either side of a support, the posterior has two narrow peaks. So
there are two windows, around the two places that explain the sample best, neither of them beside a better one.

A force that is not open is told by the size of the reading as well, which tells the place more narrowly. In its windows
the stated range counts as one more channel, which reads the force (`ForceRange.precision_per_n2`); one window for any
force remains, for a sample of another force.

The mounting of the sensors widens the errors in all of these, as in `posterior.answers`.

Each window has CELLS even cells, and each stretch between two places at which the beam is held OUTER. The edges of all,
in order, are those of the cells on which the posterior is computed as in `posterior.answers`. They follow the sample,
its covariance and the channels that work, and are a fraction of a deviation wide. The misfit is that of the best cell.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import onnx

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.onnx_graph import Graph, model
from beamtouch_models.design.estimators.posterior.answers import MIN_MASS, Grid, likely_misfit, state_answers
from beamtouch_models.design.estimators.posterior.cells import (
    cells_of,
    fixed_cells_graph,
    influence_path_of,
    resolving_cells,
)
from beamtouch_models.design.estimators.posterior.fitted_cells import Scored, Whitened, scored, whitened, widening
from beamtouch_models.design.estimators.posterior.plane import plane_graph
from beamtouch_models.places import on_axis

SAGITTA = 0.01
"""Error of a straight line between two nodes that is aimed at, in deviations of the loudest contact.

Where the path turns fastest it is larger: up to 0.3 on the shipped scenes, which neither error nor coverage shows.
"""
NODES = (128, 8192)
"""Smallest and largest number of steps between nodes."""
FULL_TURN = 2.5
"""Typical length of the path of the direction, in radians."""
CELLS, OUTER = 64, 64
"""Cells of each window, and of each stretch of the range."""
HELD = 0.05
"""Below this share of the largest size of a reading, a least one marks a place at which the beam is held."""
WITHIN = 6.0
"""Half the window, in deviations of the position."""
DOUBTED = 0.25
"""Half the window, as a share of the last step; the error that a step leaves is a small part of it."""
STEPS = 2
"""Gauss-Newton steps: where little noise moves the window, the first one errs."""
SCANNED = 512
"""Most nodes that a scan looks at; the steps from the nearest of them arrive."""
TINY = 1e-26
"""Keeps divisors off zero."""
LOWEST = float(np.finfo(np.float32).min)
"""Height of a node that is no peak."""


@dataclass(frozen=True)
class Table:
    """The influence at nodes along the position range."""

    position_mm: Floats
    """(nodes,)"""
    influence: Floats
    """(nodes, channels) mm/N"""
    variance: Floats | None
    """(nodes, channels) (mm/N)^2, of the influence; None if the sensors' positions are exact."""
    stretches: Floats
    """(stretches + 1,) ends of the range, and between them the places at which the beam is held, in nodes."""

    @property
    def steps(self) -> int:
        """Steps between nodes."""
        return len(self.position_mm) - 1


def table_of(prior: Prior) -> Table:
    """Return a table so fine that straight lines between its nodes err by a small part of a deviation (`SAGITTA`)."""
    path = influence_path_of(prior)
    steps = FULL_TURN * np.sqrt(float(path.size.max()) / (8 * SAGITTA))
    position = cells_of(prior, int(np.clip(np.ceil(steps), *NODES)), path).edges_mm
    places = on_axis(position)
    variance = None if prior.variance_table is None else prior.variance_table(places)
    size = path.size[1:-1]
    is_held = (size <= path.size[:-2]) & (size < path.size[2:]) & (size < HELD * path.size.max())
    held = np.interp(path.position_mm[1:-1][is_held], position, np.arange(len(position)))
    stretches = np.concatenate([[0.0], held, [len(position) - 1.0]])
    return Table(position, prior.influence_within_noise(places), variance, stretches)


Rows = tuple[str, str]
"""Names of the influence, and of its variance, at each node, and of their change to the next node."""


FirstStage = Callable[[Graph, Whitened], tuple[list[str], list[str]]]
"""Adds what names the nodes at which to look for a whitened sample, rounded down, (batch, 1) integers: those for any
force, and those for one of the range; none if the force is open, or if the end of the steps from the last node will
do."""


def windowed_graph(prior: Prior, table: Table, first: FirstStage, *, with_force: bool) -> onnx.ModelProto:
    """Return the ONNX graph of a prior, without metadata, whose windows lie around the nodes that `first` names."""
    graph = Graph()
    seen = whitened(graph, prior.largest_mm)
    parts = [table.influence] if table.variance is None else [table.influence, table.variance]
    every = np.concatenate(parts, axis=1)
    rows = graph.constant(every[:-1]), graph.constant(np.diff(every, axis=0))
    edges = _edges(graph, _windows(graph, prior, seen, first(graph, seen), table.steps, rows), table)
    width, influence, variance = _cells(graph, prior, edges, table, rows)
    fit = scored(graph, seen, prior, influence, variance)
    low, high = prior.extent.range_mm
    share = graph.apply("Mul", width, graph.constant(1 / (high - low)))
    share = graph.apply("Max", share, graph.constant(MIN_MASS))
    least = graph.apply("ReduceMin", fit.misfit, axes=[1, 2])
    lowest = least
    if not prior.force_range.is_open:
        lowest = graph.apply("ReduceMin", likely_misfit(graph, prior.force_range, fit), axes=[1, 2])
    misfit = graph.apply("Mul", lowest, graph.constant(2.0))
    graph.apply("Squeeze", misfit, graph.ints(1, 2), output="misfit")
    outputs = state_answers(graph, prior, fit, least, Grid(width, share, low, fine=True), with_force=with_force)
    return model(graph, prior.channels, outputs)


def scan(prior: Prior, table: Table) -> FirstStage:
    """Return the first stage that names the two nodes that explain a sample best, neither of them beside a better one.

    It looks at SCANNED nodes at most.
    """
    looked = np.unique(np.linspace(0, table.steps - 1, min(SCANNED, table.steps)).round().astype(int))
    middle = (table.influence[looked] + table.influence[looked + 1]) / 2
    ends = None if table.variance is None else (table.variance[looked], table.variance[looked + 1])

    def best_two(graph: Graph, unlikeliness: str) -> list[str]:
        height = graph.apply("Neg", unlikeliness)
        around = graph.apply("MaxPool", height, kernel_shape=[3], pads=[1, 1])
        peaks = graph.apply("Where", graph.apply("Equal", height, around), height, graph.constant(LOWEST))
        _, best = graph.top(peaks, 2, 2, largest=True)
        nodes = graph.apply("Gather", graph.constant(looked, np.int64), graph.apply("Squeeze", best, graph.ints(1)))
        return graph.split(nodes, 2, 1)

    def add(graph: Graph, seen: Whitened) -> tuple[list[str], list[str]]:
        spread = None if ends is None else graph.constant(((ends[0] + ends[1]) / 2).T)
        fit = scored(graph, seen, prior, graph.constant(middle.T), spread)
        any_force = best_two(graph, _unlikeliness(graph, fit, fit.misfit))
        if prior.force_range.is_open:
            return any_force, []
        of_range = likely_misfit(graph, prior.force_range, fit)
        return any_force[:1], best_two(graph, _unlikeliness(graph, fit, of_range))

    return add


def _unlikeliness(graph: Graph, found: Scored, square: str) -> str:
    """Return minus the log likelihood of each place, up to a constant, from half the square of what it leaves."""
    return square if found.widened is None else graph.apply("Add", square, graph.apply("Log", found.widened))


def _windows(
    graph: Graph, prior: Prior, seen: Whitened, nodes: tuple[list[str], list[str]], steps: int, rows: Rows
) -> list[str]:
    """Return the ends of each window after the steps from its node, in nodes, (batch, 2, 1)."""
    any_force, of_range = nodes
    starts: list[tuple[str | None, bool]] = [(node, False) for node in any_force]
    if not prior.force_range.is_open:
        starts += [(node, True) for node in of_range] or [(None, True)]
    ends, middle = [], ""
    for start, is_read in starts:
        node = start
        for _ in range(STEPS):
            # The first step begins at the node that the first stage named, a later one where the last step ended.
            middle, step, half = _step(graph, prior, seen, node or _node_at(graph, middle, steps), rows, is_read)
            node = None
        doubted = graph.apply("Mul", graph.apply("Abs", step), graph.constant(DOUBTED))
        half = graph.apply("Mul", graph.apply("Add", half, doubted), graph.constant([[-1.0], [1.0]]))
        middle = graph.apply("Clip", middle, graph.constant(0.0), graph.constant(float(steps)))
        window = graph.apply("Add", middle, half)
        ends.append(graph.apply("Clip", window, graph.constant(0.0), graph.constant(float(steps))))
    return ends


def _node_at(graph: Graph, place: str, steps: int) -> str:
    """Return the node at or below a place (batch, 1, 1), (batch, 1) integers."""
    node = graph.apply("Clip", place, graph.constant(0.0), graph.constant(steps - 0.5))
    return graph.cast(graph.apply("Squeeze", node, graph.ints(2)), np.int64)


def _step(graph: Graph, prior: Prior, seen: Whitened, node: str, rows: Rows, is_read: bool) -> tuple[str, str, str]:
    """Return the end and the length of a Gauss-Newton step, and WITHIN deviations of it; (batch, 1, 1), in nodes.

    `is_read` says that the stated range counts as a reading of the force.
    """
    axes, channels = graph.ints(1, 2), prior.channels
    at_node = [graph.apply("Gather", table, node, axis=0) for table in rows]
    every = graph.apply("Transpose", graph.apply("Concat", *at_node, axis=1), perm=[0, 2, 1])
    influence = graph.apply("Slice", every, graph.ints(0), graph.ints(channels), graph.ints(1))
    shape, turned = graph.split(graph.apply("MatMul", seen.whitening, influence), 2, 2)
    sample = seen.sample

    def along(first: str, second: str) -> str:
        return graph.apply("ReduceSum", graph.apply("Mul", first, second), axes)

    def best_force() -> tuple[str, str]:
        size = graph.apply("Add", along(shape, shape), graph.constant(TINY))
        return size, graph.apply("Max", graph.apply("Div", along(shape, sample), size), graph.constant(TINY))

    def with_one(values: str, of_force: float) -> str:
        return graph.apply("Pad", values, graph.ints(0, 0, 0, 0, 1, 0), graph.constant(of_force))

    if is_read:
        # One more channel, in the units of `seen`: of the force, whatever the place.
        reads = (0.5 * prior.force_range.precision_per_n2) ** 0.5
        shape, turned = with_one(shape, reads), with_one(turned, 0.0)
        sample = with_one(sample, reads * prior.force_range.middle_n)
    if prior.variance_table is not None:
        ends = graph.ints(0, channels), graph.ints(1, 2 * channels), graph.ints(2, 1)
        wider = widening(graph, best_force()[1], graph.apply("Slice", every, *ends))
        if is_read:
            wider = with_one(wider, 1.0)
        shape, turned, sample = (graph.apply("Div", vector, wider) for vector in (shape, turned, sample))
    size, force = best_force()
    part = graph.apply("Div", along(shape, turned), size)
    turned = graph.apply("Sub", turned, graph.apply("Mul", part, shape))
    # Of the sample itself, rounding would leave more along T than a step near a support may err.
    residual = graph.apply("Sub", sample, graph.apply("Mul", shape, force))
    turned = graph.apply("Mul", turned, force)
    square = graph.apply("Add", along(turned, turned), graph.constant(TINY))
    step = graph.apply("Div", along(turned, residual), square)
    # In the units of `seen` a deviation is the root of a half.
    half = graph.apply("Div", graph.constant(WITHIN * 0.5**0.5), graph.apply("Sqrt", square))
    start = graph.apply("Unsqueeze", graph.cast(node, np.float32), graph.ints(2))
    return graph.apply("Add", start, step), step, half


def _edges(graph: Graph, windows: list[str], table: Table) -> str:
    """Return the edges of all cells in order, (batch, edges, 1), in nodes."""
    part, count = np.linspace(0.0, 1.0, CELLS + 1), len(windows)
    inner = np.kron(np.eye(count), np.stack([1 - part, part], axis=1))
    # Towards the ends of a stretch the cells are narrower: next to a support, contacts at either end look alike.
    along = (1 - np.cos(np.linspace(0.0, np.pi, OUTER + 1))) / 2
    outer = np.unique([start + (end - start) * along for start, end in pairwise(table.stretches)])
    # A linear function of the ends of all windows; the edges of the stretches depend on none.
    marks = np.concatenate([inner, np.zeros((len(outer), 2 * count))])
    offset = np.concatenate([np.zeros(len(inner)), outer])
    ends = graph.apply("Concat", *windows, axis=1)
    every = graph.apply("Add", graph.apply("MatMul", graph.constant(marks), ends), graph.constant(offset[:, None]))
    edges, _ = graph.top(every, len(offset), 1, largest=False)
    return edges


def _cells(graph: Graph, prior: Prior, edges: str, table: Table, rows: Rows) -> tuple[str, str, str | None]:
    """Return the widths of the cells, (batch, 1, N) in mm, and the influence at their middles, (batch, channels, N).

    The third is the variance of the influence, if the sensors' positions are not exact.
    """
    ends = {"first": (graph.ints(0), graph.ints(-1)), "last": (graph.ints(1), graph.ints(np.iinfo(np.int64).max))}

    def cut(values: str, kept: str) -> str:
        return graph.apply("Slice", values, *ends[kept], graph.ints(1))

    place = table.position_mm[:, None] - table.position_mm[0]
    positions = graph.constant(place[:-1]), graph.constant(np.diff(place, axis=0))
    at_edge = _between(graph, edges, positions, table.steps)
    width = graph.apply("Transpose", graph.apply("Sub", cut(at_edge, "last"), cut(at_edge, "first")), perm=[0, 2, 1])
    middle = graph.apply("Mul", graph.apply("Add", cut(edges, "last"), cut(edges, "first")), graph.constant(0.5))
    value = graph.apply("Transpose", _between(graph, middle, rows, table.steps), perm=[0, 2, 1])
    if prior.variance_table is None:
        return width, value, None
    influence, variance = graph.split(value, 2, 1)
    return width, influence, variance


def _between(graph: Graph, node: str, rows: Rows, steps: int) -> str:
    """Return rows of a table, (batch, nodes, columns), by straight lines between its nodes."""
    below = graph.apply("Clip", graph.apply("Floor", node), graph.constant(0.0), graph.constant(steps - 1.0))
    part = graph.apply("Sub", node, below)
    index = graph.apply("Squeeze", graph.cast(below, np.int64), graph.ints(2))
    value, change = (graph.apply("Gather", table, index, axis=0) for table in rows)
    return graph.apply("Add", value, graph.apply("Mul", change, part))


def posterior_graph(prior: Prior, *, with_force: bool, finest: Prior | None = None) -> onnx.ModelProto:
    """Return the ONNX graph of a prior, without metadata.

    `finest` has the least noise that samples have, which the cells must resolve; by default that of the prior.
    """
    finest = finest or prior
    if prior.extent.axes > 1:
        return plane_graph(prior, with_force=with_force, finest=finest)
    count = resolving_cells(finest)
    if count is not None:
        return fixed_cells_graph(prior, count, with_force=with_force)
    table = table_of(finest)
    return windowed_graph(prior, table, scan(prior, table), with_force=with_force)
