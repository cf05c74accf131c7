"""The posterior over places of two axes, as a graph: on cells of the whole extent, then on finer ones where it lies.

Each stage lays PARTS x PARTS cells over a box and weighs them as `answers` does. The next box holds the cells that are
likely, with one cell of margin, so that a compact posterior gets cells smaller than its deviation, and one in
two pieces keeps both. Between the nodes of a table, the influence is bilinear.

*Cells are averages.* A cell may be many deviations of a loud contact wide, and its middle would say nothing of its
rim. So the likelihood of a cell is that of a place anywhere in it: with u and v the changes of f H across the cell
along either axis, over the root of 6 (a sixth is twice the variance of an even density, in the units of `answers`),
less their parts along H, which the force explains as well,

    R' = R - q' (I + G)^-1 q        G = [u v]' [u v]        q = [u v]' (y - f H)        weight ~ exp(-R') / |I + G|^1/2
    a' = 1 / (1/a + (H.u / a)^2 + (H.v / a)^2)

with the precision a' of the force in place of a. Where cells are narrow all of that is 0.

*What it states.* The median along each axis and the ends of its interval come from the marginals, with the priors of
the force and the ends of the range of `answers`. The correlation of the two coordinates makes an ellipse of their
intervals. The log odds of contact come from the cells of the whole extent. The misfit is the least of the last box over
the places in and about each cell, q' G^-1 q less than at its middle.
"""

from dataclasses import dataclass, replace

import numpy as np
import onnx

from beamtouch_common.outline import PLATE_AXES, names_of
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_deviation_mm
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.onnx_graph import Graph, model
from beamtouch_models.design.estimators.posterior.answers import (
    FLATTEST,
    MIN_EXPONENT,
    QUANTILES,
    Masses,
    Scored,
    Whitened,
    likely_misfit,
    masses_of,
    reaching,
    scored,
    state_force,
    whitened,
)
from beamtouch_models.runtime.metadata import CORRELATION_OUTPUT, EVIDENCE_OUTPUTS, FORCE_OUTPUTS

PARTS = 32
"""Cells of a box along each axis."""
LIKELY = 14.0
"""Logarithm of the largest posterior over that of a cell that the next box may leave out."""
NARROW = 0.6
"""Largest cell of the last box in deviations of the loudest contact; intervals are then 3 % too wide there."""
FREE = 0.01
"""What holds a place to its cell in the misfit, over what an even density in the cell would: it may leave it by far."""
MOST_BOXES = 3
"""With a tenth of the box before, the third has cells of less than a ten-thousandth of the extent."""
NODES = (65, 97, 129, 193, 257)
"""Nodes of the table along each axis."""
BENT = 0.1
"""Largest error of a straight line between nodes, in deviations of the loudest contact."""
TABLE_VALUES = 700_000
"""Largest number of values in a table, which bounds the file."""
CHECKED = 64**2
"""Places at which the table is compared with what it stands for, and the deviations of contacts are computed."""
BEYOND_ALL = 1e9
"""Stands for the number of a cell where there is none."""


@dataclass(frozen=True)
class _Box:
    """The place of a box in the extent, as shares of it: names of (batch, 1)."""

    low: tuple[str, str]
    step: tuple[str, str]
    """Of a cell."""


@dataclass(frozen=True)
class _Weighed:
    """What a box says of a sample."""

    fit: Scored
    """With the least misfit within each cell, (batch, 1, N), and the precision a'."""
    masses: Masses
    posterior: str
    """(batch, rows, N)"""


