"""The contact, and its decision from the answer of the model. Pure: no clock, no state, no I/O."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from math import isfinite

from pydantic import BaseModel

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DECIMALS = 4
"""0.1 um and 0.1 mN: finer than any sensor, coarse enough to hide the tail of a float32."""

LOG_ODDS = "contact_log_odds"


class State(StrEnum):
    """Whether something touches the surface."""

    CONTACT = "contact"
    CLEAR = "clear"


class ContactQuality(StrEnum):
    """Whether all channels took part in the answer."""

    GOOD = "good"
    DEGRADED = "degraded"


@dataclass(frozen=True, slots=True)
class Figures:
    """Position and force with 95 % intervals; None without a contact or an output for it."""

    position_mm: float | None = None
    position_low_mm: float | None = None
    position_high_mm: float | None = None
    force_n: float | None = None
    force_low_n: float | None = None
    force_high_n: float | None = None


_FIGURES = tuple(field.name for field in fields(Figures))
_NO_FIGURES = Figures()


class Contact(BaseModel):
    """Whether something touches the surface, where, how hard, how surely, and when."""

    surface: str
    state: State
    position_mm: float | None
    """From the left end of the beam; null when clear."""
    position_low_mm: float | None
    """Lower end of the 95 % interval."""
    position_high_mm: float | None
    force_n: float | None
    """Null when clear, or if the model does not estimate force."""
    force_low_n: float | None
    force_high_n: float | None
    age_ms: float
    """Age of the sample at the time of answering, on the monotonic clocks of sender and service."""
    sampled_at: str
    """Time of the sample by the sender's clock (RFC 3339). It never decides freshness."""
    sequence: int
    """The sample's number since the sender started."""
    quality: ContactQuality
    degraded_channels: list[str]
    """Channels that took no part; empty if the quality is good."""
    notes: list[str]
    """Limits of the answer. `rate`: the device does not keep its rate."""
    model: str
    """Name and fingerprint of the model that gave the answer."""


@dataclass(frozen=True, slots=True)
class Decision:
    """State and figures that follow from an answer of the model."""

    state: State
    figures: Figures


class UnusableEstimateError(ValueError):
    """The answer of the model must not be served as a contact."""


def decide(estimate: Mapping[str, float], threshold: float, length_mm: float) -> Decision:
    """Decide on the state and the figures.

    Parameters
    ----------
    estimate : output name -> value, as the model file names and defines its outputs
    threshold : contact is stated when `contact_log_odds` exceeds it [nats]
    length_mm : length of the beam [mm]

    Raises
    ------
    UnusableEstimateError
        A figure that would be served is not finite, or the position lies off the beam.
    """
    log_odds = estimate[LOG_ODDS]
    _require_finite(LOG_ODDS, log_odds)
    if log_odds <= threshold:
        return Decision(State.CLEAR, _NO_FIGURES)
    served = {name: estimate[name] for name in _FIGURES if name in estimate}
    # A sum of finite 32-bit values is finite, so one test covers all.
    if not isfinite(sum(served.values())):
        for name, value in served.items():
            _require_finite(name, value)
    # An interval may reach beyond the end of the beam. One that misses the beam is not an answer.
    position = served["position_mm"]
    if served.get("position_high_mm", position) < 0 or served.get("position_low_mm", position) > length_mm:
        message = f"position_mm is {position:.6g}, off a beam of {length_mm:.6g} mm"
        raise UnusableEstimateError(message)
    return Decision(State.CONTACT, Figures(**{name: round(value, _DECIMALS) for name, value in served.items()}))


def _require_finite(name: str, value: float) -> None:
    if not isfinite(value):
        message = f"{name} is not a finite number"
        raise UnusableEstimateError(message)


def rfc3339(unix_us: int) -> str:
    """Return a time in microseconds since 1970 as RFC 3339 in UTC, with milliseconds."""
    moment = _EPOCH + timedelta(microseconds=unix_us)
    return moment.replace(tzinfo=None).isoformat(timespec="milliseconds") + "Z"
