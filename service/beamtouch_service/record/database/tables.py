"""The tables of the record."""

from dataclasses import Field, fields
from types import NoneType, UnionType
from typing import Annotated, Any, get_args, get_origin

from pydantic import Field as Values
from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Connection,
    Double,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    Row,
    String,
    Table,
    insert,
    inspect,
    literal_column,
    select,
)
from sqlalchemy.types import TypeEngine

from beamtouch_service.record.database.rows import Rows, Version
from beamtouch_service.record.database.values import Word
from beamtouch_service.record.events.event import Begin, End, Event, EventKind, Numbered

FORMAT = 17
"""The format of the record. A record of another one is refused. Raise it when a table, a field of `Event` or the memory
of a cursor changes."""
ROW_NUMBER = BigInteger().with_variant(Integer, "sqlite")
"""The type of a column that numbers the rows."""
TABLES = MetaData()
"""All tables of the database. Another room adds its own here when it is imported: they are created with the others."""


_TYPES: dict[object, TypeEngine[Any]] = {
    str: String(),
    int: BigInteger(),
    float: Double(),
    bool: Boolean(),
    list: JSON(),
    dict: JSON(none_as_null=True),
    **{words: Word(words) for words in (Begin, End, EventKind)},
}


def _column(entry: Field[Any]) -> Column[Any]:
    """Return the column of a field of an event; it may be empty if the field may be None.

    Raises TypeError for a field of a type that has no column, as of one in quotation marks.
    """
    kinds = get_args(entry.type) if isinstance(entry.type, UnionType) else (entry.type,)
    held = [get_origin(kind) or kind for kind in kinds if kind is not NoneType]
    if len(held) != 1 or held[0] not in _TYPES:
        raise TypeError(f"no column for the field {entry.name} of an event: {entry.type}")
    return Column(entry.name, _TYPES[held[0]], nullable=NoneType in kinds)


