"""The shares of loads other than one contact that a layout notices, of two kinds of such loads.

The kinds are two equal contacts half of the range apart, and a load spread evenly over half of the range, each at
several places and with several forces. A load moves the whitened sample by m. The best single contact leaves the
distance

    d^2 = min over x and F >= 0 of |m - F W G(x)|^2,

by which the chi-square of the misfit becomes a noncentral one. The load is noticed if the misfit exceeds the threshold
that a model has at this rate and window. W holds the errors of a settled sample of the load: noise, gains, zeros and
mounting.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import chndtr

from beamtouch_models.accuracy.prior import SampleErrors
from beamtouch_models.accuracy.thresholds import left_by_contact, misfit_threshold
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.curve import Curve
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.layout import Candidates

KINDS, PLACES, FORCES = 2, 8, 4
"""Kinds of loads; for each, places along the range and forces."""
PARTS = 64
"""Point loads that stand for a load spread over half of the range."""
CONTACTS = 257
"""Places of the contacts that may explain a load."""
CERTAIN = 1e3
"""Largest d^2: such a load is always noticed. The noncentral chi-square takes longer for larger ones."""


@dataclass(frozen=True)
class OtherLoads:
    """Loads that are not one contact, and the contacts that may explain them, at all candidates."""

    sample: Floats
    """(loads, candidates), deflection in mm; for each force, the places of each kind."""
    precision: Floats
    """(loads, candidates), 1 over the variance of a sample of it, in 1/mm^2."""
    places_mm: Floats
    """(contacts,), places of contacts."""
    shapes: Floats
    """(contacts, candidates), deflection per newton under them, in mm/N."""
    errors: SampleErrors

    def noticed(self, layout: Indices) -> Floats:
        """Return the share of each kind (kinds,) that a layout (sensors,) notices."""
        channels = left_by_contact(len(layout))
        square = np.minimum(self.unexplained(layout), CERTAIN)
        missed = chndtr(self.threshold(len(layout)), channels, square)
        share: Floats = 1 - missed.reshape(-1, KINDS, PLACES).mean(axis=(0, 2))
        return share

    def threshold(self, sensors: int) -> float:
        """Return the misfit that a model of this many sensors takes for that of one contact at most."""
        noise = self.errors.noise_mm / float(np.hypot(self.errors.noise_mm, self.errors.zero_mm))
        return misfit_threshold(noise, sensors, self.errors.rate_hz, self.errors.readings)

    def unexplained(self, layout: Indices) -> Floats:
        """Return d^2 of each load (loads,) for a layout (sensors,)."""
        curve = Curve(self.places_mm, self.shapes[:, layout])
        return curve.unexplained(self.sample[:, layout], self.precision[:, layout])


def other_loads(influence: InfluenceFunction, rules: Candidates, errors: SampleErrors) -> OtherLoads:
    """Return the loads on a structure, for sensors at the candidates of these rules with these errors of a sample."""
    low, high = influence.position_mm
    half = (high - low) / 2
    first = low + half * ((np.arange(PLACES) + 0.5) / PLACES)[:, None]
    kinds = (first + np.array([0.0, half]), first + half * (np.arange(PARTS) + 0.5) / PARTS)
    weak, strong = influence.force_n
    forces = np.unique(weak + (strong - weak) * (np.arange(FORCES) + 0.5) / FORCES)

    def under(at: Callable[[Floats], Floats]) -> Floats:
        """Return what all loads do, from what 1 N at places (places,) does to the candidates."""
        each = [at(kind.ravel()).reshape(*kind.shape, -1).mean(axis=1) for kind in kinds]
        return np.concatenate([force * per_newton for force in forces for per_newton in each])

    sample = under(partial(influence.at, rules.position_mm))
    settled = errors if errors.min_noise_mm is None else replace(errors, noise_mm=errors.min_noise_mm)
    moved: Floats | float = 0.0
    if errors.mounting_mm:
        moved = under(partial(influence.deviation, rules.position_mm, tolerance_mm=errors.mounting_mm))
    places = np.linspace(low, high, CONTACTS)
    shapes = influence.at(rules.position_mm, places)
    return OtherLoads(sample, 1 / settled.variance_mm2(sample, moved), places, shapes, errors)