def plane_graph(prior: Prior, *, with_force: bool, finest: Prior) -> onnx.ModelProto:
    """Return the ONNX graph of a prior of two axes, without metadata.

    `finest` has the least noise that samples have, which the cells must resolve.
    """
    graph = Graph()
    seen = whitened(graph, prior.largest_mm)
    middles = prior.extent.middles(PARTS)
    variance = None if prior.variance_table is None else graph.constant(prior.variance_table(middles).T)
    influence = graph.constant(prior.influence_within_noise(middles).T)
    found = scored(graph, seen, prior, influence, variance)
    _state_odds(graph, found)
    weighed = _weigh(graph, prior, found)
    box = _Box((graph.constant([[0.0]]),) * 2, (graph.constant([[1 / PARTS]]),) * 2)
    table = table_of(finest)
    rows = graph.constant(table)
    for _ in range(_boxes(finest)):
        box = _next_box(graph, weighed.posterior, box)
        found = _scored_in(graph, prior, seen, box, rows, along=round(len(table) ** 0.5))
        weighed = _weigh(graph, prior, found)
    _state_misfit(graph, prior, found)
    _state_place(graph, prior, weighed.posterior, box)
    outputs = [*names_of(PLATE_AXES[0], "mm"), *names_of(PLATE_AXES[1], "mm"), *EVIDENCE_OUTPUTS, CORRELATION_OUTPUT]
    if with_force:
        state_force(graph, prior.force_range, weighed.fit, weighed.posterior, weighed.masses, fine=False)
        outputs += FORCE_OUTPUTS
    return model(graph, prior.channels, outputs)


def table_of(prior: Prior) -> Floats:
    """Return the influence at the nodes of an even grid, and its variance if it has one, (nodes, columns).

    The grid is so fine that straight lines between its nodes err by a small part of a deviation, or as fine as a file
    allows.
    """
    columns = prior.channels * (1 if prior.variance_table is None else 2)
    allowed = [count for count in NODES if count**2 * columns <= TABLE_VALUES] or [NODES[0]]
    along = next((count for count in allowed if _bent(prior, count) <= BENT), allowed[-1])
    places = prior.extent.grid(along**2)
    parts = [prior.influence_within_noise(places)]
    if prior.variance_table is not None:
        parts.append(prior.variance_table(places))
    return np.concatenate(parts, axis=1)


def _bent(prior: Prior, along: int) -> float:
    """Return how far the influence in the middle of cells of a table is from straight lines, in deviations."""
    corners = prior.influence_table(prior.extent.grid(along**2)).reshape(along, along, -1)
    straight = (corners[1:, 1:] + corners[1:, :-1] + corners[:-1, 1:] + corners[:-1, :-1]) / 4
    middles, force_n = prior.extent.middles(along - 1), prior.force_n[1]
    off = force_n * (straight.reshape(len(middles), -1) - prior.influence_table(middles))
    return float(np.linalg.norm(off / prior.tabled_deviation_mm(middles, force_n), axis=1).max())


def _boxes(prior: Prior) -> int:
    """Return how many boxes after the first make cells as narrow as the loudest contact needs."""
    places = prior.extent.grid(CHECKED)
    deviation_mm = cramer_rao_deviation_mm(prior, places, np.full(len(places), prior.force_n[1])).min(axis=0)
    cell_mm, boxes = prior.extent.size_mm / PARTS, 0
    while boxes < 1 or (boxes < MOST_BOXES and np.any(cell_mm > NARROW * deviation_mm)):
        cell_mm, boxes = cell_mm * 3 / PARTS, boxes + 1
    return boxes


def _state_odds(graph: Graph, found: Scored) -> None:
    """Add the log odds of contact, from the cells of the whole extent."""
    axes = graph.ints(1, 2)
    least = graph.apply("ReduceMin", found.misfit, axes=[1, 2], keepdims=1)
    exponent = graph.apply("Max", graph.apply("Sub", least, found.misfit), graph.constant(MIN_EXPONENT))
    touched = graph.apply("Log", graph.apply("ReduceMean", graph.apply("Exp", exponent), axes=[1, 2], keepdims=1))
    rest = graph.apply("ReduceSumSquare", found.sample, axes=[1, 2], keepdims=1)
    odds = graph.apply("Add", touched, graph.apply("Sub", rest, least))
    graph.apply("Squeeze", odds, axes, output=EVIDENCE_OUTPUTS[0])


