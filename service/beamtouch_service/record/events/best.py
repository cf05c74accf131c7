"""The best sample of an event: the mean of one rested stretch, with the rest before the touch. Pure.

A sample of many readings is better than one of few. Samples of one stretch share readings, so that only one is kept.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
from pydantic import TypeAdapter

from beamtouch_models.runtime import ModelFile, State
from beamtouch_service.surfaces.follower import Decision

MAX_AT_REST = 16
"""Samples that the mean of a rest counts for at most, so that it follows the zeros."""

MINUTE_US = 60e6
_DIGITS, _DEVIATION_DIGITS = 6, 4
"""Significant digits on record of deflections and of their deviations: far below any noise, and half of the bytes."""

Values = list[float]
"""One value per channel."""


@dataclass(frozen=True)
class Best:
    """The best sample of an event. It is kept with the event, as JSON."""

    at_us: int
    """Time of the sample, by the sender's clock [us since 1970]."""
    is_contact: bool
    """True if a single contact explains it. If none explains any sample of the event, the best of all is kept."""
    readings: int
    characteristic: str | None
    """Identity of the sender's characteristics and rest gaps; None if it states none."""
    channels: list[str]
    deflection_mm: Values
    deviation_mm: Values
    """Standard deviations."""
    rest_mm: Values | None = None
    """Mean deflections of the clear beam before the touch; None if that was not seen."""
    rest_deviation_mm: Values | None = None

    @classmethod
    def read(cls, kept: dict[str, Any] | None) -> "Best | None":
        """Return the best sample that an event keeps; None if it keeps none, or one that cannot be read."""
        try:
            return _BEST.validate_python(kept) if kept else None
        except ValueError:
            return None


_BEST = TypeAdapter(Best)


class Mean(NamedTuple):
    """A mean of samples that share no readings."""

    mm: Values
    variance_mm2: Values
    weight: float
    """Its readings."""


@dataclass
class DisjointMean:
    """Averages samples, weighted by their readings.

    Means of successive samples share readings. Of samples that share some, the one with the most readings counts; of
    equal ones the first. The next one is the first that shares none with it.
    """

    before: Mean | None = None
    """The mean of all samples that count but the newest."""
    newest: Mean | None = None
    begin_us: float = 0.0
    """Begin of the readings of the newest sample that counts."""
    end_us: float = 0.0

    @classmethod
    def read(cls, kept: dict[str, Any] | None) -> "DisjointMean":
        """Return what `to_json` gave; raises TypeError for anything else."""
        if kept is None:
            return cls()
        before, newest = (kept[name] and Mean(*kept[name]) for name in ("before", "newest"))
        return cls(**kept | {"before": before, "newest": newest})

    def to_json(self) -> dict[str, Any]:
        """Return it as JSON."""
        return asdict(self)

    def add(
        self,
        at_us: int,
        readings: int,
        reading_us: float,
        mm: Values,
        variance_mm2: Values,
        max_samples: float = float("inf"),
    ) -> None:
        """Add a sample of this time, unless it shares readings with one that is better.

        The mean before it counts for at most `max_samples` samples like it.
        """
        # Times of readings scatter; half a period is no reading in common.
        begin_us = at_us - (readings - 0.5) * reading_us
        if self.newest is None or begin_us >= self.end_us:
            self.before = self.of_all(max_samples)
        elif begin_us > self.begin_us or readings <= self.newest.weight:
            return
        self.newest, self.begin_us, self.end_us = Mean(mm, variance_mm2, readings), begin_us, at_us

    def of_all(self, max_samples: float = float("inf")) -> Mean | None:
        """Return the mean of all samples; None before the first."""
        before, newest = self.before, self.newest
        if before is None or newest is None:
            return newest
        known = min(before.weight, max_samples * newest.weight)
        old, new = known / (known + newest.weight), newest.weight / (known + newest.weight)
        mm = [old * one + new * other for one, other in zip(before.mm, newest.mm, strict=True)]
        pairs = zip(before.variance_mm2, newest.variance_mm2, strict=True)
        return Mean(mm, [old**2 * one + new**2 * other for one, other in pairs], known + newest.weight)


class BestSamples:
    """Finds the best samples in the decisions on one sender."""

    def __init__(self, model: ModelFile, rest: DisjointMean) -> None:
        """Begin with the mean of the clear beam since the last event."""
        noise = model.metadata.noise
        self._channels = model.channels
        self._settled = max(1, round((noise.reading_mm / noise.sample_mm) ** 2))
        """Readings of a sample whose sender states none."""
        self.reading_us = 1e6 / model.metadata.sensor.rate_hz
        """Time from one reading to the next."""
        self.rest = rest
        self._drift_mm_per_min = model.metadata.floor.drift_mm_per_min

    def add_rest(self, decision: Decision) -> None:
        """Add a sample of the clear beam to the rest."""
        if decision.is_odd or not _is_steady(decision):
            return
        at_us, (mm, variance_mm2) = decision.estimate.sample.acquired_unix_us, _values(decision)
        self.rest.add(at_us, self._readings(decision), self.reading_us, mm, variance_mm2, MAX_AT_REST)

    def choose(self, so_far: Best | None, decision: Decision) -> Best | None:
        """Return the better one of the best sample so far and this one."""
        readings = self._readings(decision)
        is_contact = decision.state is State.CONTACT and not decision.is_odd
        if so_far and (so_far.is_contact, so_far.readings) >= (is_contact, readings):
            return so_far
        if not _is_steady(decision) or not (is_contact or decision.state is State.UNEXPLAINED):
            return so_far
        # The newest sample of several at rest may hold the touch.
        rest = self.rest.before or self.rest.newest
        deflection_mm, variance_mm2 = _values(decision)
        at_us = decision.estimate.sample.acquired_unix_us
        drifted_mm = self._drift_mm_per_min * max(0.0, at_us - self.rest.end_us) / MINUTE_US
        return Best(
            at_us=at_us,
            is_contact=is_contact,
            readings=readings,
            characteristic=decision.estimate.characteristic,
            channels=self._channels,
            deflection_mm=_short(deflection_mm, _DIGITS),
            deviation_mm=_short(np.sqrt(variance_mm2), _DEVIATION_DIGITS),
            rest_mm=_short(rest.mm, _DIGITS) if rest else None,
            rest_deviation_mm=(
                _short(np.sqrt(np.array(rest.variance_mm2) + drifted_mm**2), _DEVIATION_DIGITS) if rest else None
            ),
        )

    def _readings(self, decision: Decision) -> int:
        return decision.estimate.sample.readings or self._settled


def _short(values: Iterable[float], digits: int) -> Values:
    return [float(f"{value:.{digits}g}") for value in values]


def _is_steady(decision: Decision) -> bool:
    """Return whether all channels are good and the beam is still."""
    return not decision.estimate.bad and decision.state is not None and not decision.is_unsteady


def _values(decision: Decision) -> tuple[Values, Values]:
    """Return deflections [mm] and their variances [mm^2]."""
    together, row = decision.estimate.together, decision.estimate.row
    return together.deflection_mm[row].tolist(), together.covariance_mm2[row].diagonal().tolist()
