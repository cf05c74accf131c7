"""The routes of the record: events, and their best samples for `design-sensors calibrate --events`.

A reader of the record makes the answers part by part, and the event loop sends them.
"""

import csv
import io
import json
import operator
import re
from collections.abc import Iterator, Sequence
from datetime import datetime
from functools import cache, partial
from itertools import zip_longest
from typing import Annotated, Any, Literal, cast
from urllib.parse import urlencode

from fastapi import Path as PathParameter
from fastapi import Query, Request, Response
from pydantic import (
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    create_model,
    field_validator,
)

from beamtouch_common.outline import BEAM_AXES, BEAM_AXIS, names_of
from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import ContextParameter, SurfaceInPath
from beamtouch_service.api.record_answers import SLOT, answer_in_parts
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.record import (
    Begin,
    Contradiction,
    End,
    EventKey,
    EventKind,
    Reader,
    find_axes,
    find_best_samples,
    find_events,
    get_recorded_event,
    read_best_samples,
    read_events,
)
from beamtouch_service.record import Event as RecordedEvent
from beamtouch_service.samples import SurfaceName
from beamtouch_service.surfaces.contact import ContactQuality, rfc3339

_CSV, _JSON = "text/csv", "application/json"
_OF_PLACE = ("mean_{}_mm", "mean_{}_low_mm", "mean_{}_high_mm", "min_{}_mm", "max_{}_mm", "peak_{}_mm")
"""The figures of a place in the record, in their order there, named after their axis."""
_DECIMALS = 10
"""Decimals of lengths in mm, as CSV."""
_MAX_LIMIT = 1000
_MAX_PATHS = 50
"""With its path and its capture, an event may be a hundred times as large."""


router = gate.make_router("events", Role.READ)


_LOST_PLUS = re.compile(r"(?i).*T.* \d\d:?\d\d")
"""A time with its zone, of which the query has made the + a space."""


def _require_rfc3339(value: object) -> object:
    # pydantic takes a bare number for seconds since 1970, or for milliseconds if it is large.
    if isinstance(value, str) and "T" not in value.upper():
        raise ValueError("expected a time such as 2026-11-20T23:40:46Z")
    if isinstance(value, str) and _LOST_PLUS.fullmatch(value):
        escaped = value.replace(" ", "%2B")
        raise ValueError(f"in an address, + means a space; write {escaped}, or the time in UTC with Z at its end")
    return value


Time = Annotated[AwareDatetime, BeforeValidator(_require_rfc3339)]
"""A time with its zone (RFC 3339)."""


def microseconds(moment: datetime | None) -> int | None:
    """Return a time in microseconds since 1970."""
    return None if moment is None else round(moment.timestamp() * 1e6)


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
    format: Literal["json", "csv"] = Field("json", description="JSON, or CSV with a row per event.")

    @field_validator("limit")
    @classmethod
    def _short_with_paths(cls, limit: int, info: ValidationInfo) -> int:
        if limit > _MAX_PATHS and info.data.get("path"):
            raise ValueError(f"with path=true, a page has at most {_MAX_PATHS} events")
        return limit


class Stay(BaseModel):
    """A part of a contact in which one load explains all samples, with 95 % intervals."""

    at: str
    """Time of its begin (RFC 3339)."""
    lasts_ms: float
    position_mm: float
    position_low_mm: float
    position_high_mm: float
    force_n: float | None
    """Null if the model does not estimate force."""
    force_low_n: float | None
    force_high_n: float | None
    unsteady: bool
    """True if these figures stand on unsteady samples."""


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
    """Time of the first clear reading after it, or of the first clear sample after an unexplained stretch; null if that
    is not known."""
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
    mean_position_mm: float | None
    """Mean position of the load over its time; null without a contact."""
    mean_position_low_mm: float | None
    """Lower end of the 95 % interval of this mean."""
    mean_position_high_mm: float | None
    """Upper end of the 95 % interval of this mean."""
    min_position_mm: float | None
    """The leftmost position of a load that moves; of one that lies still, its position."""
    max_position_mm: float | None
    """The rightmost position of a load that moves."""
    mean_force_n: float | None
    """Mean force of the load over its time, without the ramps of touch and lift; null if the model does not estimate
    force. Times `dwell_ms`, it is the impulse."""
    mean_force_low_n: float | None
    """Lower end of the 95 % interval of this mean."""
    mean_force_high_n: float | None
    """Upper end of the 95 % interval of this mean."""
    peak_force_n: float | None
    """Largest force of the load that lasted. Swings of the beam are none of it."""
    peak_force_low_n: float | None
    """Lower end of its 95 % interval."""
    peak_force_high_n: float | None
    """Upper end of its 95 % interval."""
    peak_position_mm: float | None
    """Position at the peak force."""
    samples: int
    """Number of samples in these figures."""
    unsteady_samples: int
    """How many of them were unsteady."""
    unsteady: bool
    """True if the figures stand on unsteady samples. Their intervals hold all the same."""
    quality: ContactQuality
    """`degraded` if at least one sample lacked channels."""
    model: str
    boot_id: str
    """Boot id of the sender."""
    zones: dict[str, float] = Field(default_factory=dict, exclude_if=operator.not_)
    """Zone that the contact was inside -> for how long [ms]. Zones that it was never inside are left out."""


