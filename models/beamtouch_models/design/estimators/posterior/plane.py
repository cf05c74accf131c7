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
    likely_misfit,
    masses_of,
    reaching,
    state_force,
)
from beamtouch_models.design.estimators.posterior.fitted_cells import Scored, Whitened, scored, whitened
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
    """The place of a box in the extent, as shares of it along both axes: names of (batch, 2, 1)."""

    low: str
    step: str
    """Of a cell."""


@dataclass(frozen=True)
class _Changes:
    """The changes of f H across each cell along both axes, less their parts along H: names of (batch, 2, N)."""

    squares: str
    """The diagonal of G."""
    cross: str
    """Its other entry, (batch, 1, N)."""
    left: str
    """q"""
    pulled: str
    """H.u / a and H.v / a: how far the force of a cell may be off."""


@dataclass(frozen=True)
class _Weighed:
    """What a box says of a sample."""

    fit: Scored
    """With the least misfit within each cell, (batch, 1, N), and the precision a'."""
    changes: _Changes
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
    box = _Box(graph.constant(np.zeros((1, 2, 1))), graph.constant(np.full((1, 2, 1), 1 / PARTS)))
    table = table_of(finest)
    rows = graph.constant(table)
    for _ in range(_boxes(finest)):
        box = _next_box(graph, weighed.posterior, box)
        found = _scored_in(graph, prior, seen, box, rows, along=round(len(table) ** 0.5))
        weighed = _weigh(graph, prior, found)
    _state_misfit(graph, prior, found, weighed.changes)
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
    least = graph.apply("ReduceMin", found.misfit, axes=[1, 2])
    exponent = graph.apply("Max", graph.apply("Sub", least, found.misfit), graph.constant(MIN_EXPONENT))
    touched = graph.apply("Log", graph.apply("ReduceMean", graph.apply("Exp", exponent), axes=[1, 2]))
    rest = graph.apply("ReduceSumSquare", found.sample, axes=[1, 2])
    odds = graph.apply("Add", touched, graph.apply("Sub", rest, least))
    graph.apply("Squeeze", odds, axes, output=EVIDENCE_OUTPUTS[0])


def _scored_in(graph: Graph, prior: Prior, seen: Whitened, box: _Box, table: str, along: int) -> Scored:
    """Return the misfits of the cells of a box, whose influence comes from a table with `along` nodes along an axis."""
    below, part = _nodes_of(graph, box, along)
    (across, beside), (at_x, at_y) = graph.split(below, 2, 1), graph.split(part, 2, 1)
    first = graph.apply("Mul", graph.apply("Transpose", across, perm=[0, 2, 1]), graph.constant(float(along)))
    first = graph.cast(graph.apply("Add", first, beside), np.int64)
    # Low and high node along x, each with low and high node along y.
    shifts = graph.constant(np.reshape([0, 1, along, along + 1], (4, 1, 1)), np.int64)
    corners = graph.apply("Add", graph.apply("Unsqueeze", first, graph.ints(1)), shifts)
    values = graph.apply("Gather", table, corners, axis=0)
    for share, beyond in ((at_x, (3, 4)), (at_y, (2, 4))):
        low, high = graph.split(values, 2, 1)
        change = graph.apply("Mul", graph.apply("Sub", high, low), graph.apply("Unsqueeze", share, graph.ints(*beyond)))
        values = graph.apply("Add", low, change)
    every = graph.apply("Reshape", values, graph.ints(0, PARTS**2, -1))
    every = graph.apply("Transpose", every, perm=[0, 2, 1])
    if prior.variance_table is None:
        return scored(graph, seen, prior, every, None)
    return scored(graph, seen, prior, *graph.split(every, 2, 1))


def _nodes_of(graph: Graph, box: _Box, along: int) -> tuple[str, str]:
    """Return the nodes below the middles of cells along both axes, and the parts of the way beyond; (batch, 2, PARTS).

    Whole numbers, as float.
    """
    middles = graph.constant(np.arange(PARTS) + 0.5)
    share = graph.apply("Add", graph.apply("Mul", middles, box.step), box.low)
    node = graph.apply("Mul", share, graph.constant(along - 1.0))
    below = graph.apply("Floor", graph.apply("Clip", node, graph.constant(0.0), graph.constant(along - 1.5)))
    return below, graph.apply("Sub", node, below)


def _weigh(graph: Graph, prior: Prior, found: Scored) -> _Weighed:
    """Return the posterior over the cells of a box."""
    changes = _changes_of(graph, found)
    averaged, half_log_volume = _averaged(graph, found, changes)
    unlikely = graph.apply("Add", averaged.misfit, half_log_volume)
    if found.widened is not None:
        unlikely = graph.apply("Add", unlikely, graph.apply("Log", found.widened))
    least = graph.apply("ReduceMin", unlikely, axes=[1, 2])
    exponent = graph.apply("Max", graph.apply("Sub", least, unlikely), graph.constant(MIN_EXPONENT))
    masses = masses_of(graph, prior, graph.apply("Sqrt", averaged.precision), averaged.force)
    likely = graph.apply("Div", graph.apply("Exp", exponent), graph.apply("Sqrt", found.precision))
    posterior = graph.apply("LpNormalization", graph.apply("Mul", likely, masses.every), axis=2, p=1)
    return _Weighed(averaged, changes, masses, posterior)


