"""Tells on the trail which events the record deleted by its limits: at most once a day, and none is forgotten."""

from sqlalchemy import Connection, select, update

from beamtouch_service.record.database.tables import TIME
from beamtouch_service.record.trail.entry import Action, Entry, encode_details
from beamtouch_service.record.trail.table import Added, add_entries

EVERY_S = 86_400.0
"""Time between two entries. A full record deletes some events each minute, and the trail is kept for good."""


def tell_deletions(connection: Connection, old: int, oversize: int, passed_s: float, at_us: int) -> list[Added]:
    """Count events as deleted, in the transaction that deletes them; add an entry if one is due, and return it.

    Parameters
    ----------
    old, oversize : events that were too old, and those above the size limit
    passed_s : the time of the record [s]
    at_us : the wall clock [us since 1970]
    """
    sums = connection.execute(select(TIME.c.deleted_old, TIME.c.deleted_oversize, TIME.c.told_s)).one()
    old, oversize = old + sums.deleted_old, oversize + sums.deleted_oversize
    is_due = sums.told_s is None or passed_s - sums.told_s >= EVERY_S
    if not old and not oversize:
        return []
    if not is_due:
        connection.execute(update(TIME).values(deleted_old=old, deleted_oversize=oversize))
        return []
    connection.execute(update(TIME).values(deleted_old=0, deleted_oversize=0, told_s=passed_s))
    # The time makes each entry another one: two days may have the same counts.
    details = {"too_old": old, "beyond_max_mb": oversize, "record_s": round(passed_s)}
    return add_entries(connection, [Entry(at_us, Action.DELETION, encode_details(details))])
