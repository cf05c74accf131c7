"""Begin and end of a contact: two thresholds, applied to samples in the order in which they were taken. Pure."""

from dataclasses import dataclass
from math import isfinite

import numpy as np

from beamtouch_models.modelfile import ModelFile
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.surfaces.contact import LOG_ODDS, Decision, State, UnusableEstimateError, decide
from beamtouch_service.surfaces.estimates import Estimated, whitening_of

LIFT_FRACTION = 1 / 8
"""The point between rest and the threshold of touch where a contact ends, as a fraction of the log odds.

Log odds grow as the square of deflection over noise, so a contact ends at about a third (the root of 1/8) of the
deflection that began it. Of 200 000 simulated samples each of four scenes (bench, paper, conveyor, two-spans; default
estimator), a load that stands exactly at the threshold of touch falls below this in 0.08 % at most, in 0.014 % or fewer
of the three single spans; below half the log odds it falls in 0.8 to 7.5 %. A beam at rest is below this in 72 to 91 %
of its samples, so a lift is seen in the first or second sample. Lower would cost lifts and hold a contact on drift.
"""


@dataclass(frozen=True)
class Levels:
    """The two thresholds of `contact_log_odds` [nats], and the length of the beam."""

    touch: tuple[float, ...]
    """A contact begins above it; by the number of valid channels, from one on."""
    lift: tuple[float, ...]
    """A contact ends at or below it; likewise."""
    length_mm: float


def levels(model: ModelFile) -> Levels:
    """Return the thresholds of a model. The lift threshold follows from its answer to a beam at rest."""
    metadata = model.metadata
    channels = len(metadata.layout)
    rest = metadata.calibration.departures.offset_mm if metadata.calibration else [0.0] * channels
    deflection_mm, valid = np.array([rest], np.float32), np.ones((1, channels), np.bool_)
    answer = model.estimate(deflection_mm, whitening_of(model, deflection_mm, valid))
    touch = tuple(metadata.thresholds.touch)
    log_odds = float(answer[LOG_ODDS][0]) if LOG_ODDS in answer else touch[-1]
    # A model that does not tell rest from a touch gets one threshold.
    lift = tuple(
        log_odds + LIFT_FRACTION * (one - log_odds) if isfinite(log_odds) and log_odds < one else one for one in touch
    )
    return Levels(touch, lift, metadata.length_mm)


@dataclass(frozen=True, slots=True)
class Seen:
    """The decision on one sample."""

    estimated: Estimated
    outcome: Decision | Problem
    touching: bool
    """Also true for undecided samples that follow a contact closely."""

    @property
    def state(self) -> State | None:
        """The state; None if it could not be decided."""
        return self.outcome.state if isinstance(self.outcome, Decision) else None


class Follower:
    """Decides on the samples of one sender, in the order of their numbers.

    Over gaps and undecided samples, a contact is held for `hold_ms` of the sender's time.
    """

    def __init__(self, levels: Levels, surface: str, hold_ms: float, *, touching: bool = False) -> None:
        self._levels = levels
        self._surface = surface
        self._hold_us = hold_ms * 1e3
        self._touching = touching
        self._last: Estimated | None = None
        """The last decided sample."""

    def step(self, estimated: Estimated) -> Seen:
        """Decide on the next sample."""
        last = self._last
        # The sample before this one may be missing, or undecided.
        if last and estimated.sequence != last.sequence + 1:
            self._touching &= abs(estimated.acquired_unix_us - last.acquired_unix_us) <= self._hold_us
        outcome = self._decide(estimated)
        if isinstance(outcome, Decision):
            self._touching = outcome.state is State.CONTACT
            self._last = estimated
        return Seen(estimated, outcome, self._touching)

    def _decide(self, estimated: Estimated) -> Decision | Problem:
        if isinstance(estimated.answer, Problem):
            return estimated.answer
        by_channels = self._levels.lift if self._touching else self._levels.touch
        try:
            return decide(estimated.answer, by_channels[-1 - len(estimated.bad)], self._levels.length_mm)
        except UnusableEstimateError as error:
            detail = (
                f"For the newest sample, {error}. Check the characteristics and tare of the sensors, then the model."
            )
            return Problem(Kind.UNUSABLE_ESTIMATE, detail, self._surface)
