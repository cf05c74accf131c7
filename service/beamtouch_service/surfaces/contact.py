"""The figures of a contact: which answers of a model may be served, and how figures and times are written. Pure."""

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from math import isfinite, nan
from typing import NamedTuple

from beamtouch_common.outline import Outline, Place, Span, names_of
from beamtouch_models.runtime import CORRELATION, LOG_ODDS, MISFIT, Evidence

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DECIMALS = 4
"""0.1 um and 0.1 mN: finer than any sensor, coarse enough to hide the tail of a float32."""


class ContactQuality(StrEnum):
    """`good`: all channels took part in the answer."""

    GOOD = "good"
    DEGRADED = "degraded"


class Figures(NamedTuple):
    """Place and force of a contact with 95 % intervals."""

    place: Place
    force: Span | None = None
    """None if the model does not estimate it."""
    correlation: float | None = None
    """Of the two coordinates on a plate; None on a beam, or if the model does not estimate it."""


class UnusableEstimateError(ValueError):
    """The answer of the model must not be served as a contact."""


def figures_of(answer: Mapping[str, float], outline: Outline) -> Figures:
    """Return the figures of a contact.

    Parameters
    ----------
    answer : output name -> value, as the model file names and defines its outputs
    outline : of the structure

    Raises
    ------
    UnusableEstimateError
        A figure is not finite, the place lies off the structure, or the correlation beyond -1 to 1.
    """
    place = {axis: _span(answer, axis, "mm") for axis in outline.lengths_mm}
    force = _span(answer, "force", "n") if "force_n" in answer else None
    # An interval may reach beyond the end of the structure. One that misses it is not an answer.
    if axis := outline.find_miss(place):
        raise UnusableEstimateError(f"{axis}_mm is {answer[f'{axis}_mm']:.6g}, off {outline}")
    correlation = answer.get(CORRELATION)
    if correlation is not None:
        _require_finite(CORRELATION, correlation)
        correlation = round(correlation, _DECIMALS)
        if abs(correlation) > 1:
            raise UnusableEstimateError(f"{CORRELATION} is {correlation:g}, beyond -1 to 1")
    return Figures({axis: _rounded(span) for axis, span in place.items()}, force and _rounded(force), correlation)


def _span(answer: Mapping[str, float], figure: str, unit: str) -> Span:
    names = names_of(figure, unit)
    middle, low, high = ends = [answer.get(name, nan) for name in names]
    if not isfinite(middle + low + high):
        for name, value in zip(names, ends, strict=True):
            _require_finite(name, value)
    return Span(middle, low, high)


def _rounded(span: Span) -> Span:
    middle, low, high = span
    return Span(round(middle, _DECIMALS), round(low, _DECIMALS), round(high, _DECIMALS))


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
