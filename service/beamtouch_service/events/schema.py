"""The tables of the events, and the upgrades of older ones."""

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Column,
    Connection,
    Double,
    Enum,
    ExecutableDDLElement,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    literal_column,
)
from sqlalchemy.schema import CreateIndex

from beamtouch_service.events.segments import Begin, End

FORMAT = 2
"""The format of a database of this version of the service; 0 is an empty one."""


def _words(words: type[Begin | End]) -> Enum:
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
    sqlite_autoincrement=True,
)
"""A row per event: the fields of a `Segment`, and when it was last written [s since 1970, by the service's clock]."""
_c = EVENTS.c
# Written out: SQLite uses a partial index only for a condition without parameters.
IS_OPEN = _c.end == literal_column(f"'{End.OPEN}'")
_by_open = Index("by_open", _c.surface, sqlite_where=IS_OPEN, postgresql_where=IS_OPEN)
Index("by_time", _c.touched_us, _c.id)
Index("by_surface", _c.surface, _c.touched_us, _c.id)
Index("by_first", _c.surface, _c.boot_id, _c.first_sequence)
Index("by_last", _c.surface, _c.boot_id, _c.last_sequence)
Index("by_record", _c.recorded_s)

_UPGRADES: dict[int, list[ExecutableDDLElement]] = {1: [CreateIndex(_by_open)]}
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
