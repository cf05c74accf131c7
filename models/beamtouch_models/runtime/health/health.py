"""The health of the channels of a surface: how each gain and zero has changed since a baseline, with intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.runtime.curve import InfluenceCurve
from beamtouch_models.runtime.error_model import floor_mm2
from beamtouch_models.runtime.health.changes import (
    CERTAIN,
    Block,
    Change,
    Estimate,
    Gains,
    History,
    find_changes,
    zero_of,
)
from beamtouch_models.runtime.health.residuals import UNKNOWN, Residuals
from beamtouch_models.runtime.metadata import Metadata

SCATTER = 1 / 3
"""Scatter from contact to contact, over the floor. It keeps a mean of very many readings from
counting for more than the beam itself repeats."""
WRONG = 9.0
"""A contact is placed without a channel if that lowers the misfit by more than this."""

INFLUENCE = 20.0
"""Largest likelihood ratio (twice its logarithm) that a contact can give, so that no single contact shows a change."""
POSSIBLE = 8.0
"""From this ratio on, the intervals of the other channels allow for a change of a channel that is not certain."""
CHUNK = 16
"""Contacts that are weighed by the same estimate."""


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
    """True if a single contact explains it within what the model allows."""


@dataclass(frozen=True)
class ChannelChange:
    """The changes of a channel."""

    gain: Estimate
    """Relative to the other channels."""
    zero: Estimate | None
    """In mm; None if no rest was seen."""
    since_us: int
    """Time of the change, or of the first contact [us since 1970]."""
    contacts: int
    """Number of contacts since then."""


class Health:
    """The changes of all channels since a baseline, from contacts."""

    def __init__(self, metadata: Metadata, kept: dict[str, Any] | None = None) -> None:
        """Begin without contacts, or with what `to_json` gave.

        Raises
        ------
        ValueError
            What was kept is not of this layout, or was written in another way.
        """
        self._metadata, self._curve = metadata, InfluenceCurve.of(metadata)
        self._floor, self._zero_mm = np.array(metadata.floor.gain), np.array(metadata.floor.zero_mm)
        try:
            self._history = History.from_json(len(metadata.layout), [] if kept is None else kept["blocks"])
        except (TypeError, KeyError) as error:
            raise ValueError(f"what was kept cannot be read ({error!r})") from None
        self._changes = find_changes(self._history, self._floor)

    @property
    def contacts(self) -> int:
        """Number of contacts."""
        return self._history.contacts

    def to_json(self) -> dict[str, Any]:
        """Return the blocks as JSON values."""
        return {"blocks": self._history.to_json()}

    def add(self, samples: Sequence[BestSample]) -> None:
        """Add the best samples of contacts, in any order of their times.

        A sample that neither a single contact nor a change of one channel explains is left out.
        """
        for begin in range(0, len(samples), CHUNK):
            self._add(samples[begin : begin + CHUNK])

    def _add(self, samples: Sequence[BestSample]) -> None:
        gains, covariance = Gains(self._history, self._floor, self._changes).now()
        shape, residuals = self._equations(samples, gains)
        weight = self._weights(shape, residuals, np.array([sample.is_contact for sample in samples]), gains, covariance)
        boundaries = {self._history.blocks[change.block].first_us for change in self._changes}
        for row in np.flatnonzero(weight).tolist():
            own = weight[row] * shape[row].T
            block = Block(samples[row].at_us, 1, own @ shape[row], own @ residuals[row], *self._rest(samples[row]))
            self._history.add(block, boundaries)
        self._changes = find_changes(self._history, self._floor)

    def _equations(self, samples: Sequence[BestSample], gains: Floats) -> tuple[Floats, Floats]:
        """Return contacts as equations of the gain errors g, `shape` g = `left` + noise of deviation 1.

        `shape` (contacts, channels, channels) and `left` (contacts, channels) are 0 along what place and force explain.
        `gains` (channels,) are the errors as far as they are known.
        """
        offset_mm = self._curve.departures.offset_mm
        measured = np.array([sample.deflection_mm for sample in samples])
        deviation = np.array([sample.deviation_mm for sample in samples])
        rest = np.array([offset_mm if sample.rest_mm is None else sample.rest_mm for sample in samples])
        # A zero that was not seen is as uncertain as the floor says.
        unseen = np.array([self._zero_mm if sample.rest_mm is None else sample.rest_deviation_mm for sample in samples])
        linear = self._curve.departures.straighten(measured - rest)
        floor = floor_mm2(linear, self._floor, self._zero_mm)
        variance = deviation**2 + unseen**2 + SCATTER**2 * floor
        place, force = _place(self._curve, linear / (1 + gains), 1 / (variance + floor))
        from_rest = measured - rest + offset_mm
        residuals = Residuals.of(self._curve, place, force, from_rest, np.sqrt(variance))
        whitening = residuals.whitening(UNKNOWN)
        # A gain moves its channel as the force moves all.
        shape = whitening * residuals.moved_mm[-1][:, None]
        return shape, (whitening @ residuals.left_mm[..., None])[..., 0]

    def _rest(self, sample: BestSample) -> tuple[Floats, Floats]:
        """Return weight and weighted sum of the rest before a contact, (channels,) each; 0 if it was not seen."""
        if sample.rest_mm is None or sample.rest_deviation_mm is None:
            return np.zeros(len(self._zero_mm)), np.zeros(len(self._zero_mm))
        weight: Floats = 1 / (np.square(sample.rest_deviation_mm) + (SCATTER * self._zero_mm) ** 2)
        return weight, weight * (np.array(sample.rest_mm) - self._curve.departures.offset_mm)

    def _weights(self, shape: Floats, left: Floats, is_contact: Bools, gains: Floats, covariance: Floats) -> Floats:
        """Return the weights of contacts: bounded, and 0 for one that no change of a single channel explains.

        `gains` (channels,) are the errors as far as they are known, with their covariance.
        """
        wide = np.eye(len(gains)) + shape @ covariance @ shape.transpose(0, 2, 1)
        off = left - shape @ gains
        inverse = np.linalg.inv(wide)
        misfit = np.einsum("ni,nij,nj->n", off, inverse, off)
        weight = INFLUENCE / np.maximum(misfit, INFLUENCE)
        limit = [None, *self._metadata.thresholds.misfit][len(gains) - 1]
        along = np.einsum("nij,nik,nk->nj", shape, inverse, off)
        square = np.einsum("nij,nik,nkj->nj", shape, inverse, shape)
        explained = (along**2 / np.maximum(square, np.finfo(np.float64).tiny)).max(axis=1)
        is_used = is_contact if limit is None else is_contact | (misfit - explained <= limit)
        return np.where(is_used, weight, 0.0)

    def channels(self) -> list[ChannelChange]:
        """Return the health of each channel in the order of the layout; empty before the first contact."""
        if not self._history.blocks:
            return []
        return [self._channel(channel) for channel in range(len(self._floor))]

    def _channel(self, channel: int) -> ChannelChange:
        gain, gain_block = self._gain(channel)
        zero, zero_block = zero_of(self._history, channel, float(self._zero_mm[channel])) or (None, 0)
        begins = [
            block for block, estimate in ((gain_block, gain), (zero_block, zero)) if estimate and estimate.changed
        ]
        first = min(begins, default=0)
        after = int(self._history.after()[first])
        return ChannelChange(gain, zero, self._history.blocks[first].first_us, after)

    def _gain(self, channel: int) -> tuple[Estimate, int]:
        """Return the change of a gain, and the block with which it began."""
        own = [change.block for change in self._changes if change.channel == channel]
        if own:
            value, deviation = Gains(self._history, self._floor, self._changes).changed(channel)
            certain = bool(value**2 > CERTAIN * deviation**2 and abs(value) >= self._floor[channel])
            return Estimate.of(value, deviation, changed=certain), min(own)
        return self._unnamed(channel), 0

    def _unnamed(self, channel: int) -> Estimate:
        """Return the change of a gain that is not certain: of the newer half of the contacts, or since it is likely."""
        candidates = Gains(self._history, self._floor, self._changes).candidates()
        ratio = np.where(self._history.after()[:, None] > 1, candidates.ratio, 0.0)
        block, likely = (int(place) for place in np.unravel_index(int(ratio.argmax()), ratio.shape))
        if likely != channel or ratio[block, channel] < POSSIBLE:
            others = [Change(block, likely)] if likely != channel and ratio[block, likely] >= POSSIBLE else []
            candidates = Gains(self._history, self._floor, [*self._changes, *others]).candidates()
            after = self._history.after()
            block = int(np.searchsorted(-after, -max(1.0, after[0] / 2)))
        deviation = float(candidates.information[block, channel]) ** -0.5
        return Estimate.of(float(candidates.gain[block, channel]), deviation, changed=False)


def _place(curve: InfluenceCurve, linear_mm: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Return places (contacts, axes) and forces (contacts,) of contacts, by weights (contacts, channels).

    The equations are linear about them. A channel whose gain is far off would move them too far for that, so they are
    found without it.
    """
    channels = weight.shape[1]
    # Without one of three channels every contact fits.
    without = [weight * (np.arange(channels) != channel) for channel in range(channels if channels > 3 else 0)]
    weights = np.array([weight, *without])
    places, forces = (
        np.array(fits) for fits in zip(*(curve.best_contacts(linear_mm, some) for some in weights), strict=True)
    )
    predicted = np.array([force[:, None] * curve.at(place)[0] for place, force in zip(places, forces, strict=True)])
    misfit = (weights * (linear_mm - predicted) ** 2).sum(axis=2)
    misfit[0] -= WRONG
    best = misfit.argmin(axis=0), np.arange(len(linear_mm))
    return places[best], forces[best]
