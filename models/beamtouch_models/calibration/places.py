"""The best place and force of contacts on a surface with departures."""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.theory import Theory
from beamtouch_models.health.curve import InfluenceCurve

GRID = 401
"""Number of positions over the range at which contacts are searched for."""
MAX_FORCE_RATIO = 100.0
"""Largest force of a contact, over the largest of its scene. At a support, the best force may be any."""


def places(theory: Theory, vector: Floats, measured_mm: Floats, deviation_mm: Floats) -> tuple[Floats, Floats]:
    """Return the positions in mm and forces in N (contacts,) that explain measured deflections best.

    Deflections and their standard deviations are (contacts, channels). A force that would have to pull
    or to be beyond MAX_FORCE_RATIO is 0: this is no contact.
    """
    departures = theory.departures(vector)
    prior = theory.prior_with(departures)
    grid = np.linspace(*prior.position_mm, GRID)
    curve = InfluenceCurve(grid, prior.influence_at(grid), departures)
    known_n = prior.force_n[0] if prior.force_is_known else None
    linear_mm = departures.linear_mm(measured_mm)
    position, force = curve.best_contacts(linear_mm, deviation_mm**-2, known_n)
    return position, np.where((force > 0) & (force <= MAX_FORCE_RATIO * prior.force_n[1]), force, 0.0)
