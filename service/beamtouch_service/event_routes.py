"""The route of the events."""

import csv
import io
from asyncio import wrap_future
from collections.abc import Sequence
from datetime import datetime
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request, Response
from pydantic import AwareDatetime, BaseModel, BeforeValidator, ConfigDict, Field

from beamtouch_service import documentation
from beamtouch_service.contact import ContactQuality, rfc3339
from beamtouch_service.event_store import Selection
from beamtouch_service.events import Begin, End, Piece
from beamtouch_service.handlers import NO_STORE
from beamtouch_service.problems import Kind
from beamtouch_service.recorder import Recorder
from beamtouch_service.registry import Registry
from beamtouch_service.samples import SurfaceName

CSV = "text/csv"
_MAX_LIMIT = 1000


def _rfc3339(value: object) -> object:
    # Bare numbers would be taken for seconds since 1970, or for milliseconds where they are large.
    if isinstance(value, str) and "T" not in value.upper():
        message = "a time as in 2026-11-20T23:40:46Z is expected"
        raise ValueError(message)
    return value


_Time = Annotated[AwareDatetime, BeforeValidator(_rfc3339)]


class EventQuery(BaseModel):
    """What may be asked of the events."""

    model_config = ConfigDict(extra="forbid")

    surface: SurfaceName | None = Field(None, description="Only events of this surface.")
    since: _Time | None = Field(None, description="Only events that began then or later (RFC 3339, best with Z).")
    until: _Time | None = Field(None, description="Only events that began before.")
    after: str | None = Field(
        None, pattern=r"^[0-9]{1,17}\.[0-9]{1,18}$", description="`next` of the last page: go on behind it."
    )
    limit: int = Field(100, ge=1, le=_MAX_LIMIT, description="Most events on a page.")
    format: Literal["json", "csv"] | None = Field(None, description="Instead of the header `Accept`.")


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
    """`lift`; `open`: it goes on; `unseen`: what follows is not known; `unfinished`: the service stopped during it."""
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
    path: list[PathPoint]
    """At most 200 points, spread over the time of the contact."""


class EventList(BaseModel):
    """Events, the newest touch first."""

    events: list[Event]
    next: str | None
    """Give it as `after` for the next page; null on the last."""


_CSV_COLUMNS = [name for name in Event.model_fields if name != "path"]


def _event(number: int, piece: Piece) -> Event:
    end_us = piece.last_us if piece.lifted_us is None else piece.lifted_us
    return Event(
        id=number,
        surface=piece.surface,
        touched_at=rfc3339(piece.touched_us),
        lifted_at=None if piece.lifted_us is None else rfc3339(piece.lifted_us),
        begin=piece.begin,
        end=piece.end,
        # The sender's clock may have been set during the contact; less than nothing is no duration.
        dwell_ms=max(0.0, round((end_us - piece.touched_us) / 1e3, 3)),
        peak_force_n=piece.peak_force_n,
        peak_position_mm=piece.peak_position_mm,
        mean_position_mm=round(piece.position_sum_mm / piece.samples, 4) if piece.samples else None,
        samples=piece.samples,
        quality=ContactQuality.DEGRADED if piece.degraded else ContactQuality.GOOD,
        model=piece.model,
        boot_id=piece.boot_id,
        path=[PathPoint(at=rfc3339(at), position_mm=position, force_n=force) for at, position, force in piece.path],
    )


def _microseconds(moment: datetime | None) -> int | None:
    return None if moment is None else round(moment.timestamp() * 1e6)


def _selection(query: EventQuery) -> Selection:
    touched, _, number = (query.after or "").partition(".")
    return Selection(
        surface=query.surface,
        since_us=_microseconds(query.since),
        until_us=_microseconds(query.until),
        after=(int(touched), int(number)) if query.after else None,
        # One more shows whether there is a next page.
        limit=query.limit + 1,
    )


def _as_csv(events: Sequence[Event]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, _CSV_COLUMNS, extrasaction="ignore", lineterminator="\r\n")
    writer.writeheader()
    writer.writerows(event.model_dump(mode="json") for event in events)
    return text.getvalue()


def _wants_csv(query: EventQuery, request: Request) -> bool:
    if query.format:
        return query.format == "csv"
    accepted = [entry.split(";")[0].strip() for entry in request.headers.get("accept", "").split(",")]
    return CSV in accepted and "application/json" not in accepted


def make_router(registry: Registry, recorder: Recorder) -> APIRouter:
    """Return the route of the events of these surfaces."""
    router = APIRouter(tags=["events"])
    problems = documentation.problems(Kind.UNKNOWN_SURFACE, Kind.INVALID_REQUEST, Kind.NO_SURFACE)

    @router.get("/events", responses={200: documentation.EVENTS, **problems}, response_model=EventList)
    async def get_events(request: Request, query: Annotated[EventQuery, Query()]) -> Response:
        """Return contacts from touch to lift, the newest touch first; as CSV a row each, without paths."""
        selection = _selection(query)
        found = await wrap_future(recorder.ask(lambda store: store.read(selection)))
        if query.surface and not found:
            # Of a surface that is no longer configured there may still be events; without any the name is wrong.
            registry.named(query.surface)
        page = found[: query.limit]
        following = f"{page[-1][1].touched_us}.{page[-1][0]}" if len(found) > len(page) else None
        events = [_event(number, piece) for number, piece in page]
        if not _wants_csv(query, request):
            content = EventList(events=events, next=following).model_dump_json()
            return Response(content, headers=NO_STORE, media_type="application/json")
        headers = dict(NO_STORE)
        if following:
            parameters = {**request.query_params, "after": following}
            headers["Link"] = f'</events?{urlencode(parameters)}>; rel="next"'
        return Response(_as_csv(events), headers=headers, media_type=CSV)

    return router