class EventWithPath(Event):
    """One event, with the path of its contact, and what was unexplained."""

    path: list[Stay]
    """The stays of its load, at most 25. Between two of them it moved, or its force changed."""
    capture: list[Contradiction]
    """Its first unexplained samples, channel by channel: at most 5."""


class EventList(BaseModel):
    """Events, newest touch first: all with a path, or all without."""

    events: list[EventWithPath] | list[Event]
    next: str | None
    """Value of `after` for the next page; null on the last page."""


def _members(number: int, recorded: RecordedEvent) -> dict[str, object]:
    """Return the members of an answer, with fields of the record that no answer has."""
    end_us = recorded.last_us if recorded.lifted_us is None else recorded.lifted_us
    unexplained_us = recorded.unexplained_us + (max(0, end_us - recorded.last_us) if recorded.ends_unexplained else 0)
    place = {
        name.format(axis): value
        for axis, values in recorded.place.items()
        for name, value in zip_longest(_OF_PLACE, values or ())
    }
    return (
        vars(recorded)
        | place
        | {
            "id": number,
            "touched_at": rfc3339(recorded.touched_us),
            "lifted_at": None if recorded.lifted_us is None else rfc3339(recorded.lifted_us),
            # The sender's clock may have been set back during the contact.
            "dwell_ms": max(0.0, round((end_us - recorded.touched_us) / 1e3, 3)),
            "unexplained_ms": round(unexplained_us / 1e3, 3),
            "quality": ContactQuality.DEGRADED if recorded.degraded else ContactQuality.GOOD,
            "zones": {zone: round(us / 1e3, 3) for zone, us in recorded.zones.items()},
        }
    )


@cache
def event_on(axes: tuple[str, ...]) -> type[Event]:
    """Return the model of an event on a surface with these axes: figures of place are named after them."""
    if axes == BEAM_AXES:
        return Event
    members: dict[str, Any] = {
        name.replace(BEAM_AXIS, axis): (field.annotation, field)
        for name, field in Event.model_fields.items()
        for axis in (axes if BEAM_AXIS in name else ("",))
    }
    return cast("type[Event]", create_model("Event", **members))


def event(number: int, recorded: RecordedEvent) -> Event:
    """Return an event without its path."""
    return event_on(tuple(recorded.place)).model_validate(_members(number, recorded))


def _encode(number: int, recorded: RecordedEvent, *, path: bool) -> str:
    """Return an event as JSON, with or without its path."""
    text = event(number, recorded).model_dump_json()
    if not path:
        return text
    capture = json.dumps(recorded.capture, ensure_ascii=False, allow_nan=False) if recorded.capture else "[]"
    return f'{text[:-1]},"path":{json.dumps(_path(recorded))},"capture":{capture}}}'


def _path(recorded: RecordedEvent) -> list[dict[str, Any]]:
    """Return the path of an event, each point as a `Stay`."""
    names = [name for axis in recorded.place for name in names_of(axis, "mm")] + [*names_of("force", "n")]
    return [
        {
            "at": rfc3339(recorded.touched_us + round(since_us)),
            "lasts_ms": round(lasts_us / 1e3, 3),
            **dict(zip_longest(names, spans)),
            "unsteady": bool(is_unsteady),
        }
        for since_us, lasts_us, is_unsteady, *spans in recorded.path
    ]


@router.get(
    "/events",
    response_model=EventList,
    responses={200: {"content": {_CSV: {"schema": {"type": "string"}}}}},
    dependencies=[SLOT],
)
async def get_events(context: ContextParameter, request: Request, query: Annotated[EventQuery, Query()]) -> Response:
    """Return contacts and unexplained stretches, the newest first; as CSV, one row per event."""
    as_csv = query.format == "csv"
    keys = await context.recorder.readers.read(partial(_find, query=query))
    if query.surface and not keys:
        # A surface that is no longer configured may still have events; if it has none, the name is wrong.
        context.registry.named(query.surface)
    page = keys[: query.limit]
    following = f"{page[-1].touched_us}.{page[-1].id}" if len(keys) > len(page) else None
    if not as_csv:
        return await answer_in_parts(context, partial(_as_json, keys=page, path=query.path, following=following), _JSON)
    address = urlencode({**request.query_params, "after": following})
    headers = {"Link": f'<?{address}>; rel="next"'} if following else {}
    return await answer_in_parts(context, partial(_as_csv, keys=page), _CSV, headers)


