"""The small network as an ONNX graph: the network says where to look, and a few cells there give the answers.

u counts the nodes of the network's table, z is the sample and W its whitening.

    n = the network's node for z                     g = influence, t = its change per node, both at n
    H = W g    T = W t, without its part along H     f = H . W z / |H|^2
    d = T . W z / (f |T|^2)    s = 1 / (f |T|)       a Gauss-Newton step, and the deviation of its end
    a, b = n + d -+ (WITHIN s + DOUBTED |d|)         the window

The window gets CELLS even cells, the stretches before and after it OUTER each, so that every position is in a cell. On
these cells the posterior is computed as in `posterior.graph`. They follow the sample, its covariance and the channels
that work, and are a fraction of a deviation wide. So nothing is tempered, and the misfit is that of the best cell.
"""

import numpy as np
import onnx

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.onnx_graph import Graph, model
from beamtouch_models.estimators.posterior.answers import MIN_MASS, Grid, state_answers
from beamtouch_models.estimators.posterior.scoring import Lowest, Whitened, scored, whitened
from beamtouch_models.estimators.small_network import FAINT, Network

CELLS, OUTER = {True: 192, False: 64}, 32
"""For known and open force: a known one makes the posterior narrower than the window, which does not lean on it."""
WITHIN = 6.0
"""Half the window, in deviations of the position."""
DOUBTED = 0.25
"""Half the window, as a share of the last step; the error that a step leaves is a small part of it."""
FINE = 512
"""Number of nodes from which a second step is taken: where so little noise moves the window, the first one errs."""
TINY = 1e-26
"""Keeps divisors off zero."""


def small_network_graph(prior: Prior, network: Network, *, with_force: bool) -> onnx.ModelProto:
    """Return the ONNX graph of a prior and its network, without metadata."""
    graph, table = Graph(), network.table
    seen = whitened(graph, network.largest_mm)
    rows = [table.position_mm[:, None], table.influence]
    rows += [] if table.uncertain is None else [table.uncertain**2]
    every = np.concatenate(rows, axis=1)
    at_node, change = graph.constant(every[:-1]), graph.constant(np.diff(every, axis=0))
    window = _window(graph, prior, seen, _node(graph, network, seen.reading), len(every) - 1, (at_node, change))
    width, influence, uncertain = _cells(graph, prior, window, len(every) - 1, (at_node, change))
    found = scored(graph, seen, prior.force_n[1], influence, uncertain)
    low, high = prior.position_mm
    share = graph.apply("Mul", width, graph.constant(1 / (high - low)))
    share = graph.apply("Max", share, graph.constant(MIN_MASS))
    least = graph.apply("ReduceMin", found.misfit, axes=[1, 2], keepdims=1)
    misfit = graph.apply("Mul", least, graph.constant(2.0))
    graph.apply("Squeeze", misfit, graph.ints(1, 2), output="misfit")
    lowest = Lowest(least, misfit)
    outputs = state_answers(graph, prior, found, lowest, Grid(width, share, low), with_force=with_force)
    return model(graph, prior.channels, outputs)


def _node(graph: Graph, network: Network, reading: str) -> str:
    """Return the network's node, rounded, (batch, 1) integers."""
    steps = len(network.table.position_mm) - 1
    square = graph.apply("ReduceSumSquare", reading, axes=[1], keepdims=1)
    square = graph.apply("Add", square, graph.constant(FAINT * network.largest_mm**2))
    value = graph.apply("Div", reading, graph.apply("Sqrt", square))
    for weights, bias in network.layers[:-1]:
        value = graph.apply("Tanh", graph.apply("Gemm", value, graph.constant(weights), graph.constant(bias)))
    weights, bias = network.layers[-1]
    half = steps / 2
    value = graph.apply("Gemm", value, graph.constant(weights * half), graph.constant((bias + 1) * half))
    value = graph.apply("Clip", value, graph.constant(0.0), graph.constant(steps - 0.5))
    return graph.cast(value, np.int64)


def _window(graph: Graph, prior: Prior, seen: Whitened, node: str, steps: int, table: tuple[str, str]) -> str:
    """Return the ends of the window after the Gauss-Newton steps from the node, in nodes, (batch, 2, 1)."""
    least, most = graph.constant(0.0), graph.constant(float(steps))
    middle, step, half = _step(graph, prior, seen, node, table)
    if steps > FINE:
        node = graph.apply("Clip", graph.apply("Squeeze", middle, graph.ints(2)), least, graph.constant(steps - 0.5))
        node = graph.cast(node, np.int64)
        middle, step, half = _step(graph, prior, seen, node, table)
    doubted = graph.apply("Mul", graph.apply("Abs", step), graph.constant(DOUBTED))
    half = graph.apply("Mul", graph.apply("Add", half, doubted), graph.constant([[-1.0], [1.0]]))
    middle = graph.apply("Clip", middle, least, most)
    return graph.apply("Clip", graph.apply("Add", middle, half), least, most)


