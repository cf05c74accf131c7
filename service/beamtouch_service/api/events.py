"""The routes of events.

A reader of the record makes the answers part by part, and the event loop sends them.
"""

import json
from collections.abc import Iterator, Sequence
from functools import partial
from types import GenericAlias
from typing import Annotated, Any, Literal
from urllib.parse import urlencode

from fastapi import Path as PathParameter
from fastapi import Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, create_model, field_validator

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import ContextParameter
from beamtouch_service.api.csv_parts import MEDIA_TYPE, NEXT_LINK, CsvParts
from beamtouch_service.api.record_answers import SLOT, answer_in_parts
from beamtouch_service.api.times import Time, microseconds
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.record import (
    EventAnswer,
    EventKey,
    EventKind,
    EventWithPath,
    PlateEvent,
    PlateEventWithPath,
    Reader,
    encode_event,
    event_fields_of,
    find_axes,
    find_events,
    get_recorded_event,
    members_of_event,
    read_events,
)
from beamtouch_service.samples import SurfaceName

_JSON, _NDJSON = "application/json", "application/x-ndjson"
_MAX_LIMIT = 1000
_MAX_PATHS = 50
"""With its path and its capture, an event may be a hundred times as large."""

router = gate.make_router("events", Role.READ)


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
        description=f"Maximum number of events; with paths, at most {_MAX_PATHS}. Default with ndjson: all.",
    )
    format: Literal["json", "csv", "ndjson"] = Field(
        "json", description="JSON; CSV with a row per event; or NDJSON, with an event in JSON per line, streamed."
    )

    @property
    def is_whole(self) -> bool:
        """Whether the answer is all events of the period instead of a page."""
        return self.format == "ndjson" and "limit" not in self.model_fields_set

    @field_validator("limit")
    @classmethod
    def _short_with_paths(cls, limit: int, info: ValidationInfo) -> int:
        if limit > _MAX_PATHS and info.data.get("path"):
            raise ValueError(f"with path=true, a page has at most {_MAX_PATHS} events")
        return limit


_CONTENTS = {"content": {MEDIA_TYPE: {"schema": {"type": "string"}}, _NDJSON: {"schema": {"type": "string"}}}}
_LISTS: Any = GenericAlias(list, EventWithPath | PlateEventWithPath) | GenericAlias(list, EventAnswer | PlateEvent)
EventList = create_model(
    "EventList",
    __doc__="Events, newest touch first: all with a path, or all without.",
    events=(_LISTS, ...),
    next=(str | None, Field(description="Value of `after` for the next page; null on the last page.")),
)


@router.get(
    "/events",
    response_model=EventList,
    responses={200: _CONTENTS | {"headers": {"Link": NEXT_LINK}}},
    dependencies=[SLOT],
)
async def get_events(context: ContextParameter, request: Request, query: Annotated[EventQuery, Query()]) -> Response:
    """Return contacts and unexplained stretches, the newest first; as CSV or NDJSON, one row or line per event."""
    after = _place_of(query.after)
    keys = await context.recorder.readers.read(partial(_find, query=query, after=after))
    if query.surface and not keys:
        # A surface that is no longer configured may still have events; if it has none, the name is wrong.
        context.registry.named(query.surface)
    if query.is_whole:
        return await answer_in_parts(context, partial(_as_whole_ndjson, keys=keys, query=query), _NDJSON)
    page = keys[: query.limit]
    following = f"{page[-1].touched_us}.{page[-1].id}" if len(keys) > len(page) else None
    if query.format == "json":
        return await answer_in_parts(context, partial(_as_json, keys=page, path=query.path, following=following), _JSON)
    address = urlencode({**request.query_params, "after": following})
    headers = {"Link": f'<?{address}>; rel="next"'} if following else {}
    if query.format == "ndjson":
        return await answer_in_parts(context, partial(_as_ndjson, keys=page, path=query.path), _NDJSON, headers)
    return await answer_in_parts(context, partial(_as_csv, keys=page), MEDIA_TYPE, headers)


@router.get("/events/{id}", response_model=EventWithPath | PlateEventWithPath, dependencies=[SLOT])
async def get_event(
    context: ContextParameter, number: Annotated[int, PathParameter(alias="id", ge=1, lt=2**63)]
) -> Response:
    """Return one event, with its path and its capture."""

    def read(reader: Reader) -> bytes | None:
        event = get_recorded_event(reader, number)
        return event and encode_event(event, path=True)

    content = await context.recorder.readers.read(read)
    if content is None:
        detail = f"There is no event {number}. It was dropped; see GET /events."
        raise ProblemError(Problem(Kind.UNKNOWN_EVENT, detail))
    return Response(content, media_type=_JSON)


def _place_of(after: str | None) -> tuple[int, int] | None:
    """Return the place in the order of touches that `after` names."""
    touched, _, number = (after or "").partition(".")
    return (int(touched), int(number)) if after else None


def _find(reader: Reader, query: EventQuery, after: tuple[int, int] | None) -> list[EventKey]:
    """Return the events of a page, and one more if there is another page."""
    return find_events(
        reader,
        surface=query.surface,
        kind=query.kind,
        since_us=microseconds(query.since),
        until_us=microseconds(query.until),
        after=after,
        limit=(_MAX_LIMIT if query.is_whole else query.limit) + 1,
    )


def _as_json(reader: Reader, keys: Sequence[EventKey], *, path: bool, following: str | None) -> Iterator[bytes]:
    """Give a page of events as JSON."""
    before = b'{"events":['
    for events in read_events(reader, keys, path=path):
        part = []
        for event in events:
            part += [before, encode_event(event, path=path)]
            before = b","
            reader.rest()
        yield b"".join(part)
    yield (b"" if before == b"," else before) + f'],"next":{json.dumps(following)}}}'.encode()


def _as_ndjson(reader: Reader, keys: Sequence[EventKey], *, path: bool) -> Iterator[bytes]:
    """Give events as lines of JSON."""
    yield b""  # an answer has a part
    for events in read_events(reader, keys, path=path):
        part = []
        for event in events:
            part += [encode_event(event, path=path), b"\n"]
            reader.rest()
        yield b"".join(part)


def _as_whole_ndjson(reader: Reader, keys: Sequence[EventKey], *, query: EventQuery) -> Iterator[bytes]:
    """Give these events and all that follow them as lines of JSON."""
    while keys:
        yield from _as_ndjson(reader, keys, path=query.path)
        keys = _find(reader, query, (keys[-1].touched_us, keys[-1].id))
    yield b""


def _as_csv(reader: Reader, keys: Sequence[EventKey]) -> Iterator[bytes]:
    """Give a page of events as CSV: one row per event, without paths."""
    columns = list(dict.fromkeys(field.name for axes in find_axes(reader, keys) for field in event_fields_of(axes)))
    csv = CsvParts(columns)
    for events in read_events(reader, keys, path=False):
        for event in events:
            members = members_of_event(event)
            csv.add(_cell(members.get(name)) for name in columns)
            reader.rest()
        yield csv.take()
    yield csv.take()


def _cell(value: object) -> object:
    """Return a value as a cell: `true` and zones as in JSON."""
    return json.dumps(value) if isinstance(value, (bool, dict)) else value
