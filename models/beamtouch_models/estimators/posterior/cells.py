"""The cells of the position range on which the posterior is computed."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats

FINE = 20_001
"""Positions from which the spacing of the cells is computed."""
RESOLVABLE = {True: (384.0, 0.36), False: (192.0, 0.28)}
"""For known and open force: up to this many distinguishable positions each gets a cell; beyond it, the number of cells
grows by this power of their number."""
LOUDNESS = (60.0, 600.0)
"""Ratios of the largest deflection to the noise; above each, the ends of the beam need the next number in LEAST."""
LEAST = (128, 192, 256)
STEP, MOST = 64, 8192
"""The number of cells is a multiple of STEP and at most MOST, which a noise of 1e-4 % of the deflection needs."""
PRECISE_FROM = 300.0
"""Ratio of the largest deflection to the noise above which float32 has too few digits for the misfit."""
RESOLVED_STEP = {True: 1.2, False: 3.0}
"""For known and open force: largest cell, in deviations of the posterior, for which sums need no tempering."""
UNTEMPERED = 512
"""Largest number of cells in a graph without tempering."""
POSITION_SHARE = {True: 0.5, False: 1.0}
"""For known and open force: weight of an even spacing relative to the change of the reading."""
SIZE_SHARE = 0.05
"""Weight of a change in the logarithm of the deflection's size, for an open force."""
FLOOR = 1e-4
"""Smallest deflection, relative to the largest, whose direction counts."""


@dataclass(frozen=True)
class Cells:
    """Cells of the position range, side by side."""

    edges_mm: Floats
    """(cells + 1,)"""
    middles_mm: Floats
    """(cells,) half way in the change of the reading."""
    influence: Floats
    """(cells, channels) mm/N, at the middles of the cells."""
    step: Floats
    """(cells,) change of the reading across a cell: in deviations of the noise, or in radians if the force is open."""


@dataclass(frozen=True)
class Design:
    """Design choices of a graph."""

    cells: int
    temper: bool
    """Widen the likelihood to the cell where it is narrower than the cell."""
    precise: bool
    """Compute the misfit in double precision."""


def design_for(prior: Prior) -> Design:
    """Choose cells so that the error stays within 1.05 of the limit (measured: docs/decisions/005).

    The reading follows a curve as the contact moves. The length of this curve in deviations of the noise is the number
    of distinguishable positions. Each gets a cell; beyond `RESOLVABLE` the cells grow.
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
        # Without tempering the graph has a fifth fewer operations, which pays for twice the cells.
        if float(_spaced(prior, fine, influence, more).step.max()) * scale <= RESOLVED_STEP[known]:
            return Design(more, temper=False, precise=precise)
    return Design(count, temper=True, precise=precise)


def _in_steps(cells: float) -> int:
    return STEP * int(np.clip(np.ceil(cells / STEP), 2, MOST / STEP))


def cells_of(prior: Prior, count: int) -> Cells:
    """Return `count` cells for a prior."""
    return _spaced(prior, *_fine(prior), count)


def _fine(prior: Prior) -> tuple[Floats, Floats]:
    fine = np.linspace(*prior.position_mm, FINE)
    return fine, prior.table(fine)


def _spaced(prior: Prior, fine_mm: Floats, influence: Floats, count: int) -> Cells:
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