def _changes_of(graph: Graph, found: Scored) -> _Changes:
    """Return how the cells of a box change what they explain."""
    axis = graph.ints(1)
    scale = graph.apply("Unsqueeze", graph.apply("Mul", found.force, graph.constant(6**-0.5)), axis)
    changes = graph.apply("Mul", _steps(graph, found.shape), scale)

    def product(other: str) -> str:
        each = graph.apply("Mul", changes, graph.apply("Unsqueeze", other, axis))
        return graph.apply("ReduceSum", each, graph.ints(2), keepdims=0)

    along = product(found.shape)
    pulled = graph.apply("Div", along, found.precision)
    squares = graph.apply("ReduceSumSquare", changes, axes=[2], keepdims=0)
    squares = graph.apply("Max", graph.apply("Sub", squares, graph.apply("Mul", along, pulled)), graph.constant(0.0))
    both = graph.apply("ReduceProd", changes, axes=[1], keepdims=0)
    common = graph.apply("Div", graph.apply("ReduceProd", along, axes=[1]), found.precision)
    cross = graph.apply("Sub", graph.apply("ReduceSum", both, axis), common)
    return _Changes(squares, cross, product(found.residual), pulled)


def _explained(graph: Graph, changes: _Changes, ridge: float) -> tuple[str, str]:
    """Return q' (ridge I + G)^-1 q of each cell, and the determinant of that matrix."""
    held = graph.apply("Add", changes.squares, graph.constant(ridge))
    volume = graph.apply("ReduceProd", held, axes=[1])
    volume = graph.apply("Sub", volume, graph.apply("Mul", changes.cross, changes.cross))
    volume = graph.apply("Max", volume, graph.constant(ridge**2))
    # Each square with the diagonal of the other axis.
    other = graph.apply("Gather", held, graph.ints(1, 0), axis=1)
    own = graph.apply("Mul", graph.apply("Mul", changes.left, changes.left), other)
    own = graph.apply("ReduceSum", own, graph.ints(1))
    both = graph.apply("Mul", graph.apply("ReduceProd", changes.left, axes=[1]), changes.cross)
    saved = graph.apply("Sub", own, graph.apply("Add", both, both))
    return graph.apply("Div", saved, volume), volume


def _averaged(graph: Graph, found: Scored, changes: _Changes) -> tuple[Scored, str]:
    """Return the misfit R' and the precision a' of places anywhere in each cell, and half the logarithm of |I + G|."""
    explained, volume = _explained(graph, changes, 1.0)
    misfit = graph.apply("Max", graph.apply("Sub", found.misfit, explained), graph.constant(0.0))
    pulled = graph.apply("ReduceSumSquare", changes.pulled, axes=[1])
    variance = graph.apply("Add", graph.apply("Reciprocal", found.precision), pulled)
    half_log = graph.apply("Mul", graph.apply("Log", volume), graph.constant(0.5))
    return replace(found, misfit=misfit, precision=graph.apply("Reciprocal", variance)), half_log


def _steps(graph: Graph, shape: str) -> str:
    """Return the changes of a shape (batch, channels, N) across each cell along both axes, (batch, 2, channels, N)."""
    grid = graph.apply("Reshape", shape, graph.ints(0, 0, PARTS, PARTS))
    # Half of what lies between the neighbours; at the rim of a box there is a neighbour on one side only.
    steps = (np.eye(PARTS, k=1) - np.eye(PARTS, k=-1)) / 2
    steps[[0, -1]] = np.eye(PARTS, k=1)[0] - np.eye(PARTS)[0], np.eye(PARTS)[-1] - np.eye(PARTS, k=-1)[-1]
    along_x = graph.apply("MatMul", graph.constant(steps), grid)
    along_y = graph.apply("MatMul", grid, graph.constant(steps.T))
    every = graph.apply("Concat", along_x, along_y, axis=1)
    return graph.apply("Reshape", every, graph.ints(0, 2, -1, PARTS**2))


