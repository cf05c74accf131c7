"""The best sample of an event: the mean of one rested stretch, with the rest before the touch. Pure.

A sample of many readings is better than one of few. Samples of one stretch share readings, so that only one is kept.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from beamtouch_models.modelfile import ModelFile, State
from beamtouch_service.surfaces.estimates import Estimated
from beamtouch_service.surfaces.judge import Judged

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
        """Return what an event keeps; None if it keeps nothing, or nothing that can be read."""
        try:
            return cls(**kept) if kept else None
        except TypeError:
            return None

    @property
    def rank(self) -> tuple[bool, int]:
        """The larger, the better."""
        return self.is_contact, self.readings


@dataclass
class _Mean:
    """A sample of the clear beam, or the mean of several that share no readings."""

    mm: Values
    variance_mm2: Values
    weight: float
    """Its readings."""


@dataclass
class _Newest(_Mean):
    """The newest sample that counts."""

    begin_us: float
    """Begin of its readings."""
    at_us: int


class Rest:
    """The clear beam since the last event."""

    def __init__(self, before: _Mean | None = None, newest: _Newest | None = None) -> None:
        self._before, self._newest = before, newest

    @classmethod
    def of(cls, kept: list[dict[str, Any] | None]) -> "Rest":
        """Return what `kept` gave; raises TypeError or ValueError for anything else."""
        before, newest = kept
        return cls(_Mean(**before) if before else None, _Newest(**newest) if newest else None)

    def kept(self) -> list[dict[str, Any] | None]:
        """Return it as JSON."""
        return [dict(vars(one)) if one else None for one in (self._before, self._newest)]

    def add(self, sample: Estimated, readings: int, duration_us: float) -> None:
        """Add a sample whose readings took this long, unless it shares some with the samples so far."""
        begin_us, newest = sample.acquired_unix_us - duration_us, self._newest
        if newest is None or begin_us >= newest.at_us:
            self._before = self._all()
        elif begin_us > newest.begin_us or readings <= newest.weight:
            return
        values_mm: Values = sample.weighed.deflection_mm[sample.row].tolist()
        variances = _variances(sample).tolist()
        self._newest = _Newest(values_mm, variances, readings, begin_us, sample.acquired_unix_us)

    def mean(self) -> tuple[Values, Values] | None:
        """Return mean and standard deviations. The newest of several is left out: it may hold the touch."""
        rest = self._before or self._newest
        return (rest.mm, np.sqrt(rest.variance_mm2).tolist()) if rest else None

    def _all(self) -> _Mean | None:
        """Return the mean of all samples so far."""
        before, newest = self._before, self._newest
        if before is None or newest is None:
            return newest and _Mean(newest.mm, newest.variance_mm2, newest.weight)
        known = min(before.weight, MAX_AT_REST * newest.weight)
        total = known + newest.weight
        shares = known / total, newest.weight / total
        pairs = zip(before.mm, newest.mm, before.variance_mm2, newest.variance_mm2, strict=True)
        found = [
            (shares[0] * old_mm + shares[1] * new_mm, shares[0] ** 2 * old_mm2 + shares[1] ** 2 * new_mm2)
            for old_mm, new_mm, old_mm2, new_mm2 in pairs
        ]
        return _Mean([mm for mm, _ in found], [mm2 for _, mm2 in found], total)


class BestSamples:
    """Finds the best samples in the decisions on one sender."""

    def __init__(self, model: ModelFile, rest: Rest) -> None:
        metadata = model.metadata
        self._channels = model.channels
        self._settled = max(1, round((metadata.noise.reading_mm / metadata.noise.sample_mm) ** 2))
        """Readings of a sample whose sender states none."""
        self._reading_us = 1e6 / metadata.sensor.rate_hz
        self.rest = rest

    def lift(self) -> None:
        """Forget the rest: another begins."""
        self.rest = Rest()

    def clear(self, judged: Judged) -> None:
        """Add a sample of the clear beam to the rest."""
        if not judged.is_odd and _is_steady(judged):
            readings = self._readings(judged)
            self.rest.add(judged.estimated, readings, readings * self._reading_us)

    def best(self, known: Best | None, judged: Judged) -> Best | None:
        """Return the better one of the best sample so far and this one."""
        sample, is_contact = judged.estimated, judged.state is State.CONTACT and not judged.is_odd
        readings = self._readings(judged)
        if known and known.rank >= (is_contact, readings):
            return known
        if not _is_steady(judged) or not (is_contact or judged.state is State.UNEXPLAINED):
            return known
        rest_mm, rest_deviation_mm = self.rest.mean() or (None, None)
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

    def _readings(self, judged: Judged) -> int:
        return judged.estimated.readings or self._settled


def _is_steady(judged: Judged) -> bool:
    """Return whether all channels are good and the beam is still."""
    return not judged.estimated.bad and judged.state is not None and not judged.is_unsteady


def _variances(sample: Estimated) -> np.ndarray:
    variances: np.ndarray = sample.weighed.covariance_mm2[sample.row].diagonal()
    return variances
