"""Evidence for rest and for a contact in each sample: the answers of a model under the sample's covariance."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.metadata import Metadata
from beamtouch_models.session import Answers, Run
from beamtouch_models.whitening import whitening

MOVING = 1.5
"""A sample moves if its variance, summed over the channels, exceeds this many times that of its noise, or of the noise
that the model was made for if that is larger. A smaller lag of a long mean is in its covariance, and is no motion."""
CHECKED = 3
"""Smallest number of channels that check a contact: two fit one to any sample but a pull and the like."""
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

    def part(self, rows: Indices) -> "Weighed":
        """Return some of the samples."""
        return Weighed(self.deflection_mm[rows], self.covariance_mm2[rows], self.noise_mm2[rows], self.valid[rows])

    def without(self, channel: int) -> "Weighed":
        """Return the same samples as if a channel were missing."""
        valid = self.valid.copy()
        valid[:, channel] = False
        return Weighed(np.where(valid, self.deflection_mm, 0.0), self.covariance_mm2, self.noise_mm2, valid)


@dataclass(frozen=True, slots=True)
class Evidence:
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
    """Whether the readings scatter more than their noise."""
    still_log_odds: float
    """Log odds of contact if the scatter were none: under the noise alone."""
    still_whitening_per_mm: Floats
    """(channels, channels), if the scatter were none: under the noise alone."""
    is_settled: bool = True
    """Whether the noise is about that which the model was made for, or less."""

    @property
    def log_odds(self) -> float:
        """Log odds of contact over rest [nats]."""
        return self.answer[LOG_ODDS]

    @property
    def misfit(self) -> float:
        """Misfit of the best contact; 0 for a model that does not state it."""
        return self.answer.get(MISFIT, 0.0)

    def shows(self, deflection_mm: Floats) -> float:
        """Return the misfit that rest would have with this deflection (channels,), under the same covariance."""
        return _square(self.whitening_per_mm @ deflection_mm)

    def could_show(self, deflection_mm: Floats) -> float:
        """Return the same if the scatter were none: the most that the working channels can show."""
        return _square(self.still_whitening_per_mm @ deflection_mm)


def _square(whitened: Floats) -> float:
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
    variance = np.where(samples.valid, np.einsum("nii->ni", samples.covariance_mm2), 0.0)
    noise = np.where(samples.valid, samples.noise_mm2, 0.0)
    usual_mm2 = np.where(samples.valid, np.maximum(noise, metadata.noise.sample_mm**2), 0.0)
    moves = variance.sum(axis=1) > MOVING * usual_mm2.sum(axis=1)
    from_rest = np.where(samples.valid, samples.deflection_mm - _rest_mm(metadata), 0.0)
    weights, answers = _weigh(metadata, run, samples, samples.covariance_mm2)
    rest = _misfit_of_rest(weights, from_rest)
    still_odds, still_weights = answers[LOG_ODDS].tolist(), list(weights)
    if moves.any():
        moving = np.flatnonzero(moves)
        part = samples.part(moving)
        weights_if_still, again = _weigh(metadata, run, part, part.noise_mm2[:, :, None] * np.eye(len(noise[0])))
        for index, odds, weight in zip(moving.tolist(), again[LOG_ODDS].tolist(), weights_if_still, strict=True):
            still_odds[index], still_weights[index] = odds, weight
    settled: list[bool] = np.asarray((noise <= SETTLED * metadata.noise.sample_mm**2).all(axis=1)).tolist()
    columns = zip(*(column.tolist() for column in answers.values()), strict=True)
    channels = samples.valid.sum(axis=1).tolist()
    return [
        Evidence(z, weight, dict(zip(answers, row, strict=True)), *said)
        for z, weight, row, *said in zip(
            from_rest, weights, columns, channels, rest, moves.tolist(), still_odds, still_weights, settled, strict=True
        )
    ]


def _rest_mm(metadata: Metadata) -> Floats:
    """Return the deflections (channels,) that a calibration found at rest."""
    calibration = metadata.calibration
    return np.array(calibration.departures.offset_mm if calibration else [0.0] * len(metadata.layout))


def _weigh(metadata: Metadata, run: Run, samples: Weighed, covariance_mm2: Floats) -> tuple[Floats, Answers]:
    """Return the whitening and the answers for samples of this covariance."""
    floor = metadata.floor
    weights = whitening(samples.deflection_mm, covariance_mm2, floor.gain, floor.zero_mm, samples.valid)
    # The answers may lie in memory that the next run uses again.
    answers = {name: values.copy() for name, values in run(samples.deflection_mm, weights).items()}
    return weights, answers


def _misfit_of_rest(whitening_per_mm: Floats, from_rest_mm: Floats) -> list[float]:
    whitened = (whitening_per_mm @ from_rest_mm[:, :, None])[:, :, 0]
    misfits: list[float] = (whitened * whitened).sum(axis=1).tolist()
    return misfits
