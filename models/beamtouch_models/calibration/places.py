"""The best place and force of contacts on a surface with departures."""

import numpy as np
from scipy.interpolate import CubicSpline

from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.theory import Theory

GRID = 401
"""Number of positions over the range at which contacts are searched for."""
CHUNK = 200
"""Contacts per search, which bounds its memory."""
STEPS = 4
"""Number of steps from the best position of the grid; each squares the error."""
TINY = np.finfo(np.float64).tiny


def places(theory: Theory, vector: Floats, measured_mm: Floats, deviation_mm: Floats) -> tuple[Floats, Floats]:
    """Return the positions in mm and forces in N (contacts,) that explain measured deflections best.

    Deflections and their standard deviations are (contacts, channels). A force that would have to pull is 0.
    """
    departures = theory.departures(vector)
    reading = measured_mm - np.array(departures.offset_mm)
    sample = (reading + departures.curve_per_mm * reading**2) / deviation_mm
    prior = theory.prior_with(departures)
    grid = np.linspace(*prior.position_mm, GRID)
    influence = prior.influence_at(grid)
    known = prior.force_n[0] if prior.force_is_known else None
    position = np.empty(len(sample))
    for start in range(0, len(sample), CHUNK):
        part = slice(start, start + CHUNK)
        shapes = influence / deviation_mm[part, None, :]
        left = sample[part, None, :] - _force(shapes, sample[part, None, :], known)[..., None] * shapes
        position[part] = grid[(left**2).sum(axis=2).argmin(axis=1)]
    curve = CubicSpline(grid, influence)
    slope = curve.derivative()
    largest = 2 * (grid[1] - grid[0])
    for _ in range(STEPS):
        shape, along = curve(position) / deviation_mm, slope(position) / deviation_mm
        force = _force(shape, sample, known)[:, None]
        if known is None:  # a change along the shape is one of the force
            square = np.maximum((shape**2).sum(axis=1, keepdims=True), TINY)
            along = along - shape * (along * shape).sum(axis=1, keepdims=True) / square
        move = force * along
        step = (move * (sample - force * shape)).sum(axis=1) / np.maximum((move**2).sum(axis=1), TINY)
        position = np.clip(position + np.clip(step, -largest, largest), grid[0], grid[-1])
    return position, _force(curve(position) / deviation_mm, sample, known)


def _force(shapes: Floats, sample: Floats, known: float | None) -> Floats:
    """Return the best forces of whitened samples on shapes per newton, with their last axis; none is negative."""
    along = (shapes * sample).sum(axis=-1)
    if known is not None:
        return np.full(along.shape, known)
    best: Floats = np.maximum(along / np.maximum((shapes**2).sum(axis=-1), TINY), 0.0)
    return best
