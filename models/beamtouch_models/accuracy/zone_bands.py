"""What the edge of a zone is worth: how wide the band is in which its answer is `unsure`, and how often one is wrong.

The width is the integral over the place x of the contact of the probability of `unsure`,

    width = E_F [ integral P(unsure | x, F) dx ],

which simulated contacts near the edge estimate: each is answered as the service does, from the interval of its exact
posterior (`accuracy.posterior`). Contacts are drawn evenly over `REACH` deviations of the Cramer-Rao bound
(`accuracy.cramer_rao`) to either side of the edge, as the band is that much narrower for a larger force.
"""

from typing import NamedTuple

import numpy as np

from beamtouch_common.zones import BEGIN, Span, Zone, ZoneState
from beamtouch_models.accuracy.cramer_rao import position_deviation_mm
from beamtouch_models.accuracy.posterior import posterior_quantiles
from beamtouch_models.accuracy.prior import Prior

DRAWS = 2048
REACH = 6.0
"""Deviations of the bound to either side of an edge: nearly twice those of the widest answer for a normal posterior."""
_LEVELS = (0.5, 0.025, 0.975)


class Band(NamedTuple):
    """The band at one edge, for contacts of the scene's range of forces."""

    edge_mm: float
    width_mm: float
    """Mean width over the forces."""
    wrong: float
    """Share of the contacts in the band that are said to be on the wrong side."""


def band_at(prior: Prior, edge_mm: float, seed: int) -> Band:
    """Return the band at an edge within the beam, for the noise of the prior."""
    rng = np.random.default_rng(seed)
    force_n = rng.uniform(*prior.force_n, size=DRAWS)
    low_mm, high_mm = prior.position_mm
    bound_mm = position_deviation_mm(prior, np.clip(edge_mm, low_mm, high_mm), force_n)
    deviation_mm = np.minimum(bound_mm, (high_mm - low_mm) / (2 * REACH))
    away = rng.uniform(-REACH, REACH, size=DRAWS)
    position_mm = np.clip(edge_mm + away * deviation_mm, low_mm, high_mm)
    clean, deviation = prior.sampled(position_mm, force_n)
    samples = clean + rng.normal(size=clean.shape) * deviation
    spans = posterior_quantiles(prior, samples, np.tile(_LEVELS, (DRAWS, 1)))[0]
    zone = Zone(from_mm=edge_mm, to_mm=prior.length_mm)
    lies = [zone.lies(Span(*span), None, prior.length_mm, BEGIN) for span in spans.tolist()]
    unsure = np.array([one is ZoneState.UNSURE for one in lies])
    is_right = np.array([ZoneState.INSIDE if one >= edge_mm else ZoneState.OUTSIDE for one in position_mm]) == lies
    width_mm = float(2 * REACH * (unsure * deviation_mm).mean())
    in_band = np.abs(away) <= REACH * unsure.mean()
    return Band(edge_mm, width_mm, float((~unsure & ~is_right)[in_band].mean()))
