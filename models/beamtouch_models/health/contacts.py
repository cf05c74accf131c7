"""Contacts as equations of the gain errors: the residual that no position and no force explains."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.error_model import floor_mm2
from beamtouch_models.health.curve import InfluenceCurve
from beamtouch_models.metadata import Metadata

SCATTER = 1 / 3
"""Scatter from contact to contact, over the floor. It keeps a mean of very many readings from
counting for more than the beam itself repeats."""
WRONG = 9.0
"""A contact is placed without a channel if that lowers the misfit by more than this."""


@dataclass(frozen=True)
class BestSample:
    """The mean of one rested stretch of a contact, and the rest before it. Lists are in the order of the layout."""

    at_us: int
    """Time [us since 1970]."""
    deflection_mm: Sequence[float]
    deviation_mm: Sequence[float]
    """Standard deviations of the deflections."""
    rest_mm: Sequence[float] | None = None
    """Mean deflections at rest before the contact; None if it was not seen."""
    rest_deviation_mm: Sequence[float] | None = None
    is_contact: bool = True
    """Whether a single contact explains it within what the model allows."""


@dataclass(frozen=True)
class Residuals:
    """Contacts as equations of the gain errors g: `shape` g = `left` + noise of deviation 1."""

    shape: Floats
    """(contacts, channels, channels), of rank channels - 2."""
    left: Floats
    """(contacts, channels)"""


def residuals(metadata: Metadata, curve: InfluenceCurve, samples: Sequence[BestSample], gains: Floats) -> Residuals:
    """Return what contacts say of the gains; `gains` (channels,) are the errors as far as they are known."""
    gain, zero_mm = np.array(metadata.floor.gain), np.array(metadata.floor.zero_mm)
    measured = np.array([one.deflection_mm for one in samples])
    deviation = np.array([one.deviation_mm for one in samples])
    rest = np.array([curve.departures.offset_mm if one.rest_mm is None else one.rest_mm for one in samples])
    # A zero that was not seen is as uncertain as the floor says.
    unseen = np.array([zero_mm if one.rest_deviation_mm is None else one.rest_deviation_mm for one in samples])
    linear = curve.departures.straighten(measured - rest)
    floor = floor_mm2(linear, gain, zero_mm)
    variance = deviation**2 + unseen**2 + SCATTER**2 * floor
    position, force = _places(curve, linear / (1 + gains), 1 / (variance + floor))
    influence, slope = curve.at(position)
    weight = 1 / np.sqrt(variance)
    expected = force[:, None] * influence
    tangent = np.stack([influence * weight, slope * weight], axis=2)
    # A support has no influence: whatever is left there is not explained by a shift.
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    span, _ = np.linalg.qr(tangent)
    shape, left = np.eye(len(gain)) * (expected * weight)[:, :, None], (linear - expected) * weight
    whitened = np.concatenate([shape, left[:, :, None]], axis=2)
    whitened -= span @ (span.transpose(0, 2, 1) @ whitened)
    return Residuals(whitened[:, :, :-1], whitened[:, :, -1])


def _places(curve: InfluenceCurve, linear_mm: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return position and force of contacts (contacts,), by weights (contacts, channels).

    The equations are linear about them. A channel whose gain is far off would move them too far for that, so they are
    found without it.
    """

    def fitted(weight: Floats) -> tuple[Floats, Floats, Floats]:
        position, force = curve.best_contacts(linear_mm, weight)
        misfit = (weight * (linear_mm - force[:, None] * curve.at(position)[0]) ** 2).sum(axis=1)
        return position, force, misfit

    position, force, misfit = fitted(weight)
    least, channels = misfit - WRONG, weight.shape[1]
    # Without one of three channels every contact fits.
    for channel in range(channels if channels > 3 else 0):
        found = fitted(weight * (np.arange(channels) != channel))
        better = found[2] < least
        position, force, least = (
            np.where(better, new, old) for new, old in zip(found, (position, force, least), strict=True)
        )
    return position, force
