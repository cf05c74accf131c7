"""The event routes. A thread reads and encodes the answers; the event loop sends them."""

from dataclasses import dataclass
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import Path as PathParameter
from fastapi import Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from beamtouch_service.access import Role
from beamtouch_service.api import event_answers, gate, openapi
from beamtouch_service.api.context import ContextParameter
from beamtouch_service.api.errors import NO_STORE
from beamtouch_service.api.event_answers import EventList, EventWithPath
from beamtouch_service.api.times import Time, microseconds
from beamtouch_service.events.event import EventKind
from beamtouch_service.events.store import Selection, Store
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import SurfaceName

CSV = "text/csv"
_MAX_LIMIT = 1000
_MAX_PATHS = 50
"""With its path, an event is a hundred times as large."""


class EventQuery(BaseModel):
    """Query parameters of the list of events."""

    model_config = ConfigDict(extra="forbid")

    surface: SurfaceName | None = Field(None, description="Only events of this surface.")
    kind: EventKind | None = Field(None, description="Only contacts, or only unexplained stretches.")
    since: Time | None = Field(None, description="Only events that began at or after this time (RFC 3339).")
    until: Time | None = Field(None, description="Only events that began before this time.")
    after: str | None = Field(None, pattern=r"^[0-9]{1,17}\.[0-9]{1,18}$", description="`next` of the previous page.")
    path: bool = Field(False, description="Include paths and captures; CSV never has them.")  # a default
    limit: int = Field(
        _MAX_PATHS,
        ge=1,
        le=_MAX_LIMIT,
        description=f"Maximum number of events; with paths, at most {_MAX_PATHS}.",
    )
    format: Literal["json", "csv"] | None = Field(None, description="Overrides the header `Accept`.")

    @field_validator("limit")
    @classmethod
    def _short_with_paths(cls, limit: int, info: ValidationInfo) -> int:
        if limit > _MAX_PATHS and info.data.get("path"):
            message = f"with path=true, a page has at most {_MAX_PATHS} events"
            raise ValueError(message)
        return limit


def _selection(query: EventQuery, *, path: bool) -> Selection:
    touched, _, number = (query.after or "").partition(".")
    return Selection(
        surface=query.surface,
        kind=query.kind,
        since_us=microseconds(query.since),
        until_us=microseconds(query.until),
        after=(int(touched), int(number)) if query.after else None,
        # One event more shows whether there is a next page.
        limit=query.limit + 1,
        path=path,
    )


def _wants_csv(query: EventQuery, request: Request) -> bool:
    if query.format:
        return query.format == "csv"
    accepted = [entry.split(";")[0].strip() for entry in request.headers.get("accept", "").split(",")]
    return CSV in accepted and "application/json" not in accepted


@dataclass(frozen=True)
class _Page:
    content: bytes
    is_empty: bool
    following: str | None
    """Value of `after` for the next page."""


def _page(store: Store, query: EventQuery, *, as_csv: bool) -> _Page:
    path = query.path and not as_csv
    found = store.read(_selection(query, path=path))
    page = found[: query.limit]
    following = f"{page[-1][1].touched_us}.{page[-1][0]}" if len(found) > len(page) else None
    if as_csv:
        return _Page(event_answers.as_csv(page), not page, following)
    return _Page(event_answers.as_json(page, following, path=path), not page, following)


def _one(store: Store, number: int) -> bytes | None:
    found = store.get(number)
    return event_answers.event_with_path(number, found).model_dump_json().encode() if found else None


_PROBLEMS = (Kind.INVALID_REQUEST, Kind.EVENTS_AWAY)
_LIST = {200: openapi.EVENTS, **openapi.problems(Kind.UNKNOWN_SURFACE, Kind.NO_SURFACE, *_PROBLEMS)}
_ONE = {200: openapi.EVENT, **openapi.problems(Kind.UNKNOWN_EVENT, *_PROBLEMS)}


_Number = Annotated[int, PathParameter(alias="id", ge=1, lt=2**63)]

router = gate.make_router("events", Role.READ)


@router.get("/events", responses=_LIST, response_model=EventList)
async def get_events(context: ContextParameter, request: Request, query: Annotated[EventQuery, Query()]) -> Response:
    """Return contacts and unexplained stretches, the newest first; as CSV, one row per event."""
    as_csv = _wants_csv(query, request)
    page = await context.recorder.ask(lambda store: _page(store, query, as_csv=as_csv))
    if query.surface and page.is_empty:
        # A surface that is no longer configured may still have events; if it has none, the name is wrong.
        context.registry.named(query.surface)
    headers = dict(NO_STORE)
    if as_csv and page.following:
        parameters = {**request.query_params, "after": page.following}
        headers["Link"] = f'</events?{urlencode(parameters)}>; rel="next"'
    return Response(page.content, headers=headers, media_type=CSV if as_csv else "application/json")


@router.get("/events/{id}", responses=_ONE, response_model=EventWithPath)
async def get_event(context: ContextParameter, number: _Number) -> Response:
    """Return one event, with its path and its capture."""
    content = await context.recorder.ask(lambda store: _one(store, number))
    if content is None:
        detail = f"There is no event {number}. It was dropped; see GET /events."
        raise ProblemError(Problem(Kind.UNKNOWN_EVENT, detail))
    return Response(content, headers=NO_STORE, media_type="application/json")
