"""Answers of the event routes as JSON and CSV. Pure: no clock, no I/O."""

import csv
import io
from collections.abc import Sequence

from pydantic import BaseModel

from beamtouch_service.events.segments import Begin, End, Segment
from beamtouch_service.events.store import Numbered
from beamtouch_service.surfaces.contact import ContactQuality, rfc3339


class PathPoint(BaseModel):
    """The position and force of a contact at one time."""

    at: str
    position_mm: float
    force_n: float | None


class Event(BaseModel):
    """One contact from touch to lift. Times are from the sender's clock, as RFC 3339 in UTC."""

    id: int
    surface: str
    touched_at: str
    """Time of the first sample of the contact."""
    lifted_at: str | None
    """Time of the first clear sample after it; null if the lift was not seen."""
    begin: Begin
    """`touch`: the sample before was clear; `unseen`: that sample is not known."""
    end: End
    """`lift`: the sample after it was clear; `open`: the contact continues; `stale`: the samples stopped during
    the contact; `unseen`: the sample after it is not known; `unfinished`: the service stopped during the contact."""
    dwell_ms: float
    """Time from touch to lift, or to the last sample in contact if the lift was not seen."""
    peak_force_n: float | None
    """Null if the model does not estimate force."""
    peak_position_mm: float | None
    """Position at the peak force."""
    mean_position_mm: float | None
    samples: int
    """Number of samples in contact."""
    quality: ContactQuality
    """`degraded` if at least one sample lacked channels."""
    model: str
    boot_id: str
    """Boot id of the sender."""


class EventWithPath(Event):
    """One contact from touch to lift, with its path."""

    path: list[PathPoint]
    """At most 200 points, evenly spread in time."""


class EventList(BaseModel):
    """Events, newest touch first: all with a path, or all without."""

    events: list[EventWithPath] | list[Event]
    next: str | None
    """Value of `after` for the next page; null on the last page."""


def _members(number: int, segment: Segment) -> dict[str, object]:
    end_us = segment.last_us if segment.lifted_us is None else segment.lifted_us
    return {
        "id": number,
        "surface": segment.surface,
        "touched_at": rfc3339(segment.touched_us),
        "lifted_at": None if segment.lifted_us is None else rfc3339(segment.lifted_us),
        "begin": segment.begin,
        "end": segment.end,
        # The sender's clock may have been set back during the contact.
        "dwell_ms": max(0.0, round((end_us - segment.touched_us) / 1e3, 3)),
        "peak_force_n": segment.peak_force_n,
        "peak_position_mm": segment.peak_position_mm,
        "mean_position_mm": round(segment.position_sum_mm / segment.samples, 4) if segment.samples else None,
        "samples": segment.samples,
        "quality": ContactQuality.DEGRADED if segment.degraded else ContactQuality.GOOD,
        "model": segment.model,
        "boot_id": segment.boot_id,
    }


def event(number: int, segment: Segment) -> Event:
    """Return an event without its path."""
    return Event.model_validate(_members(number, segment))


def event_with_path(number: int, segment: Segment) -> EventWithPath:
    """Return an event with its path."""
    path = [{"at": rfc3339(at), "position_mm": position, "force_n": force} for at, position, force in segment.path]
    return EventWithPath.model_validate({**_members(number, segment), "path": path})


def as_json(page: Sequence[Numbered], following: str | None, *, path: bool) -> bytes:
    """Return a page of events as an encoded `EventList`; `following` is its `next`."""
    events = [event_with_path(*one) for one in page] if path else [event(*one) for one in page]
    return EventList(events=events, next=following).model_dump_json().encode()


def as_csv(page: Sequence[Numbered]) -> bytes:
    """Return a page of events as CSV: one row per event, without paths."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(Event.model_fields), lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(event(*one).model_dump(mode="json") for one in page)
    return text.getvalue().encode()
