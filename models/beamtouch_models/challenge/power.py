"""The largest power of any test: how often one that knows the fault notices it in one settled sample.

A fault moves the whitened sample by a known vector m = W mu. What it must be told from is rest or any single contact,
F W G(x) with F >= 0. The nearest of these is at a distance

    d = min over x and F of |W (mu - F G(x))|,

and a test that says "not a contact" at a rate of at most alpha also in that case can do no better than the likelihood
ratio of two normal distributions d apart (Neyman & Pearson, doi 10.1098/rsta.1933.0009):

    power = Phi(d - z_alpha),   z_alpha = Phi^-1(1 - alpha).

It is for one sample. A surface sees many, but a fault that stays adds no new direction, and its floor never averages
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
    departures, floor = surface.world.departures, surface.metadata.floor
    places = np.linspace(*surface.metadata.ranges.position_mm, PLACES)
    # The deflections that the model expects of contacts, without offsets and the curvature of a calibration.
    curve = Curve(places, surface.world.influence(places) * np.array(departures.gain))
    weight = np.where(valid, 1 / variance_mm2(fault_mm, surface.min_noise_mm, floor.gain, floor.zero_mm), 0.0)
    return np.sqrt(curve.unexplained(np.where(valid, departures.linear_mm(fault_mm), 0.0), weight))


def power_of_shift(distance: Floats, alpha: float) -> float:
    """Return the mean power of the test that knows what happened, for faults (draws,) at a distance."""
    return float(ndtr(distance + ndtri(alpha)).mean())
