"""Segments and what is said of them, written to the tables. Every call is part of a transaction."""

from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from typing import Any

from sqlalchemy import BigInteger, Connection, Row, Select, bindparam, case, delete, insert, literal, select, update

from beamtouch_models.modelfile import State
from beamtouch_service.events import edge_table
from beamtouch_service.events.best_samples import Best
from beamtouch_service.events.findings import Edge, Finish, Loss, TouchSeen
from beamtouch_service.events.joining import are_apart, are_one, joined
from beamtouch_service.events.schema import EVENTS, IS_OPEN
from beamtouch_service.events.segments import BEFORE_CLEAR, Begin, End, EventKind, Point, Segment

CONTENT = [EVENTS.c.id, *(EVENTS.c[entry.name] for entry in fields(Segment))]
_c = EVENTS.c
_IS_STRETCH = _c.kind == EventKind.UNEXPLAINED
# Made once: making a statement takes longer than carrying it out.
_of_id = _c.id == bindparam("of_id")
_of_surface = _c.surface == bindparam("of_surface")
_of_sender = _of_surface & (_c.boot_id == bindparam("of_boot_id"))
_of_model = _of_sender & (_c.model == bindparam("of_model"))
_ends_at = _of_sender & (_c.last_sequence == bindparam("of_sequence"))
_begins_at = _of_sender & (_c.first_sequence == bindparam("of_sequence"))
_may_go_on = _c.end.not_in(BEFORE_CLEAR)
_first, _last = bindparam("first", type_=BigInteger), bindparam("last", type_=BigInteger)
BY_ID = select(*CONTENT).where(_of_id)
_LEFT = (
    select(*CONTENT)
    .where(_of_model, _c.first_sequence <= _first, _c.last_sequence >= _first - 1)
    .order_by(_c.last_sequence.desc())
    .limit(1)
)
"""The event that holds the first sample of a segment, or ends just before it."""
_RIGHT = (
    select(*CONTENT)
    .where(_of_model, _c.first_sequence.between(_first + 1, _last + 1), _c.begin.in_((Begin.UNSEEN, Begin.UNEXPLAINED)))
    .order_by(_c.first_sequence)
    .limit(1)
)
"""The event that begins in a segment, or just after it."""
_BESIDE = select(*CONTENT).where(
    _of_sender, (_c.last_sequence == bindparam("before")) | (_c.first_sequence == bindparam("after"))
)
"""The events on both sides of a sample."""
GOES_ON = select(_c.ends_unexplained).where(_ends_at, _may_go_on).limit(1)
"""Whether the event that ends with a sample, without a clear one after it, ends unexplained."""
_INSERT = insert(EVENTS).returning(_c.id)
_UPDATE = update(EVENTS).where(_of_id)
_DELETE = delete(EVENTS).where(_of_id)
_TOUCH = (
    update(EVENTS)
    .where(_begins_at)
    .values(begin=case((_IS_STRETCH, literal(Begin.CLEAR, _c.begin.type)), else_=literal(Begin.TOUCH, _c.begin.type)))
)
# A gap or silence ends only an open event; a clear sample also ends one that was interrupted just before it.
_LIFT = (
    update(EVENTS)
    .where(_ends_at, _may_go_on)
    .values(
        end=case(
            (_IS_STRETCH, literal(End.CLEAR, _c.end.type)),
            (_c.ends_unexplained, literal(End.UNEXPLAINED, _c.end.type)),
            else_=literal(End.LIFT, _c.end.type),
        ),
        lifted_us=bindparam("at_us", type_=BigInteger),
    )
)
_INTERRUPT = update(EVENTS).where(_ends_at, IS_OPEN)
_CONTACT_FOLLOWS = update(EVENTS).where(_of_id).values(end=End.CONTACT)
_STRETCH_BEFORE = update(EVENTS).where(_of_id).values(begin=Begin.UNEXPLAINED)
_END_OPEN = update(EVENTS).where(_of_surface, IS_OPEN, _c.id != bindparam("of_id")).values(end=End.UNSEEN)
_ABANDONED = update(EVENTS).where(IS_OPEN, _c.recorded_s < bindparam("before_s")).values(end=End.UNFINISHED)
_NO_ID = 0

Numbered = tuple[int, Segment]
"""Id and content of an event."""


