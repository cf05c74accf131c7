"""The contact: the fields of its answer, and the figures that may be served. Pure: no clock, no state, no I/O."""

import operator
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from math import isfinite
from typing import NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from beamtouch_common.zones import Span, ZoneState
from beamtouch_models.runtime import LOG_ODDS, MISFIT, Evidence, State
from beamtouch_service.samples import Note

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DECIMALS = 4
"""0.1 um and 0.1 mN: finer than any sensor, coarse enough to hide the tail of a float32."""
_NOTES = " ".join(
    [
        "Limits of the answer.",
        *(f"`{note}`: {note.meaning}." for note in Note),
        "`check-NAME`, only with `unexplained`: channel NAME contradicts the others.",
    ]
)


class ContactQuality(StrEnum):
    """`good`: all channels took part in the answer."""

    GOOD = "good"
    DEGRADED = "degraded"


class Figures(NamedTuple):
    """Position and force with 95 % intervals; None without a contact or an output for it."""

    position_mm: float | None = None
    position_low_mm: float | None = None
    position_high_mm: float | None = None
    force_n: float | None = None
    force_low_n: float | None = None
    force_high_n: float | None = None

    @property
    def position(self) -> Span | None:
        """The position with its interval; None without a contact."""
        return _span(self.position_mm, self.position_low_mm, self.position_high_mm)

    @property
    def force(self) -> Span | None:
        """The force with its interval; None without a contact, or an output for it."""
        return _span(self.force_n, self.force_low_n, self.force_high_n)


def _span(middle: float | None, low: float | None, high: float | None) -> Span | None:
    return None if middle is None or low is None or high is None else Span(middle, low, high)


NO_FIGURES = Figures()


class Contact(BaseModel):
    """State of the surface; position and force of a contact with their intervals; age and origin of the answer."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    surface: str
    """Name of the surface."""
    state: State
    """`contact`: one contact explains the sample. `clear`: the beam rests. `unexplained`: neither rest nor a single
    contact explains the sample."""
    position_mm: float | None
    """Distance from the left end of the beam; null unless the state is `contact`."""
    position_low_mm: float | None
    """Lower end of the 95 % interval."""
    position_high_mm: float | None
    """Upper end of the 95 % interval."""
    force_n: float | None
    """Null without a contact, or if the model does not estimate force."""
    force_low_n: float | None
    """Lower end of the 95 % interval."""
    force_high_n: float | None
    """Upper end of the 95 % interval."""
    age_ms: float
    """Age of the sample at the time of answering, on the monotonic clocks of sender and service."""
    sampled_at: str
    """Time of the sample by the sender's clock (RFC 3339). It never decides freshness."""
    sequence: int
    """The sample's number since the sender started."""
    readings: int | None
    """Number of readings in the sample; null if its sender does not say. It grows while a contact rests."""
    misfit: float
    """Misfit of rest or of the best single contact, whichever is smaller. `misfit_limit` of `GET /surfaces/NAME` is its
    scale: where it is larger than that, neither explains the sample."""
    quality: ContactQuality
    """`good`: all channels took part. `degraded`: some did not."""
    degraded_channels: list[str]
    """Channels that took no part; empty if the quality is good."""
    notes: list[str] = Field(description=_NOTES)
    model: str
    """Name and fingerprint of the model that gave the answer."""
    zones: dict[str, ZoneState | None] = Field(default_factory=dict, exclude_if=operator.not_)
    """Zone of the configuration -> `inside`: all of the interval has been in it for as long as its dwell. `outside`:
    none of it is, or the beam is clear. `unsure`: neither. Null where no contact can be judged. Left out if no zones
    are configured."""


class UnusableEstimateError(ValueError):
    """The answer of the model must not be served as a contact."""


def figures_of(answer: Mapping[str, float], length_mm: float) -> Figures:
    """Return the figures of a contact.

    Parameters
    ----------
    answer : output name -> value, as the model file names and defines its outputs
    length_mm : length of the beam [mm]

    Raises
    ------
    UnusableEstimateError
        A figure is not finite, or the position lies off the beam.
    """
    served = {name: answer[name] for name in Figures._fields if name in answer}
    for name, value in served.items():
        _require_finite(name, value)
    # An interval may reach beyond the end of the beam. One that misses the beam is not an answer.
    position = served["position_mm"]
    if served.get("position_high_mm", position) < 0 or served.get("position_low_mm", position) > length_mm:
        raise UnusableEstimateError(f"position_mm is {position:.6g}, off a beam of {length_mm:.6g} mm")
    return Figures(**{name: round(value, _DECIMALS) for name, value in served.items()})


def require_usable(evidence: Evidence) -> None:
    """Raise UnusableEstimateError if nothing can be decided on the evidence."""
    for name in (LOG_ODDS, MISFIT):
        _require_finite(name, evidence.answer.get(name, 0.0))


def _require_finite(name: str, value: float) -> None:
    if not isfinite(value):
        raise UnusableEstimateError(f"{name} is not a finite number")


def rfc3339(unix_us: int) -> str:
    """Return a time in microseconds since 1970 as RFC 3339 in UTC, with milliseconds."""
    moment = _EPOCH + timedelta(microseconds=unix_us)
    return moment.replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"
