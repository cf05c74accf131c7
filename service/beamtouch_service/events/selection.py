"""Which events to read."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Select, select, tuple_

from beamtouch_service.events.schema import EVENTS
from beamtouch_service.events.segments import EventKind
from beamtouch_service.events.writing import CONTENT

_WITHOUT_PATH = [column for column in CONTENT if column not in (EVENTS.c.path, EVENTS.c.best)]
_c = EVENTS.c


@dataclass(frozen=True)
class Selection:
    """Selects events to read, newest first."""

    surface: str | None = None
    kind: EventKind | None = None
    since_us: int | None = None
    """Earliest touch."""
    until_us: int | None = None
    """The touch is before this time."""
    after: tuple[int, int] | None = None
    """Touch time and id of the last event that was read."""
    limit: int = 100
    path: bool = True
    """Read paths too; they are by far the largest part of an event."""

    def query(self) -> Select[Any]:
        """Return the query for them."""
        query = select(*(CONTENT if self.path else _WITHOUT_PATH))
        if self.surface is not None:
            query = query.where(_c.surface == self.surface)
        if self.kind is not None:
            query = query.where(_c.kind == self.kind)
        if self.since_us is not None:
            query = query.where(_c.touched_us >= self.since_us)
        if self.until_us is not None:
            query = query.where(_c.touched_us < self.until_us)
        if self.after:
            query = query.where(tuple_(_c.touched_us, _c.id) < tuple_(*self.after))
        return query.order_by(_c.touched_us.desc(), _c.id.desc()).limit(self.limit)