def _next_box(graph: Graph, posterior: str, box: _Box) -> _Box:
    """Return the box of the likely cells."""
    most = graph.apply("ReduceMax", posterior, axes=[2])
    share = graph.apply("ReduceMax", graph.apply("Div", posterior, most), axes=[1], keepdims=0)
    share = graph.apply("Reshape", share, graph.ints(-1, 1, PARTS, PARTS))
    along = [graph.apply("ReduceMax", share, axes=[axis], keepdims=0) for axis in (3, 2)]
    is_likely = graph.apply("Greater", graph.apply("Concat", *along, axis=1), graph.constant(np.exp(-LIKELY)))
    # The first likely cell and less than the last one, (batch, 2, 2), each with a margin.
    ends = np.arange(PARTS) * np.array([[1.0], [-1.0]]) - np.array([[1.0], [2.0]])
    is_likely = graph.apply("Unsqueeze", is_likely, graph.ints(2))
    marked = graph.apply("Where", is_likely, graph.constant(ends), graph.constant(BEYOND_ALL))
    within = graph.constant([0.0, -float(PARTS)])
    first = graph.apply("Max", graph.apply("ReduceMin", marked, axes=[3], keepdims=0), within)
    begin, less = graph.split(first, 2, 2)
    count = graph.apply("Mul", graph.apply("Add", begin, less), graph.constant(-1 / PARTS))
    low = graph.apply("Add", box.low, graph.apply("Mul", begin, box.step))
    return _Box(low, graph.apply("Mul", box.step, count))


def _state_misfit(graph: Graph, prior: Prior, found: Scored, changes: _Changes) -> None:
    """Add the misfit, from the cells of the last box."""
    explained, _ = _explained(graph, changes, FREE)
    left = graph.apply("Sub", likely_misfit(graph, prior.force_range, found), explained)
    least = graph.apply("ReduceMin", left, axes=[1, 2], keepdims=0)
    misfit = graph.apply("Max", graph.apply("Add", least, least), graph.constant(0.0))
    graph.apply("Identity", misfit, output=EVIDENCE_OUTPUTS[1])


def _state_place(graph: Graph, prior: Prior, posterior: str, box: _Box) -> None:
    """Add median and interval along each axis, and the correlation of the two, from the posteriors of the last box."""
    rows = 1 if prior.force_n[0] == prior.force_n[1] else 3
    cells = graph.apply("Reshape", posterior, graph.ints(0, rows, PARTS, PARTS))
    # Those along x, then those along y.
    marginals = [graph.apply("ReduceSum", cells, graph.ints(axis), keepdims=0) for axis in (3, 2)]
    mass = graph.apply("Concat", *marginals, axis=1)
    _state_correlation(graph, cells, mass, rows)
    before = graph.apply("CumSum", mass, graph.index(2), exclusive=1)
    of_row = graph.ints(*(row for first in (0, rows) for row in first + np.minimum([0, 1, 2, 1, 2], rows - 1)))
    before, mass = (graph.apply("Gather", values, of_row, axis=1) for values in (before, mass))
    part = graph.apply("Sub", graph.constant(np.reshape(QUANTILES * 2, (-1, 1))), before)
    part = graph.apply("Div", part, graph.apply("Max", mass, graph.constant(FLATTEST)))
    part = graph.apply("Clip", part, graph.constant(0.0), graph.constant(1.0))
    cell = graph.apply("ReduceSum", part, graph.ints(2), keepdims=0)
    cell = graph.apply("Reshape", cell, graph.ints(-1, 2, len(QUANTILES)))
    share = graph.apply("Add", box.low, graph.apply("Mul", cell, box.step))
    place = graph.apply("Mul", share, graph.constant(prior.extent.size_mm[:, None]))
    stated = reaching(graph, place, *prior.extent.ranges_mm)
    every = (
        graph.apply("Gather", stated, graph.index(0), axis=2),
        graph.apply("ReduceMin", stated, axes=[2], keepdims=0),
        graph.apply("ReduceMax", stated, axes=[2], keepdims=0),
    )
    for number, axis in enumerate(PLATE_AXES):
        for values, name in zip(every, names_of(axis, "mm"), strict=True):
            graph.apply("Gather", values, graph.index(number), axis=1, output=name)


def _state_correlation(graph: Graph, cells: str, marginals: str, rows: int) -> None:
    """Add the correlation of the two coordinates, from the posterior of the intervals.

    `cells` are (batch, rows, PARTS, PARTS), and `marginals` (batch, 2 rows, PARTS) those along x before those along y.
    """
    row, number = min(rows - 1, 1), graph.constant(np.arange(PARTS))
    mass = graph.apply("Gather", marginals, graph.ints(row, rows + row), axis=1)
    mean = graph.apply("ReduceSum", graph.apply("Mul", mass, number), graph.ints(2))
    away = graph.apply("Sub", number, mean)
    square = graph.apply("Mul", mass, graph.apply("Mul", away, away))
    variances = graph.apply("ReduceSum", square, graph.ints(2), keepdims=0)
    variances = graph.apply("Max", variances, graph.constant(1 / 12))
    scale = graph.apply("Sqrt", graph.apply("ReduceProd", variances, axes=[1], keepdims=0))
    across, beside = graph.split(away, 2, 1)
    both = graph.apply("MatMul", across, graph.apply("Gather", cells, graph.index(row), axis=1))
    both = graph.apply("ReduceSum", graph.apply("Mul", both, beside), graph.ints(1, 2), keepdims=0)
    graph.apply("Div", both, scale, output=CORRELATION_OUTPUT)