@router.get("/events/{id}", response_model=EventWithPath, dependencies=[SLOT])
async def get_event(
    context: ContextParameter, number: Annotated[int, PathParameter(alias="id", ge=1, lt=2**63)]
) -> Response:
    """Return one event, with its path and its capture."""

    def read(reader: Reader) -> str | None:
        recorded = get_recorded_event(reader, number)
        return _encode(number, recorded, path=True) if recorded else None

    content = await context.recorder.readers.read(read)
    if content is None:
        detail = f"There is no event {number}. It was dropped; see GET /events."
        raise ProblemError(Problem(Kind.UNKNOWN_EVENT, detail))
    return Response(content, media_type=_JSON)


def _find(reader: Reader, query: EventQuery) -> list[EventKey]:
    """Return the events of a page, and one more if there is another page."""
    touched, _, number = (query.after or "").partition(".")
    return find_events(
        reader,
        surface=query.surface,
        kind=query.kind,
        since_us=microseconds(query.since),
        until_us=microseconds(query.until),
        after=(int(touched), int(number)) if query.after else None,
        limit=query.limit + 1,
    )


def _as_json(reader: Reader, keys: Sequence[EventKey], *, path: bool, following: str | None) -> Iterator[bytes]:
    """Give a page of events as JSON."""
    before = '{"events":['
    for events in read_events(reader, keys, path=path):
        part = []
        for numbered in events:
            part += [before, _encode(*numbered, path=path)]
            before = ","
            reader.rest()
        yield "".join(part).encode()
    yield f'{"" if before == "," else before}],"next":{json.dumps(following)}}}'.encode()


def _as_csv(reader: Reader, keys: Sequence[EventKey]) -> Iterator[bytes]:
    """Give a page of events as CSV: one row per event, without paths."""
    text = io.StringIO()
    columns = dict.fromkeys(name for axes in find_axes(reader, keys) for name in event_on(axes).model_fields)
    writer = csv.DictWriter(text, list(columns), lineterminator="\r\n")
    writer.writeheader()
    for events in read_events(reader, keys, path=False):
        for numbered in events:
            members = event(*numbered).model_dump(mode="json")
            # As in JSON: `true`, not `True`.
            is_json = (bool, dict)
            writer.writerow(
                {name: json.dumps(one) if isinstance(one, is_json) else one for name, one in members.items()}
            )
            reader.rest()
        yield _take(text)
    yield _take(text)


def _take(text: io.StringIO) -> bytes:
    """Return what was written, and begin again."""
    part = text.getvalue().encode()
    text.seek(0)
    text.truncate()
    return part


class CalibrationQuery(BaseModel):
    """Query parameters of the best samples."""

    model_config = ConfigDict(extra="forbid")

    since: Time | None = Field(None, description="Only contacts that began at or after this time (RFC 3339).")
    until: Time | None = Field(None, description="Only contacts that began before this time.")
    limit: int = Field(1000, ge=1, le=5000, description="Maximum number of contacts: the newest ones.")


@router.get(
    "/surfaces/{name}/calibration-data",
    response_class=Response,
    responses={
        200: {"description": "A row per contact, oldest first.", "content": {_CSV: {"schema": {"type": "string"}}}}
    },
    dependencies=[SLOT],
)
async def get_calibration_data(
    context: ContextParameter, name: SurfaceInPath, query: Annotated[CalibrationQuery, Query()]
) -> Response:
    """Return the best sample of each contact as CSV: the steady one of the most readings, with all channels good.

    Contacts of another layout of channels are left out.
    """
    surface = context.registry.named(name)
    channels = surface.model.channels if surface.model else None
    span = microseconds(query.since), microseconds(query.until), query.limit
    keys = await context.recorder.readers.read(lambda reader: find_best_samples(reader, name, *span))
    return await answer_in_parts(context, partial(_samples_as_csv, keys=keys, channels=channels), _CSV)


def _samples_as_csv(reader: Reader, keys: Sequence[EventKey], channels: list[str] | None) -> Iterator[bytes]:
    """Give best samples of these channels, or else of those of the newest one, as CSV."""
    layout = channels or _newest_channels(reader, keys)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\r\n")
    columns = [f"{name}_{what}" for what in ("mm", "sd_mm", "rest_mm", "rest_sd_mm") for name in layout]
    writer.writerow(["event", "time", "model", "characteristic", "readings", *columns])
    for contacts in read_best_samples(reader, keys):
        for contact in contacts:
            reader.rest()
            best = contact.best
            if best is None or best.channels != layout:
                continue
            values = [best.deflection_mm, best.deviation_mm, best.rest_mm, best.rest_deviation_mm]
            about = [contact.number, rfc3339(best.at_us), contact.model, best.characteristic or "", best.readings]
            writer.writerow([*about, *(cell for each in values for cell in _cells(each, len(layout)))])
        yield _take(text)
    yield _take(text)


def _newest_channels(reader: Reader, keys: Sequence[EventKey]) -> list[str]:
    """Return the channels of the newest best sample that can be read; none without one."""
    for key in reversed(keys):
        for contacts in read_best_samples(reader, [key]):
            for contact in contacts:
                if contact.best:
                    return contact.best.channels
    return []


def _cells(values: list[float] | None, count: int) -> list[str]:
    return [""] * count if values is None else [f"{value:.{_DECIMALS}f}" for value in values]
