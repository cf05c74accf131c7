"""The table of edges: the samples beside gaps, whichever service saw them. Every call is part of a transaction."""

from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, bindparam, delete, insert, select

from beamtouch_models.modelfile import Memory, State
from beamtouch_service.events.findings import Edge
from beamtouch_service.events.schema import EDGES
from beamtouch_service.events.segments import Begin, End, EventKind, Segment
from beamtouch_service.surfaces.follower import Past

KEEP_S = 86_400.0
"""Edges are kept for a day. Without its edge, an event next to a gap keeps its unseen beginning or end."""
_MAY_LIFT = (End.OPEN, End.STALE, End.UNSEEN, End.UNFINISHED)

_c = EDGES.c
_of_sender = (_c.surface == bindparam("of_surface")) & (_c.boot_id == bindparam("of_boot_id"))
_AT = _of_sender & (_c.sequence == bindparam("at"))
_FIND = select(_c.boot_id, _c.model, _c.sequence, _c.acquired_us, _c.state, _c.past).where(_AT)
_DROP = delete(EDGES).where(_AT)
_KEEP = insert(EDGES)
_BESIDE = select(_c.sequence, _c.acquired_us, _c.past).where(
    _of_sender, _c.sequence.in_((bindparam("before"), bindparam("after"))), _c.state == State.CLEAR
)


def keep(connection: Connection, surface: str, edge: Edge, now_s: float) -> None:
    """Keep an edge instead of what is known of that sample so far, unless it depends on samples before it."""
    if edge.state is None and not edge.is_certain:
        return
    connection.execute(_DROP, {"of_surface": surface, "of_boot_id": edge.boot_id, "at": edge.sequence})
    values = edge._asdict() | {"past": _as_json(edge.past), "recorded_s": now_s}
    connection.execute(_KEEP, {"surface": surface, **values})


def find(connection: Connection, surface: str, boot_id: str, sequence: int) -> Edge | None:
    """Return the edge with that number; None if it is not kept."""
    row = connection.execute(_FIND, {"of_surface": surface, "of_boot_id": boot_id, "at": sequence}).first()
    past = _past(row.past) if row else None
    return Edge(*row[:5], past) if row and past else None


def completed(connection: Connection, event: Segment) -> Segment:
    """Return an event with what the clear samples beside it say of its beginning and end."""
    is_open = event.end in _MAY_LIFT
    if event.begin is not Begin.UNSEEN and not is_open:
        return event
    is_stretch = event.kind is EventKind.UNEXPLAINED
    key = {"of_surface": event.surface, "of_boot_id": event.boot_id}
    before, after = event.first_sequence - 1, event.last_sequence + 1
    for sequence, acquired_us, kept in connection.execute(_BESIDE, key | {"before": before, "after": after}):
        # Without what came before it, a clear sample may turn out to belong to a stretch.
        past = _past(kept)
        is_certain = past is not None and len(past.memories) == 1
        if sequence == before and event.begin is Begin.UNSEEN and (is_certain or not is_stretch):
            event = replace(event, begin=Begin.CLEAR if is_stretch else Begin.TOUCH)
        elif sequence == after and is_open and (is_certain or not (is_stretch or event.ends_unexplained)):
            event = replace(event, end=_end(event), lifted_us=acquired_us)
    return event


def drop_old(connection: Connection, now_s: float) -> None:
    """Delete the edges that are too old at `now_s` [s since 1970]."""
    connection.execute(delete(EDGES).where(_c.recorded_s < now_s - KEEP_S))


def _as_json(past: Past) -> dict[str, object]:
    return past._asdict() | {"memories": [one._asdict() for one in past.memories]}


def _past(kept: dict[str, Any]) -> Past | None:
    """Return what an edge leaves; None if a service of another version wrote it in another way."""
    try:
        memories = [Memory(**one | {"state": State(one["state"])}) for one in kept["memories"]]
        # JSON has no tuples, and equal memories must be equal.
        memories = [one._replace(seen_mm=one.seen_mm and tuple(one.seen_mm)) for one in memories]
        return Past(**kept | {"memories": tuple(memories)})
    except (TypeError, KeyError, ValueError):
        return None


def _end(event: Segment) -> End:
    if event.kind is EventKind.UNEXPLAINED:
        return End.CLEAR
    return End.UNEXPLAINED if event.ends_unexplained else End.LIFT