def _scored_in(graph: Graph, prior: Prior, seen: Whitened, box: _Box, table: str, along: int) -> Scored:
    """Return the misfits of the cells of a box, whose influence comes from a table with `along` nodes along an axis."""
    nodes = [_nodes_of(graph, low, step, along) for low, step in zip(box.low, box.step, strict=True)]
    (across, part_across), (beside, part_beside) = nodes
    first = graph.apply("Unsqueeze", graph.apply("Mul", across, graph.index(along)), graph.ints(2))
    first = graph.apply("Add", first, graph.apply("Unsqueeze", beside, graph.ints(1)))
    corners = [
        graph.apply("Gather", table, graph.apply("Add", first, graph.index(shift)), axis=0)
        for shift in (0, along, 1, along + 1)
    ]
    at_x = graph.apply("Unsqueeze", part_across, graph.ints(2, 3))
    at_y = graph.apply("Unsqueeze", part_beside, graph.ints(1, 3))

    def between(low: str, high: str, part: str) -> str:
        return graph.apply("Add", low, graph.apply("Mul", graph.apply("Sub", high, low), part))

    below, above = between(corners[0], corners[1], at_x), between(corners[2], corners[3], at_x)
    every = graph.apply("Reshape", between(below, above, at_y), graph.ints(0, PARTS**2, -1))
    every = graph.apply("Transpose", every, perm=[0, 2, 1])
    if prior.variance_table is None:
        return scored(graph, seen, prior, every, None)
    return scored(graph, seen, prior, *graph.split(every, 2, 1))


def _nodes_of(graph: Graph, low: str, step: str, along: int) -> tuple[str, str]:
    """Return the nodes below the middles of cells along an axis, and the parts of the way beyond; (batch, PARTS)."""
    middles = graph.constant(np.arange(PARTS)[None] + 0.5)
    share = graph.apply("Add", graph.apply("Mul", middles, step), low)
    node = graph.apply("Mul", share, graph.constant(along - 1.0))
    below = graph.apply("Floor", graph.apply("Clip", node, graph.constant(0.0), graph.constant(along - 1.5)))
    return graph.cast(below, np.int64), graph.apply("Sub", node, below)


def _weigh(graph: Graph, prior: Prior, found: Scored) -> _Weighed:
    """Return the posterior over the cells of a box."""
    averaged, half_log_volume = _averaged(graph, found)
    unlikely = graph.apply("Add", averaged.misfit, half_log_volume)
    if found.widened is not None:
        unlikely = graph.apply("Add", unlikely, graph.apply("Log", found.widened))
    least = graph.apply("ReduceMin", unlikely, axes=[1, 2], keepdims=1)
    exponent = graph.apply("Max", graph.apply("Sub", least, unlikely), graph.constant(MIN_EXPONENT))
    masses = masses_of(graph, prior, graph.apply("Sqrt", averaged.precision), averaged.force)
    likely = graph.apply("Div", graph.apply("Exp", exponent), graph.apply("Sqrt", found.precision))
    posterior = graph.apply("LpNormalization", graph.apply("Mul", likely, masses.every), axis=2, p=1)
    return _Weighed(averaged, masses, posterior)


@dataclass(frozen=True)
class _Changes:
    """The changes of f H across each cell, less their parts along H: names of (batch, 1, N)."""

    squares: tuple[str, str]
    """The diagonal of G."""
    cross: str
    """Its other entry."""
    left: tuple[str, str]
    """q"""
    pulled: tuple[str, str]
    """H.u / a and H.v / a: how far the force of a cell may be off."""


def _changes_of(graph: Graph, found: Scored) -> _Changes:
    """Return how the cells of a box change what they explain."""
    residual = graph.apply("Sub", found.own, graph.apply("Mul", found.force, found.shape))
    scale = graph.apply("Mul", found.force, graph.constant(6**-0.5))
    first, second = (graph.apply("Mul", scale, _change(graph, found.shape, axis)) for axis in (2, 3))

    def product(one: str, other: str) -> str:
        return graph.apply("ReduceSum", graph.apply("Mul", one, other), graph.ints(1), keepdims=1)

    def across(one: str, other: str, along: str, pulled: str) -> str:
        return graph.apply("Sub", product(one, other), graph.apply("Mul", along, pulled))

    along = product(first, found.shape), product(second, found.shape)
    pulled = graph.apply("Div", along[0], found.precision), graph.apply("Div", along[1], found.precision)
    nothing = graph.constant(0.0)
    return _Changes(
        (
            graph.apply("Max", across(first, first, along[0], pulled[0]), nothing),
            graph.apply("Max", across(second, second, along[1], pulled[1]), nothing),
        ),
        across(first, second, along[0], pulled[1]),
        (product(first, residual), product(second, residual)),
        pulled,
    )


