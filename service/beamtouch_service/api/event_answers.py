"""Answers of the event routes as JSON and CSV. Pure: no clock, no I/O."""

import csv
import io
from collections import Counter
from collections.abc import Sequence

from pydantic import BaseModel

from beamtouch_service.events.segments import Begin, End, EventKind, Segment
from beamtouch_service.events.writing import Numbered
from beamtouch_service.surfaces.contact import ContactQuality, rfc3339
from beamtouch_service.surfaces.contradiction import Contradiction


class PathPoint(BaseModel):
    """The position and force of a contact at one time."""

    at: str
    position_mm: float
    force_n: float | None


class Event(BaseModel):
    """One contact from touch to lift, or one unexplained stretch. Times are from the sender's clock, in UTC."""

    id: int
    surface: str
    kind: EventKind
    """`contact`: a contact, with the unexplained stretches during it; `unexplained`: a stretch without a contact
    before it, which has neither force nor position."""
    touched_at: str
    """Time of the first sample of the event (RFC 3339)."""
    lifted_at: str | None
    """Time of the first clear sample after it; null if that is not known."""
    begin: Begin
    """`touch` (a contact) or `clear` (a stretch): the sample before was clear; `unexplained`: a contact after an
    unexplained stretch, so its touch was not seen; `unseen`: the sample before is not known."""
    end: End
    """`lift` (a contact) or `clear` (a stretch): the sample after it was clear; `unexplained`: a contact whose last
    samples are unexplained before a clear one, so it was lifted somewhere in them; `contact`: a stretch before a
    contact; `open`: the event continues; `stale`: the samples stopped during it; `unseen`: the sample after it is not
    known; `unfinished`: the service stopped during it."""
    dwell_ms: float
    """Time from the first sample to `lifted_at`, or to the last sample if that is null."""
    unexplained_ms: float
    """The part of `dwell_ms` that was unexplained. It counts in no force and no position."""
    peak_force_n: float | None
    """Null without a contact, or if the model does not estimate force."""
    peak_position_mm: float | None
    """Position at the peak force."""
    mean_position_mm: float | None
    samples: int
    """Number of samples in the mean position."""
    unsteady: bool
    """Whether peak and mean are those of unsteady samples, because the event has no others."""
    quality: ContactQuality
    """`degraded` if at least one sample lacked channels."""
    model: str
    boot_id: str
    """Boot id of the sender."""
    capture: bool
    """Whether samples of its unexplained stretches can be downloaded."""


class EventWithPath(Event):
    """One event, with the path of its contact."""

    path: list[PathPoint]
    """At most 200 points, evenly spread in time, without unexplained samples."""


class EventList(BaseModel):
    """Events, newest touch first: all with a path, or all without."""

    events: list[EventWithPath] | list[Event]
    next: str | None
    """Value of `after` for the next page; null on the last page."""


class EventCapture(BaseModel):
    """Samples of the unexplained stretches of an event, in order."""

    id: int
    surface: str
    model: str
    explained_without: dict[str, int]
    """Channel -> number of these samples that rest or a single contact explains without it. A channel that has them
    all, while the others have few, contradicts the others."""
    samples: list[Contradiction]
    """At most 600: of each stretch the first 200, then fewer and fewer, 25 each time that it becomes twice as long."""


def _members(number: int, segment: Segment, *, captured: bool) -> dict[str, object]:
    end_us = segment.last_us if segment.lifted_us is None else segment.lifted_us
    unexplained_us = segment.unexplained_us + (max(0, end_us - segment.last_us) if segment.ends_unexplained else 0)
    return {
        "id": number,
        "surface": segment.surface,
        "kind": segment.kind,
        "touched_at": rfc3339(segment.touched_us),
        "lifted_at": None if segment.lifted_us is None else rfc3339(segment.lifted_us),
        "begin": segment.begin,
        "end": segment.end,
        # The sender's clock may have been set back during the contact.
        "dwell_ms": max(0.0, round((end_us - segment.touched_us) / 1e3, 3)),
        "unexplained_ms": round(unexplained_us / 1e3, 3),
        "peak_force_n": segment.peak_force_n,
        "peak_position_mm": segment.peak_position_mm,
        "mean_position_mm": round(segment.position_sum_mm / segment.samples, 4) if segment.samples else None,
        "samples": segment.samples,
        "unsteady": segment.unsteady,
        "quality": ContactQuality.DEGRADED if segment.degraded else ContactQuality.GOOD,
        "model": segment.model,
        "boot_id": segment.boot_id,
        "capture": captured,
    }


def event(number: int, segment: Segment, *, captured: bool) -> Event:
    """Return an event without its path; `captured` says whether samples of it are kept."""
    return Event.model_validate(_members(number, segment, captured=captured))


def event_with_path(number: int, segment: Segment, *, captured: bool) -> EventWithPath:
    """Return an event with its path; `captured` says whether samples of it are kept."""
    path = [{"at": rfc3339(at), "position_mm": position, "force_n": force} for at, position, force in segment.path]
    return EventWithPath.model_validate({**_members(number, segment, captured=captured), "path": path})


def as_json(page: Sequence[Numbered], captured: set[int], following: str | None, *, path: bool) -> bytes:
    """Return a page of events as an encoded `EventList`; `captured` are those with samples, `following` its `next`."""
    answer = event_with_path if path else event
    events = [answer(number, one, captured=number in captured) for number, one in page]
    return EventList.model_validate({"events": events, "next": following}).model_dump_json().encode()


def as_csv(page: Sequence[Numbered], captured: set[int]) -> bytes:
    """Return a page of events as CSV: one row per event, without paths; `captured` are those with samples."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(Event.model_fields), lineterminator="\r\n")
    writer.writeheader()
    for number, one in page:
        members = event(number, one, captured=number in captured).model_dump(mode="json")
        # As in JSON: `true`, not `True`.
        writer.writerow(
            {name: str(value).lower() if isinstance(value, bool) else value for name, value in members.items()}
        )
    return text.getvalue().encode()


def capture(number: int, segment: Segment, samples: list[Contradiction]) -> EventCapture:
    """Return the kept samples of the unexplained stretches of an event."""
    counts = Counter({channel.name: 0 for sample in samples for channel in sample.channels})
    counts.update(channel.name for sample in samples for channel in sample.channels if channel.explained_without)
    return EventCapture(
        id=number, surface=segment.surface, model=segment.model, explained_without=dict(counts), samples=samples
    )
