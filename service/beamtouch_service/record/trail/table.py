"""The table of the trail. Rows are added, and neither changed nor deleted."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import BigInteger, Column, Connection, Index, String, Table, insert, select

from beamtouch_service.record.database.tables import ROW_NUMBER, TABLES
from beamtouch_service.record.database.values import Word
from beamtouch_service.record.trail.entry import FIRST, Action, Entry, digest_of

TRAIL = Table(
    "trail",
    TABLES,
    Column("number", ROW_NUMBER, primary_key=True, autoincrement=False),
    Column("at_us", BigInteger, nullable=False),
    Column("action", Word(Action), nullable=False),
    Column("details", String, nullable=False),
    Column("surface", String, nullable=False),
    Column("subject", String, nullable=False),
    Column("by", String, nullable=False),
    Column("token", String, nullable=False),
    Column("address", String, nullable=False),
    Column("digest", String, nullable=False),
)
"""A row per entry: its number without a gap, the fields of an `Entry`, and its digest."""
_log = logging.getLogger(__name__)
_c = TRAIL.c
Index("by_subject", _c.action, _c.surface, _c.subject, _c.number)
CONTENT = [column for column in TRAIL.columns if column.name not in ("number", "digest")]


@dataclass(frozen=True)
class Added:
    """An entry that was added."""

    number: int
    entry: Entry
    digest: str


def log_added(added: Sequence[Added]) -> None:
    """Log entries that are on record. A log that is kept elsewhere so has what no hand in the database can change."""
    for one in added:
        entry = one.entry
        what = f"{entry.action} of surface {entry.surface}" if entry.surface else entry.action
        _log.info("trail: entry %d, %s, by %s; digest %s", one.number, what, entry.by, one.digest)


def add_entries(connection: Connection, entries: Sequence[Entry]) -> list[Added]:
    """Add the entries that say something new, in a transaction that writes; return them.

    An entry whose details are those of the last one of its action, surface and subject is left out: so another service
    has noticed the same, or a commit whose answer was lost is repeated.
    """
    last = connection.execute(select(_c.number, _c.digest).order_by(_c.number.desc()).limit(1)).first()
    number, digest = (last.number, last.digest) if last else (0, FIRST)
    added = list[Added]()
    for entry in entries:
        of_key = (_c.action == entry.action) & (_c.surface == entry.surface) & (_c.subject == entry.subject)
        before = select(_c.details).where(of_key).order_by(_c.number.desc()).limit(1)
        if connection.scalar(before) == entry.details:
            continue
        values: dict[str, Any] = {column.name: getattr(entry, column.name) for column in CONTENT}
        number, digest = number + 1, digest_of(digest, number + 1, list(values.values()))
        connection.execute(insert(TRAIL).values(number=number, digest=digest, **values))
        added.append(Added(number, entry, digest))
    return added