def _explained(graph: Graph, changes: _Changes, ridge: float) -> tuple[str, str]:
    """Return q' (ridge I + G)^-1 q of each cell, and the determinant of that matrix."""
    held = graph.constant(ridge)
    first, second = (graph.apply("Add", square, held) for square in changes.squares)
    crossed = graph.apply("Mul", changes.cross, changes.cross)
    volume = graph.apply("Sub", graph.apply("Mul", first, second), crossed)
    volume = graph.apply("Max", volume, graph.constant(ridge**2))
    q, r = changes.left
    own = graph.apply("Mul", graph.apply("Mul", q, q), second)
    other = graph.apply("Mul", graph.apply("Mul", r, r), first)
    both = graph.apply("Mul", graph.apply("Mul", q, r), changes.cross)
    both = graph.apply("Add", both, both)
    saved = graph.apply("Sub", graph.apply("Add", own, other), both)
    return graph.apply("Div", saved, volume), volume


def _averaged(graph: Graph, found: Scored) -> tuple[Scored, str]:
    """Return the misfit R' and the precision a' of places anywhere in each cell, and half the logarithm of |I + G|."""
    changes = _changes_of(graph, found)
    explained, volume = _explained(graph, changes, 1.0)
    misfit = graph.apply("Max", graph.apply("Sub", found.misfit, explained), graph.constant(0.0))
    variance = graph.apply("Reciprocal", found.precision)
    for pulled in changes.pulled:
        variance = graph.apply("Add", variance, graph.apply("Mul", pulled, pulled))
    half_log = graph.apply("Mul", graph.apply("Log", volume), graph.constant(0.5))
    return replace(found, misfit=misfit, precision=graph.apply("Reciprocal", variance)), half_log


def _change(graph: Graph, shape: str, axis: int) -> str:
    """Return the change of a shape (batch, channels, N) across each cell along axis 2 or 3 of the grid of cells."""
    grid = graph.apply("Reshape", shape, graph.ints(0, 0, PARTS, PARTS))
    last, axes = graph.ints(np.iinfo(np.int64).max), graph.ints(axis)

    def cut(values: str, begin: int, end: int | None) -> str:
        return graph.apply("Slice", values, graph.ints(begin), last if end is None else graph.ints(end), axes)

    steps = graph.apply("Sub", cut(grid, 1, None), cut(grid, 0, -1))
    # At the rim of a box there is a neighbour on one side only.
    beside = graph.apply("Concat", cut(steps, 0, 1), steps, cut(steps, -1, None), axis=axis)
    change = graph.apply("Add", cut(beside, 1, None), cut(beside, 0, -1))
    change = graph.apply("Mul", change, graph.constant(0.5))
    return graph.apply("Reshape", change, graph.ints(0, 0, PARTS**2))


def _next_box(graph: Graph, posterior: str, box: _Box) -> _Box:
    """Return the box of the likely cells."""
    most = graph.apply("ReduceMax", posterior, axes=[2], keepdims=1)
    share = graph.apply("ReduceMax", graph.apply("Div", posterior, most), axes=[1], keepdims=0)
    share = graph.apply("Reshape", share, graph.ints(-1, PARTS, PARTS))
    lows, steps = [], []
    for axis, (low, step) in enumerate(zip(box.low, box.step, strict=True)):
        along = graph.apply("ReduceMax", share, axes=[2 - axis], keepdims=0)
        is_likely = graph.apply("Greater", along, graph.constant(np.exp(-LIKELY)))
        ends = []
        for sign, margin, bound, pick in ((1.0, 0.0, BEYOND_ALL, "ReduceMin"), (-1.0, 1.0, -BEYOND_ALL, "ReduceMax")):
            cells = graph.constant(np.arange(PARTS)[None] - sign + margin)
            marked = graph.apply("Where", is_likely, cells, graph.constant(bound))
            end = graph.apply(pick, marked, axes=[1], keepdims=1)
            ends.append(graph.apply("Clip", end, graph.constant(0.0), graph.constant(float(PARTS))))
        lows.append(graph.apply("Add", low, graph.apply("Mul", ends[0], step)))
        count = graph.apply("Mul", graph.apply("Sub", ends[1], ends[0]), graph.constant(1 / PARTS))
        steps.append(graph.apply("Mul", step, count))
    return _Box((lows[0], lows[1]), (steps[0], steps[1]))


