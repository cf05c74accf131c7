"""Simulated contacts: drawn at random, or evenly over their distribution, and more where errors are large."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_errors_mm
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import SCRAMBLINGS
from beamtouch_models.places import positions_of

UNIFORM = 0.5
"""Share of evenly spread contacts that are drawn uniformly; the largest weight is about one over it."""


@dataclass(frozen=True)
class Draws:
    """Simulated contacts with their samples."""

    place_mm: Floats
    """(draws, axes)"""
    force_n: Floats
    """(draws,)"""
    deflection_mm: Floats
    """(draws, sensors), with noise."""
    weight: Floats
    """(draws,), weight of each contact in an average; 1 on average."""

    @property
    def position_mm(self) -> Floats:
        """(draws,), the places on a beam."""
        return positions_of(self.place_mm)


def draw(prior: Prior, count: int, seed: int) -> Draws:
    """Draw contacts uniformly from the ranges; noise, gains and zeros are Gaussian, drawn per sample and channel."""
    rng = np.random.default_rng(seed)
    place = prior.extent.uniform(count, rng)
    force = rng.uniform(*prior.force_n, size=count)
    return Draws(place, force, prior.draw(place, force, rng), np.ones(count))


def draw_evenly(prior: Prior, count: int, seed: int) -> Draws:
    """Draw at least `count` contacts like `draw`, but spread evenly over their distribution.

    They come in SCRAMBLINGS consecutive parts of equal length. The parts are independent, so the scatter of their
    means gives a standard error. Half of the contacts are drawn where the Cramer-Rao bound is large, for example next
    to a support, with smaller weights; otherwise a few contacts would dominate a mean.
    """
    place, force, noise, weight = even_contacts(prior, count, seed)
    return Draws(place, force, prior.with_errors(place, force, noise), weight)


def even_contacts(prior: Prior, count: int, seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return places, forces, noise of variance 1 (draws, channels), and weights of the contacts of `draw_evenly`."""
    rngs = np.random.default_rng(seed).spawn(SCRAMBLINGS)
    draws = 2 ** max(0, int(np.ceil(np.log2(count / SCRAMBLINGS))))
    contacts = [spread_contacts(prior, draws, rng) for rng in rngs]
    place, force, noise = (np.concatenate(parts) for parts in zip(*contacts, strict=True))
    place, weight = concentrate_on_errors(prior, place)
    return place, force, noise, weight / weight.mean()


def spread_contacts(prior: Prior, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return contacts and noise spread evenly over their distributions; `draws` is a power of two.

    Returns
    -------
    places in mm (draws, axes), forces in N (draws,), and noise of variance 1 (draws, channels).
    """
    from scipy.stats.qmc import Sobol  # noqa: PLC0415  # slow to import, and many commands do not need it

    axes, (weak, strong) = prior.extent.axes, prior.force_n
    # Points are below 1. Keep them off 0, where the noise would be infinite.
    points = np.maximum(Sobol(axes + 1 + prior.channels, rng=rng).random(draws), 1e-10)
    return prior.extent.at(points[:, :axes]), weak + (strong - weak) * points[:, axes], ndtri(points[:, axes + 1 :])


def concentrate_on_errors(prior: Prior, place_mm: Floats) -> tuple[Floats, Floats]:
    """Concentrate evenly spread places where errors are large.

    Returns places in mm (draws, axes) and weights (draws,).
    """
    if prior.errors.noise_mm == 0:
        return place_mm, np.ones(len(place_mm))
    often, moved = _how_often(prior), np.empty(place_mm.shape)
    # Along the first axis by how often its parts are drawn, along the next by those of the part that was drawn.
    rows = np.zeros(len(place_mm), dtype=np.intp)
    for axis, ends in enumerate(prior.extent.ranges_mm):
        shares = often.reshape(-1, *often.shape[axis:])
        shares = shares.reshape(*shares.shape[:2], -1).mean(axis=2)
        parts = np.empty(len(place_mm), dtype=np.intp)
        for row in np.unique(rows):
            drawn = rows == row
            moved[drawn, axis], parts[drawn] = _concentrate(shares[row], ends, place_mm[drawn, axis])
        rows = rows * often.shape[axis] + parts
    return moved, 1 / often.ravel()[rows]


def concentrated_ticks(prior: Prior, cells: int) -> list[Floats]:
    """Return the edges along each axis of about this number of cells, narrower where errors are large."""
    ticks, often = prior.extent.ticks(cells + 1), _how_often(prior)
    axes = range(often.ndim)
    along = [often.mean(axis=tuple(other_axis for other_axis in axes if other_axis != axis)) for axis in axes]
    pairs = zip(along, prior.extent.ranges_mm, ticks, strict=True)
    return [_concentrate(shares, ends, even)[0] for shares, ends, even in pairs]


def _how_often(prior: Prior) -> Floats:
    """Return how often each part of the extent is drawn, over a uniform draw; an array with the parts of each axis."""
    error_mm = cramer_rao_errors_mm(prior)
    often: Floats = UNIFORM + (1 - UNIFORM) * error_mm / error_mm.mean()
    return often


def _concentrate(often: Floats, ends: tuple[float, float], even_mm: Floats) -> tuple[Floats, Indices]:
    """Return evenly spread coordinates (draws,), moved to where parts (parts,) are drawn often, and their parts."""
    low, high = ends
    before = np.concatenate([[0.0], np.cumsum(often)]) / len(often)
    edges = np.linspace(low, high, len(before))
    moved = np.interp((even_mm - low) / (high - low) * before[-1], before, edges)
    return moved, np.clip(np.searchsorted(edges, moved, side="right") - 1, 0, len(often) - 1)
