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
from beamtouch_models.curve import Curve
from beamtouch_models.error_model import variance_mm2

PLACES = 1001
"""Positions of the contacts with which a fault is compared first."""


def distances(surface: SimulatedSurface, fault_mm: Floats, valid: Bools) -> Floats:
    """Return how far faults (draws, channels) are from rest and from every contact, in deviations; (draws,).

    `valid` (draws, channels) says which channels take part.
    """
    curve, weight = _curve(surface), np.where(valid, _weight(surface, fault_mm), 0.0)
    moved = np.where(valid, surface.world.departures.linear_mm(fault_mm), 0.0)
    return np.sqrt(curve.unexplained(moved, weight))


def power_of_shift(distance: Floats, alpha: float) -> float:
    """Return the mean power of the test that knows what happened, for faults (draws,) at a distance."""
    return float(ndtr(distance + ndtri(alpha)).mean())


def power_of_noise(surface: SimulatedSurface, clean_mm: Floats, noise: Floats, alpha: float) -> float:
    """Return the mean power for channels whose noise is some times that of the model; both (draws, channels)."""
    curve, weight = _curve(surface), _weight(surface, clean_mm)
    position, _ = curve.best_contacts(surface.world.departures.linear_mm(clean_mm), weight)
    basis = np.linalg.qr(np.sqrt(weight)[:, :, None] * np.stack(curve.at(position), axis=2))[0]
    row, louder = np.arange(len(noise)), np.argmax(noise, axis=1)
    left = weight[row, louder] * (1 - (basis[row, louder] ** 2).sum(axis=1))
    extra = (noise[row, louder] ** 2 - 1) * surface.min_noise_mm**2 * left
    return float(2 * ndtr(ndtri(alpha / 2) / np.sqrt(1 + extra)).mean())


def _curve(surface: SimulatedSurface) -> Curve:
    """Return the deflections that the model expects of contacts, without offsets and the curvature of a calibration."""
    places = np.linspace(*surface.metadata.ranges.position_mm, PLACES)
    return Curve(places, surface.world.influence(places) * np.array(surface.world.departures.gain))


def _weight(surface: SimulatedSurface, deflection_mm: Floats) -> Floats:
    """Return one over the variance of settled samples, (draws, channels)."""
    floor = surface.metadata.floor
    return 1 / variance_mm2(deflection_mm, surface.min_noise_mm, floor.gain, floor.zero_mm)
