"""The largest power of any test: how often one that knows the fault notices it in one settled sample.

A fault moves the whitened sample by a known vector m = W mu. What it must be told from is rest or any single contact,
F W G(x) with F >= 0. The nearest of these is at a distance

    d = min over x and F of |W (mu - F G(x))|,

and a test that says "not a contact" at a rate of at most alpha also in that case can do no better than the likelihood
ratio of two normal distributions d apart (Neyman & Pearson, doi 10.1098/rsta.1933.0009):

    power = Phi(d - z_alpha),   z_alpha = Phi^-1(1 - alpha).

A channel that is k times as noisy changes no mean. The part of its direction that the best contact leaves,
p = P W e with the projection P beside W G(x) and W G'(x), has the variance 1 + (k^2 - 1) s^2 |p|^2 instead of 1, and

    power = 2 Phi(-z_(alpha/2) / sqrt(1 + (k^2 - 1) s^2 |p|^2)).

Both are for one sample. A surface sees many, but a fault that stays adds no new direction, and its floor never averages
away.
"""

import numpy as np
from scipy.special import ndtr, ndtri

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.whitening import whitening

PLACES = 1001
"""Positions of the contacts with which a fault is compared."""
FINER = 65
"""Positions between the neighbours of the nearest of them."""
CHUNK = 50
"""Draws at a time, so that their distances to all contacts fit the cache."""


def distances(surface: SimulatedSurface, fault_mm: Floats, valid: Bools) -> Floats:
    """Return how far faults (draws, channels) are from rest and from every contact, in deviations; (draws,).

    `valid` (draws, channels) says which channels take part.
    """
    whiten = _whitening(surface, fault_mm, valid)
    moved = np.einsum("dij,dj->di", whiten, np.where(valid, surface.departures.linear_mm(fault_mm), 0.0))
    grid = np.linspace(*surface.metadata.ranges.position_mm, PLACES)
    found = np.empty(len(fault_mm))
    for start in range(0, len(found), CHUNK):
        part = slice(start, start + CHUNK)
        far = _away(surface, np.broadcast_to(grid, (len(moved[part]), PLACES)), whiten[part], moved[part])
        near = np.argmin(far, axis=1)
        low, high = grid[np.maximum(near - 1, 0)], grid[np.minimum(near + 1, PLACES - 1)]
        fine = np.linspace(low, high, FINER, axis=1)
        found[part] = _away(surface, fine, whiten[part], moved[part]).min(axis=1)
    return found


def power_of_shift(distance: Floats, alpha: float) -> float:
    """Return the mean power of the test that knows what happened, for faults (draws,) at a distance."""
    return float(ndtr(distance + ndtri(alpha)).mean())


def power_of_noise(surface: SimulatedSurface, clean_mm: Floats, noise: Floats, alpha: float) -> float:
    """Return the mean power for channels whose noise is some times that of the model; both (draws, channels)."""
    whiten = _whitening(surface, clean_mm, np.ones(clean_mm.shape, np.bool_))
    grid = np.linspace(*surface.metadata.ranges.position_mm, PLACES)
    moved = np.einsum("dij,dj->di", whiten, surface.departures.linear_mm(clean_mm))
    near = np.concatenate(
        [
            np.argmin(_away(surface, np.broadcast_to(grid, (len(rows), PLACES)), whiten[at], rows), axis=1)
            for at, rows in ((slice(i, i + CHUNK), moved[i : i + CHUNK]) for i in range(0, len(moved), CHUNK))
        ]
    )
    along = np.stack([surface.expected(grid[near]), surface.expected(grid[near], 1)], axis=2)
    basis = np.linalg.qr(np.einsum("dij,djk->dik", whiten, along))[0]
    louder = np.argmax(noise, axis=1)
    row = np.arange(len(louder))
    seen = whiten[row, :, louder]
    left = seen - np.einsum("dik,djk,dj->di", basis, basis, seen)
    extra = (noise[row, louder] ** 2 - 1) * surface.min_noise_mm**2 * (left * left).sum(axis=1)
    return float(2 * ndtr(ndtri(alpha / 2) / np.sqrt(1 + extra)).mean())


def _whitening(surface: SimulatedSurface, deflection_mm: Floats, valid: Bools) -> Floats:
    """Return the whitening of settled samples."""
    floor = surface.metadata.floor
    covariance = np.eye(surface.channels) * surface.min_noise_mm**2
    return whitening(deflection_mm, covariance, floor.gain, floor.zero_mm, valid)


def _away(surface: SimulatedSurface, places_mm: Floats, whiten: Floats, moved: Floats) -> Floats:
    """Return the distances (draws, places) of whitened samples (draws, channels) from contacts at places."""
    shapes = surface.expected(places_mm) @ whiten.transpose(0, 2, 1)
    size = np.einsum("dpc,dpc->dp", shapes, shapes)
    along = np.einsum("dpc,dc->dp", shapes, moved)
    force = np.maximum(along, 0.0) / np.where(size > 0, size, 1.0)
    left = moved[:, None] - force[:, :, None] * shapes
    away: Floats = np.sqrt(np.einsum("dpc,dpc->dp", left, left))
    return away
