"""Reads the trail, and checks its chain: whether a row was changed, added or taken out behind the back of the service.

The last rows can be taken out, and everything can be written anew with other digests. To notice that, compare the
digest of an entry with one that is kept elsewhere, as the log has it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import bindparam, select, true

from beamtouch_service.record.database.rows import Rows
from beamtouch_service.record.reading.readers import Reader
from beamtouch_service.record.trail.entry import FIRST, Action, Entry, digest_of
from beamtouch_service.record.trail.table import CONTENT, TRAIL, Added

_AT_ONCE = 200
"""Rows that are checked between two parts of an answer."""
_c = TRAIL.c
_ROWS = Rows(
    TRAIL.name,
    {"at_us": int, "action": Action} | dict.fromkeys(("surface", "subject", "by", "token", "address", "digest"), str),
)
_NEXT = select(TRAIL).where(_c.number > bindparam("after")).order_by(_c.number).limit(_AT_ONCE)


@dataclass(frozen=True)
class Chain:
    """Whether each entry follows from the one before."""

    holds: bool
    breaks_at: int | None
    """Number of the first entry that does not follow from the one before: it, or the one before, was changed or taken
    out. Null if all do."""
    entries: int
    """Entries up to there."""
    digest: str | None
    """Digest of the last of them; null without one."""


@dataclass(frozen=True)
class Damaged:
    """An entry that cannot be read."""

    number: int
    reason: str
    """In one line, with its table and its column."""


def find_entries(
    reader: Reader,
    *,
    surface: str | None,
    action: Action | None,
    since_us: int | None,
    until_us: int | None,
    before: int | None,
    limit: int,
) -> list[Added | Damaged]:
    """Return at most `limit` entries, newest first.

    Parameters
    ----------
    since_us, until_us : earliest time, and the time that all are before [us since 1970]
    before : number of the last entry that was read
    """
    query = select(TRAIL).order_by(_c.number.desc()).limit(limit)
    wanted = [
        true() if surface is None else _c.surface == surface,
        true() if action is None else _c.action == action,
        true() if since_us is None else _c.at_us >= since_us,
        true() if until_us is None else _c.at_us < until_us,
        true() if before is None else _c.number < before,
    ]
    entries = list[Added | Damaged]()
    for row in reader.rows(query.where(*wanted)):
        if damage := _ROWS.find_damage(f"entry {row.number} of the trail", row._asdict()):
            entries.append(Damaged(row.number, damage))
        else:
            content = {one.name: getattr(row, one.name) for one in CONTENT}
            entries.append(Added(row.number, Entry(**content), row.digest))
        reader.rest()
    return entries


def check_chain(reader: Reader) -> Iterator[Chain | Literal["more"]]:
    """Check the chain from its first entry on: give `more` after some rows, and at last what holds."""
    number, digest = 0, FIRST
    while rows := reader.rows(_NEXT, after=number):
        for row in rows:
            values: list[Any] = [getattr(row, column.name) for column in CONTENT]
            if row.number != number + 1 or row.digest != digest_of(digest, row.number, values):
                yield Chain(holds=False, breaks_at=row.number, entries=number, digest=digest or None)
                return
            number, digest = row.number, row.digest
            reader.rest()
        yield "more"
    yield Chain(holds=True, breaks_at=None, entries=number, digest=digest or None)
