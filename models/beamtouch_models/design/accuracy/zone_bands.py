"""The band at the edge of a zone in which its answer is `unsure`: how wide it is, and how often an answer is wrong.

The width is the integral over the place x of the contact of the probability of `unsure`,

    width = E_F [ integral P(unsure | x, F) dx ],

which simulated contacts near the edge estimate: each is answered as the service does, from the interval of its exact
posterior (`accuracy.posterior`). Contacts are drawn evenly over `REACH` deviations of the Cramer-Rao bound
(`accuracy.limit`) to either side of the edge, as the band is that much narrower for a larger force.
"""

from typing import NamedTuple

import numpy as np

from beamtouch_common.outline import BEAM_AXIS, Outline, Span
from beamtouch_common.zones import BEGIN, Zone, ZoneState
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_deviation_mm
from beamtouch_models.design.accuracy.posterior import posterior_quantiles
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.places import on_axis

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


def band_at(prior: Prior, edge_mm: float, seed: int, range_n: tuple[float, float] | None = None) -> Band:
    """Return the band at an edge within the beam, for the noise of the prior.

    It is that of the contacts of the prior, of its forces or of a part of them, `range_n`. Where there are none, as
    beyond the end of its range of positions, there is no band.
    """
    rng = np.random.default_rng(seed)
    force_n = rng.uniform(*(range_n or prior.force_n), size=DRAWS)
    low_mm, high_mm = prior.extent.range_mm
    edge = np.full((DRAWS, 1), np.clip(edge_mm, low_mm, high_mm))
    bound_mm = cramer_rao_deviation_mm(prior, edge, force_n)[:, 0]
    deviation_mm = np.minimum(bound_mm, (high_mm - low_mm) / REACH)
    away = rng.uniform(-REACH, REACH, size=DRAWS)
    position_mm = edge_mm + away * deviation_mm
    there = (low_mm <= position_mm) & (position_mm <= high_mm)
    if not there.any():
        return Band(edge_mm, 0.0, 0.0)
    samples = prior.draw(on_axis(position_mm[there]), force_n[there], rng)
    spans = posterior_quantiles(prior, samples, np.tile(_LEVELS, (len(samples), 1)))[0]
    zone = Zone(from_mm=edge_mm, to_mm=prior.diagonal_mm)
    outline = Outline.of_beam(prior.diagonal_mm)
    lies = [zone.lies({BEAM_AXIS: Span(*span)}, None, outline, BEGIN) for span in spans.tolist()]
    right = [ZoneState.INSIDE if position >= edge_mm else ZoneState.OUTSIDE for position in position_mm[there].tolist()]
    unsure = np.array([state is ZoneState.UNSURE for state in lies])
    is_wrong = ~unsure & np.array([said is not true for said, true in zip(lies, right, strict=True)])
    width_mm = float(2 * REACH * (unsure * deviation_mm[there]).sum() / DRAWS)
    # Contacts in the band are spread over it evenly, on one side of the edge or on both.
    apart = np.abs(away[there])
    in_band = apart <= 2 * np.median(apart[unsure]) if unsure.any() else np.zeros(len(apart), dtype=np.bool_)
    return Band(edge_mm, width_mm, float(is_wrong[in_band].mean()) if in_band.any() else 0.0)