def complete(connection: Connection, surface: str, command: Finish | TouchSeen | Loss) -> None:
    """Write what is known of the beginning or end of an event."""
    values: dict[str, object] = {"of_surface": surface}
    if isinstance(command, Loss):
        connection.execute(_END_OPEN, values | {"of_id": _NO_ID})
        return
    values["of_boot_id"] = command.boot_id
    if isinstance(command, TouchSeen):
        connection.execute(_TOUCH, values | {"of_sequence": command.first_sequence})
        return
    values["of_sequence"] = command.last_sequence
    if command.end is End.LIFT:
        connection.execute(_LIFT, values | {"at_us": command.lifted_us})
    else:
        connection.execute(_INTERRUPT, values | {"end": command.end})


def note(connection: Connection, surface: str, edge: Edge, now_s: float) -> None:
    """Keep a sample next to a gap, and write what it says of the events beside it."""
    edge_table.keep(connection, surface, edge, now_s)
    if edge.state is State.CLEAR:
        beside = {"before": edge.sequence - 1, "after": edge.sequence + 1}
        near = {"of_surface": surface, "of_boot_id": edge.boot_id} | beside
        for number, event in [numbered(row) for row in connection.execute(_BESIDE, near)]:
            whole = edge_table.completed(connection, event)
            found = {"begin": whole.begin, "end": whole.end, "lifted_us": whole.lifted_us}
            if whole != event:
                connection.execute(_UPDATE, found | {"of_id": number})


def add(connection: Connection, segment: Segment, now_s: float) -> None:
    """Write a segment, joined with the events beside it that it belongs to."""
    near: dict[str, object] = {"of_surface": segment.surface, "of_boot_id": segment.boot_id, "of_model": segment.model}
    span = {"first": segment.first_sequence, "last": segment.last_sequence}
    # Segments may overlap: after a restart of the service, the sender may send samples again.
    left = found(connection, _LEFT, near | span)
    if left and left[1].last_sequence >= segment.last_sequence:
        return
    number, whole = None, segment
    if left and are_one(left[1], segment):
        number, whole = left[0], joined(left[1], segment)
    elif left and not are_apart(left[1], segment):
        # The stretch that ends here belongs to no contact before it.
        connection.execute(_CONTACT_FOLLOWS, {"of_id": left[0]})
        whole = replace(whole, begin=Begin.UNEXPLAINED)
    # A stretch that turns out to belong to a contact also joins it with the contact after it.
    while right := found(connection, _RIGHT, near | span | {"last": whole.last_sequence}):
        if not are_one(whole, right[1]):
            if not are_apart(whole, right[1]):
                connection.execute(_STRETCH_BEFORE, {"of_id": right[0]})
                whole = replace(whole, end=End.CONTACT)
            break
        whole = joined(whole, right[1])
        span["first"] = right[1].first_sequence
        if number is None:
            number = right[0]
        else:
            connection.execute(_DELETE, {"of_id": right[0]})
    _put(connection, number, edge_table.completed(connection, whole), now_s)


def _put(connection: Connection, number: int | None, segment: Segment, now_s: float) -> None:
    best = asdict(segment.best) if segment.best else None
    values = vars(segment) | {"recorded_s": now_s, "best": best}
    if number is None:
        number = connection.execute(_INSERT, values).scalar_one()
    else:
        connection.execute(_UPDATE, values | {"of_id": number})
    if segment.end is End.OPEN:
        # A surface has one newest sample. Another open event was left by a lost write.
        connection.execute(_END_OPEN, {"of_surface": segment.surface, "of_id": number})


def finish_abandoned(connection: Connection, before_s: float) -> None:
    """End the events whose service has written nothing of them since `before_s` [s since 1970]."""
    connection.execute(_ABANDONED, {"before_s": before_s})


def found(connection: Connection, query: Select[Any], values: Mapping[str, object]) -> Numbered | None:
    """Return the first event that a query of `CONTENT` finds."""
    row = connection.execute(query, values).first()
    return numbered(row) if row else None


def numbered(row: Row[Any]) -> Numbered:
    """Return the event of a row of `CONTENT`, with or without its path and its change."""
    values = row._asdict()
    number = values.pop("id")
    values.pop("change", None)
    values["path"] = _path(values.get("path", []))
    values["best"] = Best.of(values.get("best"))
    return number, Segment(**values)


def _path(kept: list[Any]) -> list[Point]:
    """Return the path that an event keeps; empty if another version wrote it in another way."""
    try:
        return [(at, position, force) for at, position, force in kept]
    except (TypeError, ValueError):
        return []
