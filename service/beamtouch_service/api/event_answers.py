"""Events as they are answered: the models, and JSON and CSV of them. Pure: no clock, no I/O."""

import csv
import io
from collections.abc import Sequence

from pydantic import BaseModel

from beamtouch_service.events.pieces import Begin, End, Piece
from beamtouch_service.surfaces.contact import ContactQuality, rfc3339

Numbered = tuple[int, Piece]
"""Id and content of an event."""


class PathPoint(BaseModel):
    """Where a contact was at one time."""

    at: str
    position_mm: float
    force_n: float | None


class Event(BaseModel):
    """One contact from touch to lift. Times are those of the sender's clock, RFC 3339 in UTC."""

    id: int
    surface: str
    touched_at: str
    """First sample of the contact."""
    lifted_at: str | None
    """First clear sample after it; null where that was not seen."""
    begin: Begin
    """`touch`: the sample before was clear; `unseen`: it is not known."""
    end: End
    """How it ended. `lift`: the sample after it was clear; `open`: it goes on; `stale`: samples stopped coming during
    it; `unseen`: what follows is not known; `unfinished`: the service stopped during it."""
    dwell_ms: float
    """From the touch to the lift, or to the last sample in contact where the lift was not seen."""
    peak_force_n: float | None
    """Null for a model that does not estimate force."""
    peak_position_mm: float | None
    """Where the force was at its peak."""
    mean_position_mm: float | None
    samples: int
    """Samples in contact."""
    quality: ContactQuality
    """`degraded` where some sample lacked channels."""
    model: str
    boot_id: str
    """Of the sender."""


class EventWithPath(Event):
    """One contact from touch to lift, and where it was between."""

    path: list[PathPoint]
    """At most 200 points, spread over the time of the contact."""


class EventList(BaseModel):
    """Events, the newest touch first; all of them with a path, or none."""

    events: list[EventWithPath] | list[Event]
    next: str | None
    """Give it as `after` for the next page; null on the last."""


def _members(number: int, piece: Piece) -> dict[str, object]:
    end_us = piece.last_us if piece.lifted_us is None else piece.lifted_us
    return {
        "id": number,
        "surface": piece.surface,
        "touched_at": rfc3339(piece.touched_us),
        "lifted_at": None if piece.lifted_us is None else rfc3339(piece.lifted_us),
        "begin": piece.begin,
        "end": piece.end,
        # The sender's clock may have been set during the contact; less than nothing is no duration.
        "dwell_ms": max(0.0, round((end_us - piece.touched_us) / 1e3, 3)),
        "peak_force_n": piece.peak_force_n,
        "peak_position_mm": piece.peak_position_mm,
        "mean_position_mm": round(piece.position_sum_mm / piece.samples, 4) if piece.samples else None,
        "samples": piece.samples,
        "quality": ContactQuality.DEGRADED if piece.degraded else ContactQuality.GOOD,
        "model": piece.model,
        "boot_id": piece.boot_id,
    }


def event(number: int, piece: Piece) -> Event:
    """Return an event without its path."""
    return Event.model_validate(_members(number, piece))


def event_with_path(number: int, piece: Piece) -> EventWithPath:
    """Return an event with its path."""
    path = [{"at": rfc3339(at), "position_mm": position, "force_n": force} for at, position, force in piece.path]
    return EventWithPath.model_validate({**_members(number, piece), "path": path})


def as_json(page: Sequence[Numbered], following: str | None, *, path: bool) -> bytes:
    """Return a page of events as `EventList`; `following` is its `next`."""
    events = [event_with_path(*one) for one in page] if path else [event(*one) for one in page]
    return EventList(events=events, next=following).model_dump_json().encode()


def as_csv(page: Sequence[Numbered]) -> bytes:
    """Return a page of events as CSV, a row each, without paths."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(Event.model_fields), lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(event(*one).model_dump(mode="json") for one in page)
    return text.getvalue().encode()
