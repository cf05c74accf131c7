"""The confirmed results of commissionings, in the record."""

from sqlalchemy import JSON, Column, String, Table, delete, insert, select

from beamtouch_service.commissioning.report import Recorded, Report
from beamtouch_service.record import (
    ROW_NUMBER,
    TABLES,
    Entry,
    Reader,
    Rows,
    Transactions,
    add_entries,
    log_added,
)

MAX_KEPT = 20
"""Results that are kept of each surface, however old they are."""
_RESULTS = Table(
    "commissionings",
    TABLES,
    Column("id", ROW_NUMBER, primary_key=True),
    Column("surface", String, nullable=False, index=True),
    Column("run", String, nullable=False, unique=True),
    Column("report", JSON, nullable=False),
    sqlite_autoincrement=True,
)
"""A row per confirmed result. It is of people, not of samples, so no cursor knows it."""
_ROWS = Rows(_RESULTS.name, {"report": Report})
_c = _RESULTS.c


def add(transactions: Transactions, run: str, report: Report, entry: Entry) -> int:
    """Put the result of a run on record, unless it is there, with an entry on the trail; return its id.

    Results beyond the newest are dropped.
    """
    of_surface = _c.surface == report.surface
    row = {"surface": report.surface, "run": run, "report": report.model_dump(mode="json")}
    with transactions.database.writing() as connection:
        number: int | None = connection.scalar(select(_c.id).where(_c.run == run))
        if number is None:
            number = connection.execute(insert(_RESULTS).returning(_c.id), row).scalar_one()
            newest = select(_c.id).where(of_surface).order_by(_c.id.desc()).limit(MAX_KEPT)
            connection.execute(delete(_RESULTS).where(of_surface, _c.id.not_in(newest)))
        added = add_entries(connection, [entry])
    log_added(added)
    return number


def read(reader: Reader, surface: str) -> list[Recorded]:
    """Return the results of a surface, newest first; raises RecordAwayError."""
    query = select(_c.id, _c.report).where(_c.surface == surface).order_by(_c.id.desc())
    results = []
    for row in reader.rows(query):
        _ROWS.require_whole(f"the result {row.id} of surface {surface}", row._asdict())
        results.append(Recorded.model_validate({"id": row.id, **row.report}))
        reader.rest()
    return results