def _step(graph: Graph, prior: Prior, seen: Whitened, node: str, table: tuple[str, str]) -> tuple[str, str, str]:
    """Return the end and the length of a Gauss-Newton step, and WITHIN deviations of it; (batch, 1, 1), in nodes."""
    axes, columns = graph.ints(1, 2), (graph.ints(1), graph.ints(1 + prior.channels), graph.ints(2))
    at = [graph.apply("Slice", graph.apply("Gather", one, node, axis=0), *columns) for one in table]
    both = graph.apply("Transpose", graph.apply("Concat", *at, axis=1), perm=[0, 2, 1])
    shape, turned = graph.split(graph.apply("MatMul", seen.whitening, both), 2, 2)

    def along(first: str, second: str) -> str:
        return graph.apply("ReduceSum", graph.apply("Mul", first, second), axes, keepdims=1)

    size = graph.apply("Add", along(shape, shape), graph.constant(TINY))
    part = graph.apply("Div", along(shape, turned), size)
    turned = graph.apply("Sub", turned, graph.apply("Mul", part, shape))
    force = graph.apply("Div", along(shape, seen.sample), size)
    force = graph.apply("Max", force, graph.constant(TINY))
    turned = graph.apply("Mul", turned, force)
    square = graph.apply("Add", along(turned, turned), graph.constant(TINY))
    step = graph.apply("Div", along(turned, seen.sample), square)
    # In the units of `seen` a deviation is the root of a half.
    half = graph.apply("Div", graph.constant(WITHIN * 0.5**0.5), graph.apply("Sqrt", square))
    start = graph.apply("Unsqueeze", graph.cast(node, np.float32), graph.ints(2))
    return graph.apply("Add", start, step), step, half


def _cells(graph: Graph, prior: Prior, window: str, steps: int, table: tuple[str, str]) -> tuple[str, str, str | None]:
    """Return the widths of the cells, (batch, 1, N) in mm, and the influence at their middles, (batch, channels, N).

    The third is the square of the influence's deviation, if the sensors' positions are not exact.
    """
    marks, offset = _marks(steps, CELLS[prior.force_is_known])
    node = graph.apply("MatMul", graph.constant(marks), window)
    node = graph.apply("Add", node, graph.constant(offset[:, None]))
    below = graph.apply("Clip", graph.apply("Floor", node), graph.constant(0.0), graph.constant(steps - 1.0))
    part = graph.apply("Sub", node, below)
    whole = graph.apply("Squeeze", graph.cast(below, np.int64), graph.ints(2))
    value, change = (graph.apply("Gather", one, whole, axis=0) for one in table)
    value = graph.apply("Add", value, graph.apply("Mul", change, part))
    value = graph.apply("Transpose", value, perm=[0, 2, 1])
    last, channels = len(offset), prior.channels

    def taken(row: int, rows: int, first: int) -> str:
        start, end = graph.ints(row, first), graph.ints(row + rows, min(first + last - 1, last))
        return graph.apply("Slice", value, start, end, graph.ints(1, 2), graph.ints(1, 2))

    width = graph.apply("Sub", taken(0, 1, 2), taken(0, 1, 0))
    uncertain = None if prior.uncertainty is None else taken(1 + channels, channels, 1)
    return width, taken(1, channels, 1), uncertain


def _marks(steps: int, cells: int) -> tuple[Floats, Floats]:
    """Return edges and middles of the cells in turn as a linear function of the window's ends: (marks, 2), (marks,)."""
    # Towards the ends of the range the cells are narrower: next to a support, contacts at either end look alike.
    first = (np.arange(2 * OUTER) / (2 * OUTER)) ** 2
    last = 1 - (1 - np.arange(2 * OUTER) / (2 * OUTER)) ** 2
    within, none, nothing = np.arange(2 * cells) / (2 * cells), np.zeros(2 * OUTER), np.zeros(2 * cells)
    low = np.concatenate([first, 1 - within, none, [0.0]])
    high = np.concatenate([none, within, 1 - last, [0.0]])
    return np.stack([low, high], axis=1), np.concatenate([none, nothing, last * steps, [steps]])
