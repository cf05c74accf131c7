"""Keeps the record within its limits: how old its events become, and how large it is."""

import logging
from collections.abc import Collection
from typing import NamedTuple

from sqlalchemy import Connection, delete, exists, func, select, tuple_, update

from beamtouch_common.log_lines import Repeated
from beamtouch_common.spans import apart, are_apart
from beamtouch_service.record.database.connections import Database
from beamtouch_service.record.database.tables import CURSORS, EVENTS, IS_FINISHED, TIME, read_time
from beamtouch_service.record.trail.deletions import tell_deletions
from beamtouch_service.record.trail.table import log_added
from beamtouch_service.record.writing.ageing import RecordTime, Watch
from beamtouch_service.sections import EventsSection

_SHARE = 20
"""1/20 of the events goes at a time: of those that are too old once a look, of the oldest above the size limit until it
is kept. So a wrong limit does not empty the record before somebody reads the log."""
_FEWEST = 100
"""This many may always go at a time."""
_QUIET_BOOT_S = 86_400.0
"""The cursor of a boot without an event on record is deleted this long after its last sample. A daemon that restarts
every few seconds would fill the record with them, and so displace events."""
_c = EVENTS.c
_log = logging.getLogger(__name__)


class Deleted(NamedTuple):
    """Events that were deleted at one time."""

    old: int
    """Older than `keep_days`."""
    are_more_old: bool
    """True if there are more of these, which stay until the next time."""
    oversize: int
    """The oldest ones of a record above `max_mb`."""


class Retention:
    """The limits of a record, and the time by which its events grow old."""

    def __init__(self, events: EventsSection) -> None:
        self.old = self.oversize = 0
        """Events that were deleted since the start of the service, for each reason."""
        self._keep_s, self._max_bytes = events.keep_days * 86_400, events.largest_mb * 1e6
        self._watch = Watch(self._keep_s)
        self._hourly = Repeated(_log, every_s=3600.0)

    def tidy(
        self, database: Database, clock_s: float, uptime_s: float, held: Collection[tuple[str, str]] = ()
    ) -> Deleted:
        """Delete what is too old, and the oldest events above the size limit; raises RecordAwayError.

        The cursor of a boot stays as long as an event of it, and while this service goes on from it. Any other loses
        its cursor after a day; if its sender comes back, the record begins with what that keeps.

        Parameters
        ----------
        clock_s : the wall clock of this machine [s since 1970]; a database with a clock of its own goes by that
        uptime_s : the time by a clock that never jumps [s]
        held : surface and boot of each cursor that this service goes on from
        """
        with database.writing() as connection:
            stored = RecordTime(*read_time(connection))
            shared_s = database.clock_s(connection)
            time, watch, warning = self._watch.look(stored, shared_s or clock_s, uptime_s)
            connection.execute(update(TIME).values(time._asdict()))
            old, are_more_old = _delete_old(connection, time.passed_s - self._keep_s)
            _delete_quiet_boots(connection, time.passed_s - min(self._keep_s, _QUIET_BOOT_S), held)
            oversize = self._shrink(database, connection)
            deleted, at_s = Deleted(old, are_more_old, oversize), shared_s or clock_s
            added = tell_deletions(connection, deleted.old, deleted.oversize, time.passed_s, round(at_s * 1e6))
        self._watch = watch
        log_added(added)
        if warning:
            _log.warning("the record of events: %s", warning)
        if shared_s is not None and are_apart(clock_s - shared_s) and self._hourly.due("apart"):
            words = "the clock of this machine is %s that of the database; the record goes by the latter"
            _log.warning(words, apart(clock_s - shared_s))
        return self._note(deleted)

    def _note(self, deleted: Deleted) -> Deleted:
        """Count what was deleted, and log it once an hour."""
        self.old += deleted.old
        self.oversize += deleted.oversize
        limit = f"{self._keep_s / 86_400:g} days"
        words = f"events were deleted, as they were older than {limit}"
        self._hourly.count(deleted.old, words, logging.WARNING if deleted.are_more_old else logging.INFO)
        words = f"events were deleted before they were {limit} old: the record is full; see events.max_mb"
        self._hourly.count(deleted.oversize, words)
        return deleted

    def _shrink(self, database: Database, connection: Connection) -> int:
        """Delete the oldest finished events until the record is within its size; return how many."""
        deleted = 0
        while database.used_bytes(connection) > self._max_bytes:
            oldest = select(_c.id).where(IS_FINISHED).order_by(_c.recorded_s, _c.id).limit(_share(connection))
            removed = connection.execute(delete(EVENTS).where(_c.id.in_(oldest))).rowcount
            if not removed:
                break
            deleted += removed
        return deleted


def _share(connection: Connection, fewest: int = 1) -> int:
    """Return how many events may go at a time."""
    count = connection.scalar(select(func.count()).select_from(EVENTS).where(IS_FINISHED)) or 0
    return max(fewest, count // _SHARE)


def _delete_old(connection: Connection, before_s: float) -> tuple[int, bool]:
    """Delete events from before this time of the record; return how many, and whether there are more."""
    is_old = _c.recorded_s < before_s
    if connection.scalar(select(_c.id).where(is_old).limit(1)) is None:
        return 0, False
    oldest = select(_c.id).where(is_old).order_by(_c.recorded_s, _c.id).limit(_share(connection, _FEWEST))
    deleted = connection.execute(delete(EVENTS).where(_c.id.in_(oldest))).rowcount
    return deleted, connection.scalar(select(_c.id).where(is_old).limit(1)) is not None


def _delete_quiet_boots(connection: Connection, before_s: float, held: Collection[tuple[str, str]]) -> None:
    """Delete the cursors from before this time of the record of boots that have no event and are not held."""
    has_event = exists().where(_c.surface == CURSORS.c.surface, _c.boot_id == CURSORS.c.boot_id)
    is_held = tuple_(CURSORS.c.surface, CURSORS.c.boot_id).in_(list(held))
    connection.execute(delete(CURSORS).where(CURSORS.c.recorded_s < before_s, ~has_event, ~is_held))
