"""Answers of the event routes as JSON and CSV. Pure: no clock, no I/O."""

import csv
import io
from collections.abc import Sequence

from pydantic import BaseModel

from beamtouch_service.events.contradiction import Contradiction
from beamtouch_service.events.event import Begin, End, EventKind, thin
from beamtouch_service.events.event import Event as RecordedEvent
from beamtouch_service.events.store import Numbered
from beamtouch_service.surfaces.contact import ContactQuality, rfc3339


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
    contact; `open`: the event continues; `unseen`: the sample after it is not known, as it is lost or its state is."""
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


class EventWithPath(Event):
    """One event, with the path of its contact, and what was unexplained."""

    path: list[PathPoint]
    """At most 200 points, evenly spread in time, without unexplained samples."""
    capture: list[Contradiction]
    """Its first unexplained samples, channel by channel: at most 5."""


class EventList(BaseModel):
    """Events, newest touch first: all with a path, or all without."""

    events: list[EventWithPath] | list[Event]
    next: str | None
    """Value of `after` for the next page; null on the last page."""


def _members(number: int, recorded: RecordedEvent) -> dict[str, object]:
    end_us = recorded.last_us if recorded.lifted_us is None else recorded.lifted_us
    unexplained_us = recorded.unexplained_us + (max(0, end_us - recorded.last_us) if recorded.ends_unexplained else 0)
    return {
        "id": number,
        "surface": recorded.surface,
        "kind": recorded.kind,
        "touched_at": rfc3339(recorded.touched_us),
        "lifted_at": None if recorded.lifted_us is None else rfc3339(recorded.lifted_us),
        "begin": recorded.begin,
        "end": recorded.end,
        # The sender's clock may have been set back during the contact.
        "dwell_ms": max(0.0, round((end_us - recorded.touched_us) / 1e3, 3)),
        "unexplained_ms": round(unexplained_us / 1e3, 3),
        "peak_force_n": recorded.peak_force_n,
        "peak_position_mm": recorded.peak_position_mm,
        "mean_position_mm": None if recorded.mean_position_mm is None else round(recorded.mean_position_mm, 4),
        "samples": recorded.samples,
        "unsteady": recorded.unsteady,
        "quality": ContactQuality.DEGRADED if recorded.degraded else ContactQuality.GOOD,
        "model": recorded.model,
        "boot_id": recorded.boot_id,
    }


def event(number: int, recorded: RecordedEvent) -> Event:
    """Return an event without its path."""
    return Event.model_validate(_members(number, recorded))


def event_with_path(number: int, recorded: RecordedEvent) -> EventWithPath:
    """Return an event with its path."""
    points = thin(recorded.path)
    path = [{"at": rfc3339(at), "position_mm": position, "force_n": force} for at, position, force in points]
    return EventWithPath.model_validate({**_members(number, recorded), "path": path, "capture": recorded.capture})


def as_json(page: Sequence[Numbered], following: str | None, *, path: bool) -> bytes:
    """Return a page of events as an encoded `EventList`; `following` is its `next`."""
    answer = event_with_path if path else event
    events = [answer(number, one) for number, one in page]
    return EventList.model_validate({"events": events, "next": following}).model_dump_json().encode()


def as_csv(page: Sequence[Numbered]) -> bytes:
    """Return a page of events as CSV: one row per event, without paths."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(Event.model_fields), lineterminator="\r\n")
    writer.writeheader()
    for number, one in page:
        members = event(number, one).model_dump(mode="json")
        # As in JSON: `true`, not `True`.
        writer.writerow(
            {name: str(value).lower() if isinstance(value, bool) else value for name, value in members.items()}
        )
    return text.getvalue().encode()