EVENTS = Table(
    "events",
    TABLES,
    Column("id", ROW_NUMBER, primary_key=True),
    *map(_column, fields(Event)),
    Column("recorded_s", Double, nullable=False),
    sqlite_autoincrement=True,
)
"""A row per event: the fields of an `Event`, and the time of the record when it was last written."""
CURSORS = Table(
    "cursors",
    TABLES,
    Column("surface", String, primary_key=True),
    Column("boot_id", String, primary_key=True),
    Column("durable", BigInteger, nullable=False),
    Column("version", BigInteger, nullable=False),
    Column("model", String, nullable=False),
    Column("memory", JSON, nullable=False),
    Column("event", BigInteger),
    Column("recorded_s", Double, nullable=False),
)
"""A row per boot of a sender: the number of its last sample on record, how often the row was written, what the decision
on the next sample needs, and the event that is open."""
HEALTH = Table(
    "health",
    TABLES,
    Column("surface", String, primary_key=True),
    Column("version", BigInteger, nullable=False),
    Column("model", String, nullable=False),
    Column("characteristic", String),
    Column("newest_us", BigInteger, nullable=False),
)
"""A row per surface: what the best samples of its events are of, and the newest of them."""
HEALTH_BLOCKS = Table(
    "health_blocks",
    TABLES,
    Column("surface", String, primary_key=True),
    Column("first_us", BigInteger, primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("block", JSON, nullable=False),
)
"""Sums of the best samples since the baseline of a surface began: a row per `health.BlockKey`."""
TIME = Table(
    "time",
    TABLES,
    Column("passed_s", Double, nullable=False),
    Column("clock_s", Double),
    Column("deleted_old", BigInteger, nullable=False, default=0),
    Column("deleted_oversize", BigInteger, nullable=False, default=0),
    Column("told_s", Double),
)
"""One row: the time of the record, as `ageing.RecordTime`; the events that were deleted and do not stand on the trail
yet; and when it told of some last."""
DESTINATIONS = Table("destinations", TABLES, Column("name", String, primary_key=True))
DELIVERIES = Table(
    "deliveries",
    TABLES,
    Column("number", ROW_NUMBER, primary_key=True),
    Column("destination", String, nullable=False),
    Column("event", BigInteger, ForeignKey("events.id", ondelete="CASCADE"), nullable=False, index=True),
    sqlite_autoincrement=True,
)
"""A row per finished event that a destination has yet to acknowledge, in the order in which they finished."""
_FORMATS = Table("beamtouch_format", TABLES, Column("format", Integer, nullable=False))

# Written out: SQLite uses a partial index only for a condition without parameters.
IS_FINISHED = EVENTS.c.end != literal_column(f"'{End.OPEN}'")
Index("by_time", EVENTS.c.touched_us, EVENTS.c.id)
Index("by_surface", EVENTS.c.surface, EVENTS.c.touched_us, EVENTS.c.id)
Index("by_boot", EVENTS.c.surface, EVENTS.c.boot_id)
Index("by_record", EVENTS.c.recorded_s)

CONTENT = [EVENTS.c[entry.name] for entry in fields(Event)]
WITHOUT_PATH = [column for column in CONTENT if column.name not in ("path", "best", "capture")]


_Time = Annotated[int, Values(ge=-(2**53), lt=2**53)]
"""A time that a calendar has [us since 1970]."""
_Count = Annotated[int, Values(ge=0, lt=2**53)]
_Number = Annotated[float, Values(ge=-(2.0**53), lt=2.0**53)] | bool
_EVENT_ROWS = Rows(
    EVENTS.name,
    {entry.name: entry.type for entry in fields(Event)}
    | {
        "touched_us": _Time,
        "last_us": _Time,
        "lifted_us": _Time | None,
        "samples": _Count,
        "unsteady_samples": _Count,
        "place": dict[str, Annotated[list[float | None], Values(min_length=6, max_length=6)] | None],
        "path": list[Annotated[list[_Number], Values(min_length=3)]],
    },
)
CURSOR_ROWS = Rows(
    CURSORS.name,
    {"durable": int, "version": Version, "model": str, "memory": dict[str, Any], "event": int | None},
)
HEALTH_ROWS = Rows(HEALTH.name, {"version": Version, "model": str, "characteristic": str | None, "newest_us": int})
BLOCK_ROWS = Rows(HEALTH_BLOCKS.name, {"first_us": int, "number": int, "block": list[Any]})
_TIME_ROWS = Rows(TIME.name, {"passed_s": float, "clock_s": float | None})


def read_time(connection: Connection) -> tuple[float, float | None]:
    """Return the time of the record, as `ageing.RecordTime`; raises UnreadableRowError."""
    row = connection.execute(select(TIME.c.passed_s, TIME.c.clock_s)).one()
    _TIME_ROWS.require_whole("the time of the record", row._asdict())
    return row.passed_s, row.clock_s


def require_whole_event(row: Row[*tuple[Any, ...]]) -> None:
    """Raise UnreadableRowError if a row with the id of an event, its surface and some of `CONTENT` is damaged."""
    _EVENT_ROWS.require_whole(f"event {row.id} of surface {row.surface}", row._asdict())


def event_of(row: Row[*tuple[Any, ...]]) -> Numbered:
    """Return the event of a row of `CONTENT`, with or without its path; raises UnreadableRowError."""
    values = row._asdict()  # once: that takes an eighth of the time of an event
    number = values.pop("id")
    _EVENT_ROWS.require_whole(f"event {number} of surface {row.surface}", values)
    values.pop("number", None)  # of a delivery
    return Numbered(number, Event(**values))


class OtherFormatError(Exception):
    """The database is not a record of this version; the message gives the reason."""


def is_current(connection: Connection) -> bool:
    """Return whether the tables are there, in this format."""
    return inspect(connection).has_table(_FORMATS.name) and connection.scalar(select(_FORMATS.c.format)) == FORMAT


def prepare(connection: Connection) -> None:
    """Create the tables in an empty database; raises OtherFormatError for any other that has not got them."""
    present = inspect(connection).get_table_names()
    if not present:
        TABLES.create_all(connection, checkfirst=False)
        connection.execute(insert(_FORMATS).values(format=FORMAT))
        connection.execute(insert(TIME).values(passed_s=0.0))
    elif _FORMATS.name not in present:
        raise OtherFormatError("it is the database of another program")
    elif (found := connection.scalar(select(_FORMATS.c.format))) != FORMAT:
        raise OtherFormatError(f"another version of the service wrote it (format {found}); move it away")
