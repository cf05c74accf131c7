"""Where the posterior is computed: cells of the position range, and how many of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.prior import Prior

Array = NDArray[np.float64]

FINE = 20_001
"""Positions that the spacing of the cells is computed from."""
RESOLVABLE = {True: (384.0, 0.36), False: (192.0, 0.28)}
"""By whether the force is known: positions told apart that each get a cell; beyond it cells grow by a power of it."""
LOUDNESS = (60.0, 600.0)
"""Largest deflection over the noise from which the ends of the beam need more cells: LEAST of them."""
LEAST = (128, 192, 256)
STEP, MOST = 64, 8192
"""Cells come in such steps, and no more than that, which a noise of 1e-4 % of the deflection needs."""
PRECISE_FROM = 300.0
"""Largest deflection over the noise from which float32 has too few digits for the misfit."""
RESOLVED_STEP = {True: 1.2, False: 3.0}
"""By whether the force is known: largest cell, in deviations of the posterior, up to which sums need no tempering."""
UNTEMPERED = 512
"""Most cells of a graph without tempering."""
POSITION_SHARE = {True: 0.5, False: 1.0}
"""By whether the force is known: how much an even spacing weighs beside the change of the reading."""
SIZE_SHARE = 0.05
"""How much a change of the logarithm of the deflection's size weighs where the force is not known."""
FLOOR = 1e-4
"""Smallest deflection, over the largest, whose direction counts."""


@dataclass(frozen=True)
class Cells:
    """Cells of the position range, side by side."""

    edges_mm: Array
    """(cells + 1,)"""
    middles_mm: Array
    """(cells,) half way in the change of the reading."""
    influence: Array
    """(cells, channels) mm/N, at their middles."""
    step: Array
    """(cells,) how far the reading moves across a cell: in deviations of the noise; in radians if the force is open."""


@dataclass(frozen=True)
class Design:
    """Choices of a graph."""

    cells: int
    temper: bool
    """Widen the likelihood to the cell where it is narrower than that."""
    precise: bool
    """Compute the misfit in double precision."""


def design_for(prior: Prior) -> Design:
    """Choose cells so that the error stays within 1.05 of the limit (measured: docs/decisions/005).

    The reading runs along a curve as the contact moves. Its length in deviations of the noise is the number of
    positions that can be told apart; each gets a cell, and beyond `RESOLVABLE` the cells grow.
    """
    known = prior.force_is_known
    fine, influence = _fine(prior)
    loudest = prior.force_n[1] * float(np.linalg.norm(influence, axis=1).max()) / prior.noise_mm
    scale = 1.0 if known else loudest
    told_apart = float(_spaced(prior, fine, influence, 256).step.sum()) * scale
    resolvable, power = RESOLVABLE[known]
    wanted = min(told_apart, resolvable) * max(1.0, told_apart / resolvable) ** power
    least = LEAST[int(np.searchsorted(LOUDNESS, loudest))]
    count = _in_steps(max(wanted, least))
    precise = loudest > PRECISE_FROM
    for more in range(count, min(2 * count, UNTEMPERED) + 1, STEP):
        # Without tempering the graph has a fifth fewer operations, which is worth twice the cells.
        if float(_spaced(prior, fine, influence, more).step.max()) * scale <= RESOLVED_STEP[known]:
            return Design(more, temper=False, precise=precise)
    return Design(count, temper=True, precise=precise)


def _in_steps(cells: float) -> int:
    return STEP * int(np.clip(np.ceil(cells / STEP), 2, MOST / STEP))


def cells_of(prior: Prior, count: int) -> Cells:
    """Place `count` cells."""
    return _spaced(prior, *_fine(prior), count)


def _fine(prior: Prior) -> tuple[Array, Array]:
    fine = np.linspace(*prior.position_mm, FINE)
    return fine, prior.table(fine)


def _spaced(prior: Prior, fine_mm: Array, influence: Array, count: int) -> Cells:
    """Space cells evenly in a metric that mixes the change of the reading, of position and of the log of its size."""
    known = prior.force_is_known
    floor = (FLOOR * np.abs(influence).max()) ** 2
    size = np.sqrt((influence**2).sum(axis=1) + floor)
    moved = np.linalg.norm(np.diff(influence if known else influence / size[:, None], axis=0), axis=1)
    metric = moved**2 + (moved.sum() * POSITION_SHARE[known] / (len(fine_mm) - 1)) ** 2
    if not known:
        metric += (SIZE_SHARE * np.diff(np.log(size))) ** 2
    along = np.concatenate([[0.0], np.cumsum(np.sqrt(metric))])
    marks = np.linspace(0, along[-1], 2 * count + 1)
    table = np.stack([np.interp(marks, along, column) for column in influence.T], axis=1)
    edges, middles = table[::2], table[1::2]
    if known:
        step = np.linalg.norm(np.diff(edges, axis=0), axis=1) * prior.force_n[1] / prior.noise_mm
    else:
        direction = edges / np.sqrt((edges**2).sum(axis=1, keepdims=True) + floor)
        step = np.linalg.norm(np.diff(direction, axis=0), axis=1)
    places = np.interp(marks, along, fine_mm)
    return Cells(places[::2], places[1::2], middles, step)
