"""Evidence for rest and for a contact in each sample, and doubts about it: a model's answers under its covariance."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.runtime.error_model import whitening
from beamtouch_models.runtime.metadata import Metadata, fewest_that_check
from beamtouch_models.runtime.metadata_parts import Thresholds
from beamtouch_models.runtime.session import Run

MOVING = 1.5
"""A sample moves if its variance, summed over the channels, exceeds this many times that of its noise, or of the noise
that the model was made for if that is larger. A smaller lag of a long mean is in its covariance, and is no motion."""
SETTLED = 1.6
"""Largest variance of the noise of a settled sample, over that which the model was made for: one reading may lack."""
LOG_ODDS, MISFIT = "contact_log_odds", "misfit"


@dataclass(frozen=True)
class Weighed:
    """Samples of a model, with what is known of their errors. Channels are in the order of the model."""

    deflection_mm: Floats
    """(samples, channels); 0 for a channel that is missing."""
    covariance_mm2: Floats
    """(samples, channels, channels), of these means as their sender states it."""
    noise_mm2: Floats
    """(samples, channels), variance of these means if their readings held nothing but noise."""
    valid: Bools
    """(samples, channels), False for a channel that is missing."""
    zero_mm2: Floats | None = None
    """(samples, 2), the part of the covariance that the zeros add since the last rest: variance of what moved all of
    them together, and of each by itself. None: nothing."""

    @cached_property
    def is_whole(self) -> bool:
        """True if no channel is missing in any sample."""
        return bool(self.valid.all())

    def of_valid(self, values: Floats) -> Floats:
        """Return values (samples, channels) with 0 for channels that are missing."""
        return values if self.is_whole else np.where(self.valid, values, 0.0)

    @classmethod
    def stacked(cls, samples: Sequence["Weighed"]) -> "Weighed":
        """Return samples as one, so that the graph runs once."""
        arrays = [part.name for part in fields(cls) if part.name != "zero_mm2"]
        stacked = cls(*(np.concatenate([getattr(sample, name) for sample in samples]) for name in arrays))
        zeros_mm2 = [sample.zero_mm2 for sample in samples if sample.zero_mm2 is not None]  # of all or of none
        return replace(stacked, zero_mm2=np.concatenate(zeros_mm2)) if zeros_mm2 else stacked

    @property
    def still_mm2(self) -> Floats:
        """(samples, channels, channels), covariance if the readings held nothing but noise."""
        noise: Floats = self.noise_mm2[:, :, None] * np.eye(self.noise_mm2.shape[1])
        return noise if self.zero_mm2 is None else noise + _of_zeros(self.zero_mm2, noise.shape[1])

    def with_zeros(self, zero_mm2: Floats | None) -> "Weighed":
        """Return the samples with the variances of their zeros since the last rest."""
        if zero_mm2 is None:
            return self
        covariance_mm2 = self.covariance_mm2 + _of_zeros(zero_mm2, self.valid.shape[1])
        return replace(self, covariance_mm2=covariance_mm2, zero_mm2=zero_mm2)

    def noisier(self, extra_mm2: Floats) -> "Weighed":
        """Return the samples with more variance (samples, channels), which is none of their noise."""
        return replace(self, covariance_mm2=self.covariance_mm2 + extra_mm2[:, :, None] * np.eye(extra_mm2.shape[1]))

    def part(self, rows: Indices) -> "Weighed":
        """Return some of the samples."""
        zero_mm2 = None if self.zero_mm2 is None else self.zero_mm2[rows]
        return Weighed(
            self.deflection_mm[rows], self.covariance_mm2[rows], self.noise_mm2[rows], self.valid[rows], zero_mm2
        )

    def without(self, channel: Indices) -> "Weighed":
        """Return the same samples as if a channel of each (samples,) were missing."""
        valid = self.valid.copy()
        valid[np.arange(len(valid)), channel] = False
        return replace(self, deflection_mm=np.where(valid, self.deflection_mm, 0.0), valid=valid)


def _of_zeros(zero_mm2: Floats, channels: int) -> Floats:
    """Return the covariances (samples, channels, channels) of zeros with these variances (samples, 2)."""
    covariance: Floats = zero_mm2[:, :1, None] + zero_mm2[:, 1:, None] * np.eye(channels)
    return covariance


class Evidence(NamedTuple):
    """The evidence of one sample, under its covariance and the floor of the model."""

    deflection_mm: Floats
    """(channels,), from where the beam rests."""
    whitening_per_mm: Floats
    """(channels, channels)"""
    answer: dict[str, float]
    """Output name -> value."""
    channels: int
    """Number of channels that took part."""
    rest_misfit: float
    """Misfit of rest: the squared length of the whitened sample."""
    moves: bool
    """True if the readings scatter more than their noise."""
    still_log_odds: float
    """Log odds of contact if the scatter were none: under the noise alone."""
    still_whitening_per_mm: Floats
    """(channels, channels), if the scatter were none: under the noise alone."""
    is_settled: bool
    """True if the noise is about that which the model was made for, or less."""

    @property
    def log_odds(self) -> float:
        """Log odds of contact over rest [nats]."""
        return self.answer[LOG_ODDS]

    @property
    def misfit(self) -> float:
        """Misfit of the best contact; 0 for a model that does not state it."""
        return self.answer.get(MISFIT, 0.0)

    @property
    def seen_mm(self) -> tuple[float | None, ...]:
        """The deflection (channels,); None for a channel that took no part."""
        took_part = np.logical_or.reduce(self.still_whitening_per_mm != 0).tolist()
        return tuple(mm if there else None for mm, there in zip(self.deflection_mm.tolist(), took_part, strict=True))

    def shows(self, deflection_mm: Floats) -> float:
        """Return the misfit that rest would have with this deflection (channels,), under the same covariance.

        NaN is not known: the least misfit that any deflection there would leave.
        """
        return _least_square(self.whitening_per_mm, deflection_mm)

    def could_show(self, deflection_mm: Floats) -> float:
        """Return the same if the scatter were none: the most that the working channels can show."""
        return _least_square(self.still_whitening_per_mm, deflection_mm)


def _least_square(whitening_per_mm: Floats, deflection_mm: Floats) -> float:
    known = ~np.isnan(deflection_mm)
    whitened = whitening_per_mm[:, known] @ deflection_mm[known]
    if not known.all():
        free = whitening_per_mm[:, ~known]
        whitened = whitened - free @ np.linalg.lstsq(free, whitened)[0]
    return float(whitened @ whitened)


def evidence(metadata: Metadata, run: Run, samples: Weighed) -> list[Evidence]:
    """Return what each sample says.

    Parameters
    ----------
    metadata : of the model, for its floor
    run : runs the graph of the model
    samples : in the order of the model's channels

    Raises
    ------
    ValueError
        A total covariance is not positive definite.
    """
    noise = samples.of_valid(samples.noise_mm2)
    variance = samples.of_valid(np.einsum("nii->ni", samples.covariance_mm2))
    usual_mm2 = np.maximum(noise, metadata.noise.sample_mm**2)
    if samples.zero_mm2 is not None:
        usual_mm2 += samples.zero_mm2.sum(axis=1, keepdims=True)
    usual_mm2 = samples.of_valid(usual_mm2)
    moves = variance.sum(axis=1) > MOVING * usual_mm2.sum(axis=1)
    settled: list[bool] = np.all(noise <= SETTLED * metadata.noise.sample_mm**2, axis=1).tolist()
    # The graph runs once: for the samples as they are, and for those that move as if they were still.
    still, moving = np.arange(len(moves)), np.flatnonzero(moves)
    every = samples
    if len(moving):
        part = samples.part(moving)
        as_still = replace(part, covariance_mm2=part.still_mm2)
        every, still[moving] = Weighed.stacked([samples, as_still]), len(moves) + np.arange(len(moving))
    floor, valid = metadata.floor, None if samples.is_whole else every.valid
    weights = whitening(every.deflection_mm, every.covariance_mm2, floor.gain, floor.zero_mm, valid)
    answers = _run(run, every.deflection_mm, weights)
    from_rest = samples.deflection_mm
    if metadata.calibration is not None:
        from_rest = samples.of_valid(from_rest - np.array(metadata.calibration.departures.offset_mm))
    rest_misfit = ((weights[: len(moves)] @ from_rest[:, :, None]) ** 2).sum(axis=(1, 2)).tolist()
    channels = samples.valid.sum(axis=1).tolist()
    return [
        Evidence(
            from_rest[row],
            weights[row],
            answers[row],
            channels[row],
            rest_misfit[row],
            row != as_still_row,
            answers[as_still_row][LOG_ODDS],
            weights[as_still_row],
            settled[row],
        )
        for row, as_still_row in enumerate(still.tolist())
    ]


def _run(run: Run, deflection_mm: Floats, weights: Floats) -> list[dict[str, float]]:
    """Return the value per output for each sample."""
    answers = run(deflection_mm, weights)
    columns = zip(*(values.tolist() for values in answers.values()), strict=True)
    return [dict(zip(answers, row, strict=True)) for row in columns]


SURELY = 2.0
"""The force is said to be beyond the range if it is so by more than this many half-widths of its interval."""


def is_odd(thresholds: Thresholds, evidence: Evidence) -> bool:
    """Return whether neither rest nor a single contact explains a sample."""
    place = evidence.channels - 1
    return evidence.rest_misfit > thresholds.rest[place] and evidence.misfit > thresholds.misfit[place]


def is_overload(metadata: Metadata, evidence: Evidence) -> bool:
    """Return whether the force of a contact is beyond the range of the scene; False for a model that states none."""
    force_n, low_n = (evidence.answer.get(name) for name in ("force_n", "force_low_n"))
    if force_n is None or low_n is None:
        return False
    return force_n - SURELY * (force_n - low_n) > metadata.ranges.force_n[1]


def is_unchecked(metadata: Metadata, evidence: Evidence) -> bool:
    """Return whether so few channels took part that much else looks like a contact."""
    return evidence.channels < fewest_that_check(len(metadata.axes))
