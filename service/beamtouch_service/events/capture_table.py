"""The table of captures: written with the event that they belong to, read and deleted with it."""

from collections.abc import Collection
from contextlib import suppress

from pydantic import ValidationError
from sqlalchemy import ColumnElement, Connection, and_, bindparam, delete, exists, func, insert, select

from beamtouch_service.events.captures import MAX_SAMPLES, Capture
from beamtouch_service.events.schema import CAPTURES, EVENTS
from beamtouch_service.events.segments import Segment
from beamtouch_service.surfaces.contradiction import Contradiction

_c, _e = CAPTURES.c, EVENTS.c
_STRETCHES = _e.ends_unexplained | (_e.unexplained_us > 0)
_of_model = and_(
    _c.surface == bindparam("of_surface"), _c.boot_id == bindparam("of_boot_id"), _c.model == bindparam("of_model")
)
_in_span = and_(_of_model, _c.sequence.between(bindparam("first"), bindparam("last")))
_READ = select(_c.sample).where(_in_span).order_by(_c.sequence).limit(MAX_SAMPLES)
_COUNT = select(func.count()).select_from(CAPTURES).where(_in_span)
_IN_SPAN = delete(CAPTURES).where(_in_span)
_EVENT = select(_e.first_sequence, _e.last_sequence).where(
    _e.surface == bindparam("of_surface"),
    _e.boot_id == bindparam("of_boot_id"),
    _e.model == bindparam("of_model"),
    _e.first_sequence <= bindparam("at"),
    _e.last_sequence >= bindparam("at"),
)
_INSERT = insert(CAPTURES)
_IS_CAPTURED = exists().where(
    _c.surface == _e.surface,
    _c.boot_id == _e.boot_id,
    _c.model == _e.model,
    _c.sequence.between(_e.first_sequence, _e.last_sequence),
)
_CAPTURED = select(_e.id).where(_e.id.in_(bindparam("of_ids", expanding=True)), _STRETCHES, _IS_CAPTURED)


def write(connection: Connection, surface: str, capture: Capture) -> None:
    """Write samples as far as their event has room for them; the event is on record."""
    key = {"of_surface": surface, "of_boot_id": capture.boot_id, "of_model": capture.model}
    first, last = capture.samples[0].sequence, capture.samples[-1].sequence
    event = connection.execute(_EVENT, key | {"at": first}).first()
    if event is None:
        return
    # A sender may send samples again after a restart of the service.
    connection.execute(_IN_SPAN, key | {"first": first, "last": last})
    kept = connection.execute(_COUNT, key | {"first": event[0], "last": event[1]}).scalar_one()
    rows = [
        {
            "surface": surface,
            "boot_id": capture.boot_id,
            "model": capture.model,
            "sequence": one.sequence,
            "sample": one.model_dump(mode="json"),
        }
        for one in capture.samples[: max(0, MAX_SAMPLES - kept)]
    ]
    if rows:
        connection.execute(_INSERT, rows)


def read(connection: Connection, event: Segment) -> list[Contradiction]:
    """Return the samples that are kept of an event, in order, without those that another version wrote otherwise."""
    key = {"of_surface": event.surface, "of_boot_id": event.boot_id, "of_model": event.model}
    span = {"first": event.first_sequence, "last": event.last_sequence}
    found = []
    for sample in connection.scalars(_READ, key | span):
        with suppress(ValidationError):
            found.append(Contradiction.model_validate(sample))
    return found


def captured(connection: Connection, numbers: Collection[int]) -> set[int]:
    """Return which of these events have samples."""
    return set(connection.scalars(_CAPTURED, {"of_ids": list(numbers)}))


def drop_oldest(connection: Connection, share: int) -> int:
    """Delete the samples of one in `share` of the events that have any, the oldest first; return of how many."""
    count = connection.scalar(select(func.count()).select_from(EVENTS).where(_STRETCHES, _IS_CAPTURED)) or 0
    oldest = select(_e.id).where(_STRETCHES, _IS_CAPTURED).order_by(_e.recorded_s).limit(max(1, count // share))
    return drop(connection, _e.id.in_(oldest))


def drop(connection: Connection, these: ColumnElement[bool]) -> int:
    """Delete the samples of these events, before the events; return how many of them may have had some."""
    columns = (_e.surface, _e.boot_id, _e.model, _e.first_sequence, _e.last_sequence)
    spans = [
        dict(zip(("of_surface", "of_boot_id", "of_model", "first", "last"), row, strict=True))
        for row in connection.execute(select(*columns).where(these, _STRETCHES))
    ]
    if spans:
        connection.execute(_IN_SPAN, spans)
    return len(spans)
