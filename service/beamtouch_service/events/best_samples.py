"""The best sample of an event: the mean of one rested stretch, with the rest before the touch. Pure.

A sample of many readings is better than one of few. Samples of one stretch share readings, so that only one is kept.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from beamtouch_models.modelfile import ModelFile, State
from beamtouch_service.samples import Note
from beamtouch_service.surfaces.contact import Decision
from beamtouch_service.surfaces.estimates import Estimated
from beamtouch_service.surfaces.follower import Seen

MAX_AT_REST = 16
"""Samples that the mean of a rest counts for at most, so that it follows the zeros."""

Values = list[float]
"""One value per channel."""


@dataclass(frozen=True)
class Best:
    """The best sample of an event. It is kept with the event, as JSON."""

    at_us: int
    """Time of the sample, by the sender's clock [us since 1970]."""
    is_contact: bool
    """Whether a single contact explains it. If none explains any sample of the event, the best of all is kept."""
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
    def of(cls, kept: dict[str, Any] | None) -> "Best | None":
        """Return what an event keeps; None if it keeps nothing, or if another version wrote it in another way."""
        try:
            return cls(**kept) if kept else None
        except TypeError:
            return None

    @property
    def rank(self) -> tuple[bool, int]:
        """The larger, the better."""
        return self.is_contact, self.readings


def better(left: Best | None, right: Best | None) -> Best | None:
    """Return the better one of an event in two parts, with the rest before the first; `left` began earlier."""
    if left is None or right is None or left.rank >= right.rank:
        return left or right
    return right if right.rest_mm else replace(right, rest_mm=left.rest_mm, rest_deviation_mm=left.rest_deviation_mm)


class _Rest:
    """Samples of the clear beam that share no readings."""

    def __init__(self) -> None:
        self._sums: tuple[np.ndarray, np.ndarray, float] | None = None
        """Deflections, their variances and 1, each times the readings of a sample (variances: times their square)."""
        self._newest: tuple[float, int, Estimated] | None = None
        """Begin of its readings [us], number of readings, and the sample."""

    def add(self, sample: Estimated, readings: int, duration_us: float) -> None:
        """Add a sample whose readings took this long, unless it shares some with the samples so far."""
        begin_us, newest = sample.acquired_unix_us - duration_us, self._newest
        if newest is None or begin_us >= newest[2].acquired_unix_us:
            self._sums = self._with(newest)
        elif begin_us > newest[0] or readings <= newest[1]:
            return
        self._newest = begin_us, readings, sample

    def mean(self) -> tuple[Values, Values] | None:
        """Return mean and standard deviations. The newest of several is left out: it may hold the touch."""
        found = self._sums or self._with(self._newest)
        if found is None:
            return None
        total, variance, weight = found
        return (total / weight).tolist(), (np.sqrt(variance) / weight).tolist()

    def _with(self, added: tuple[float, int, Estimated] | None) -> tuple[np.ndarray, np.ndarray, float] | None:
        if added is None:
            return self._sums
        _, readings, sample = added
        values, variances = sample.weighed.deflection_mm[sample.row], _variances(sample)
        if self._sums is None:
            return values * readings, variances * readings**2, float(readings)
        total, variance, weight = self._sums
        kept = min(1.0, MAX_AT_REST * readings / weight)
        return total * kept + values * readings, variance * kept**2 + variances * readings**2, weight * kept + readings


class BestSamples:
    """Finds the best samples in the decisions on one sender."""

    def __init__(self, model: ModelFile) -> None:
        said = model.metadata
        self._channels = model.channels
        self._settled = max(1, round((said.noise.reading_mm / said.noise.sample_mm) ** 2))
        """Readings of a sample whose sender states none."""
        self._reading_us = 1e6 / said.sensor.rate_hz
        self._rest = _Rest()

    def lift(self) -> None:
        """Forget the rest: another begins."""
        self._rest = _Rest()

    def clear(self, seen: Seen) -> None:
        """Add a sample of the clear beam to the rest."""
        if not seen.is_odd and _is_steady(seen):
            readings = self._readings(seen)
            self._rest.add(seen.estimated, readings, readings * self._reading_us)

    def best(self, known: Best | None, seen: Seen) -> Best | None:
        """Return the better one of the best sample so far and this one."""
        sample, is_contact = seen.estimated, seen.state is State.CONTACT and not seen.is_odd
        readings = self._readings(seen)
        if known and known.rank >= (is_contact, readings):
            return known
        if not _is_steady(seen) or not (is_contact or seen.state is State.UNEXPLAINED):
            return known
        rest_mm, rest_deviation_mm = self._rest.mean() or (None, None)
        return Best(
            sample.acquired_unix_us,
            is_contact,
            readings,
            sample.characteristic,
            self._channels,
            sample.weighed.deflection_mm[sample.row].tolist(),
            np.sqrt(_variances(sample)).tolist(),
            rest_mm,
            rest_deviation_mm,
        )

    def _readings(self, seen: Seen) -> int:
        return seen.estimated.readings or self._settled


def _is_steady(seen: Seen) -> bool:
    """Return whether all channels are good and the beam is still."""
    outcome = seen.outcome
    return not seen.estimated.bad and isinstance(outcome, Decision) and Note.UNSTEADY not in outcome.notes


def _variances(sample: Estimated) -> np.ndarray:
    variances: np.ndarray = sample.weighed.covariance_mm2[sample.row].diagonal()
    return variances