def _state_misfit(graph: Graph, prior: Prior, found: Scored) -> None:
    """Add the misfit, from the cells of the last box."""
    explained, _ = _explained(graph, _changes_of(graph, found), FREE)
    left = graph.apply("Sub", likely_misfit(graph, prior.force_range, found), explained)
    least = graph.apply("ReduceMin", left, axes=[1, 2], keepdims=0)
    misfit = graph.apply("Max", graph.apply("Add", least, least), graph.constant(0.0))
    graph.apply("Identity", misfit, output=EVIDENCE_OUTPUTS[1])


def _state_place(graph: Graph, prior: Prior, posterior: str, box: _Box) -> None:
    """Add median and interval along each axis, and the correlation of the two, from the posteriors of the last box."""
    rows = 1 if prior.force_n[0] == prior.force_n[1] else 3
    cells = graph.apply("Reshape", posterior, graph.ints(0, rows, PARTS, PARTS))
    marginals = [graph.apply("ReduceSum", cells, graph.ints(axis), keepdims=0) for axis in (3, 2)]
    for axis, (marginal, low, step) in enumerate(zip(marginals, box.low, box.step, strict=True)):
        before, mass = graph.apply("CumSum", marginal, graph.index(2), exclusive=1), marginal
        if rows > 1:
            of_row = graph.ints(0, 1, 2, 1, 2)
            before, mass = (graph.apply("Gather", values, of_row, axis=1) for values in (before, marginal))
        part = graph.apply("Sub", graph.constant(np.array(QUANTILES).reshape(1, -1, 1)), before)
        part = graph.apply("Div", part, graph.apply("Max", mass, graph.constant(FLATTEST)))
        part = graph.apply("Clip", part, graph.constant(0.0), graph.constant(1.0))
        cell = graph.apply("ReduceSum", part, graph.ints(2), keepdims=0)
        size_mm, (low_mm, _) = float(prior.extent.size_mm[axis]), prior.extent.ranges_mm[axis]
        share = graph.apply("Add", low, graph.apply("Mul", cell, step))
        place = graph.apply("Mul", share, graph.constant(size_mm))
        stated = reaching(graph, place, low_mm, size_mm)
        names = names_of(PLATE_AXES[axis], "mm")
        graph.apply("Gather", stated, graph.index(0), axis=1, output=names[0])
        graph.apply("ReduceMin", stated, axes=[1], keepdims=0, output=names[1])
        graph.apply("ReduceMax", stated, axes=[1], keepdims=0, output=names[2])
    _state_correlation(graph, cells, marginals, rows)


def _state_correlation(graph: Graph, cells: str, marginals: list[str], rows: int) -> None:
    """Add the correlation of the two coordinates, from the posterior of the intervals."""
    row, number = graph.index(min(rows - 1, 1)), graph.constant(np.arange(PARTS)[None])
    away, variances = [], []
    for marginal in marginals:
        mass = graph.apply("Gather", marginal, row, axis=1)
        mean = graph.apply("ReduceSum", graph.apply("Mul", mass, number), graph.ints(1), keepdims=1)
        away.append(graph.apply("Sub", number, mean))
        square = graph.apply("Mul", mass, graph.apply("Mul", away[-1], away[-1]))
        variance = graph.apply("ReduceSum", square, graph.ints(1), keepdims=0)
        variances.append(graph.apply("Max", variance, graph.constant(1 / 12)))
    mass = graph.apply("Gather", cells, row, axis=1)
    across = graph.apply("Unsqueeze", away[0], graph.ints(1))
    both = graph.apply("MatMul", graph.apply("MatMul", across, mass), graph.apply("Unsqueeze", away[1], graph.ints(2)))
    scale = graph.apply("Sqrt", graph.apply("Mul", *variances))
    graph.apply("Div", graph.apply("Squeeze", both, graph.ints(1, 2)), scale, output=CORRELATION_OUTPUT)
