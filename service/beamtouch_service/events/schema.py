"""The tables of the events, and the upgrades of older ones."""

from collections.abc import Iterator
from itertools import count
from typing import cast

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Connection,
    Double,
    Enum,
    Executable,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    func,
    literal_column,
    select,
    text,
)
from sqlalchemy.engine.default import DefaultExecutionContext
from sqlalchemy.schema import CreateIndex, CreateTable

from beamtouch_models.modelfile import State
from beamtouch_service.events.segments import Begin, End, EventKind

FORMAT = 6
"""The format of a database of this version of the service; 0 is an empty one."""


_CHANGES = "beamtouch changes"
"""Key of the numbers of changes, in what SQLAlchemy keeps of an open connection."""


def _next_change(context: DefaultExecutionContext) -> int:
    numbers = cast("Iterator[int] | None", context.root_connection.info.get(_CHANGES))
    return next(numbers) if numbers else 0


def number_changes(connection: Connection) -> None:
    """Number the changes of events through this connection from now on, each higher than all before."""
    highest = select(func.max(EVENTS.c.change)).union_all(select(func.max(DELIVERIES.c.change)))
    connection.info[_CHANGES] = count(max(number or 0 for number in connection.scalars(highest)) + 1)


def _words(words: type[Begin | End | EventKind | State]) -> Enum:
    return Enum(words, native_enum=False, length=20, values_callable=lambda members: [one.value for one in members])


EVENTS = Table(
    "events",
    MetaData(),
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    Column("surface", String, nullable=False),
    Column("model", String, nullable=False),
    Column("boot_id", String, nullable=False),
    Column("first_sequence", BigInteger, nullable=False),
    Column("last_sequence", BigInteger, nullable=False),
    Column("touched_us", BigInteger, nullable=False),
    Column("last_us", BigInteger, nullable=False),
    Column("lifted_us", BigInteger),
    Column("begin", _words(Begin), nullable=False),
    Column("end", _words(End), nullable=False),
    Column("samples", BigInteger, nullable=False),
    Column("position_sum_mm", Double, nullable=False),
    Column("peak_force_n", Double),
    Column("peak_position_mm", Double),
    Column("degraded", Boolean, nullable=False),
    Column("path", JSON, nullable=False),
    Column("recorded_s", Double, nullable=False),
    Column("kind", _words(EventKind), nullable=False, server_default=EventKind.CONTACT),
    Column("unexplained_us", BigInteger, nullable=False, server_default="0"),
    Column("ends_unexplained", Boolean, nullable=False, server_default="0"),
    Column("unsteady", Boolean, nullable=False, server_default="0"),
    Column("best", JSON(none_as_null=True)),
    Column("change", BigInteger, nullable=False, server_default="0", default=_next_change, onupdate=_next_change),
    sqlite_autoincrement=True,
)
"""A row per event: the fields of a `Segment`, and when it was last written [s since 1970, by the service's clock].

`change` is the number of its last change; of two changes, the later one has the higher number. It stays 0 in a database
of several services, which have no common order of changes.
"""
CAPTURES = Table(
    "captures",
    EVENTS.metadata,
    Column("surface", String, primary_key=True),
    Column("boot_id", String, primary_key=True),
    Column("model", String, primary_key=True),
    Column("sequence", BigInteger, primary_key=True, autoincrement=False),
    Column("sample", JSON, nullable=False),
)
"""A row per sample that is kept of an unexplained stretch. It belongs to the event that holds its number."""
BASELINES = Table(
    "baselines",
    EVENTS.metadata,
    Column("surface", String, primary_key=True),
    Column("model", String, nullable=False),
    Column("characteristic", String),
    Column("last_event", BigInteger, nullable=False),
    Column("newest_us", BigInteger, nullable=False),
    Column("history", JSON, nullable=False),
)
"""A row per surface: what the best samples of its events add up to since its baseline, up to the event `last_event`."""
DELIVERIES = Table(
    "deliveries",
    EVENTS.metadata,
    Column("destination", String, primary_key=True),
    Column("change", BigInteger, nullable=False),
    Column("event", BigInteger, nullable=False),
)
"""A row per destination of events: the change that it acknowledged last, and the event that was changed."""
EDGES = Table(
    "edges",
    EVENTS.metadata,
    Column("surface", String, primary_key=True),
    Column("boot_id", String, primary_key=True),
    Column("sequence", BigInteger, primary_key=True, autoincrement=False),
    Column("model", String, nullable=False),
    Column("acquired_us", BigInteger, nullable=False),
    Column("state", _words(State)),
    Column("past", JSON, nullable=False),
    Column("recorded_s", Double, nullable=False),
)
"""A row per sample next to a gap. Samples on the other side may come later, or to another service."""
FORMATS = Table("beamtouch_format", MetaData(), Column("format", Integer, nullable=False))
"""One row: the format of a database that has no header for it, as a SQLite file has."""
_c = EVENTS.c
# Written out: SQLite uses a partial index only for a condition without parameters.
IS_OPEN = _c.end == literal_column(f"'{End.OPEN}'")
_by_open = Index("by_open", _c.surface, sqlite_where=IS_OPEN, postgresql_where=IS_OPEN)
IS_FINISHED = _c.end != literal_column(f"'{End.OPEN}'")
_by_change = Index("by_change", _c.change, _c.id, sqlite_where=IS_FINISHED, postgresql_where=IS_FINISHED)
Index("by_time", _c.touched_us, _c.id)
Index("by_surface", _c.surface, _c.touched_us, _c.id)
Index("by_first", _c.surface, _c.boot_id, _c.first_sequence)
Index("by_last", _c.surface, _c.boot_id, _c.last_sequence)
Index("by_record", _c.recorded_s)
Index("edges_by_record", EDGES.c.recorded_s)

_UPGRADES: dict[int, list[Executable]] = {
    1: [CreateIndex(_by_open)],
    2: [
        text("ALTER TABLE events ADD COLUMN kind VARCHAR(20) DEFAULT 'contact' NOT NULL"),
        text("ALTER TABLE events ADD COLUMN unexplained_us BIGINT DEFAULT '0' NOT NULL"),
        text("ALTER TABLE events ADD COLUMN ends_unexplained BOOLEAN DEFAULT '0' NOT NULL"),
        CreateTable(CAPTURES),
    ],
    3: [
        text("ALTER TABLE events ADD COLUMN unsteady BOOLEAN DEFAULT '0' NOT NULL"),
        text("ALTER TABLE events ADD COLUMN best JSON"),
        CreateTable(BASELINES),
    ],
    4: [
        text("ALTER TABLE events ADD COLUMN change BIGINT DEFAULT '0' NOT NULL"),
        text("UPDATE events SET change = id"),
        CreateIndex(_by_change),
        CreateTable(DELIVERIES),
    ],
    5: [CreateTable(EDGES), *(CreateIndex(index) for index in EDGES.indexes)],
}
"""Format -> statements that turn it into the next format."""


def upgrade(connection: Connection, found: int) -> None:
    """Bring a database of format `found` to `FORMAT`; raises ValueError for a format that is not known."""
    if found == 0:
        # If the tables exist, the database belongs to another program, and this fails.
        EVENTS.metadata.create_all(connection, checkfirst=False)
        return
    if found != FORMAT and found not in _UPGRADES:
        message = f"written by another version of the service (format {found}); move it away"
        raise ValueError(message)
    for step in range(found, FORMAT):
        for statement in _UPGRADES[step]:
            connection.execute(statement)
