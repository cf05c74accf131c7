"""Contacts on disk, in SQLite. One thread at a time; every call is one transaction."""

import json
import sqlite3
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from beamtouch_service.events.lock import EventFileInUseError, EventLock
from beamtouch_service.events.pieces import Begin, End, Piece, joined
from beamtouch_service.events.segmenter import Command, Finish, Loss, TouchSeen

_VERSION = 2
_PRUNE_SHARE = 20
"""What is too much goes in parts of one in this many."""
_COLUMNS = [entry.name for entry in fields(Piece)]
_NAMES = ", ".join(f'"{name}"' for name in _COLUMNS)
_SCHEMA = """
BEGIN;
CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT, surface TEXT NOT NULL, model TEXT NOT NULL, boot_id TEXT NOT NULL,
    first_sequence INTEGER NOT NULL, last_sequence INTEGER NOT NULL, touched_us INTEGER NOT NULL,
    last_us INTEGER NOT NULL, lifted_us INTEGER, "begin" TEXT NOT NULL, "end" TEXT NOT NULL, samples INTEGER NOT NULL,
    position_sum_mm REAL NOT NULL, peak_force_n REAL, peak_position_mm REAL, degraded INTEGER NOT NULL,
    path TEXT NOT NULL, recorded_s REAL NOT NULL);
CREATE INDEX by_time ON events (touched_us, id);
CREATE INDEX by_surface ON events (surface, touched_us, id);
CREATE INDEX by_first ON events (surface, boot_id, first_sequence);
CREATE INDEX by_last ON events (surface, boot_id, last_sequence);
CREATE INDEX by_record ON events (recorded_s);
CREATE INDEX by_open ON events (surface) WHERE "end" = 'open';
PRAGMA user_version = 2;
COMMIT;
"""
_UPGRADE = """
BEGIN;
CREATE INDEX by_open ON events (surface) WHERE "end" = 'open';
PRAGMA user_version = 2;
COMMIT;
"""
"""From version 1, which knew no `stale`."""
_END_OPEN = """UPDATE events SET "end" = 'unseen' WHERE "end" = 'open' AND surface = ?"""


class EventStoreError(Exception):
    """The file cannot be used; the message says why and what to do, in one line."""


@dataclass(frozen=True)
class Selection:
    """Which events to read, newest first."""

    surface: str | None = None
    since_us: int | None = None
    """Touched then or later."""
    until_us: int | None = None
    """Touched before."""
    after: tuple[int, int] | None = None
    """Touch time and id of the last one that was read."""
    limit: int = 100
    path: bool = True
    """Read paths too; they are by far the most of an event."""


class EventStore:
    """The events of all surfaces."""

    def __init__(self, path: Path | None, keep_s: float, most_bytes: int, wait_s: float = 0.0) -> None:
        """Open the file, for `wait_s` [s] while another service has it; raises EventStoreError."""
        self._keep_s, self._most_bytes = keep_s, most_bytes
        self._lock: EventLock | None = None
        try:
            # Makes the file where there is none, and reads nothing of it yet.
            self._database = sqlite3.connect(path or ":memory:", isolation_level=None, check_same_thread=False)
        except sqlite3.Error as error:
            raise _unusable(path, str(error)) from None
        try:
            self._lock = EventLock(path, wait_s) if path else None
            self._prepare()
        except EventFileInUseError:
            self._release()
            message = f"{path}: another running service writes to it; stop that service, or give each a file of its own"
            raise EventStoreError(message) from None
        except OSError as error:
            self._release()
            raise _unusable(path, error.strerror or str(error)) from None
        except sqlite3.Error as error:
            self._release()
            raise _unusable(path, str(error)) from None

    def _release(self) -> None:
        self._database.close()
        if self._lock:
            self._lock.close()

    def _prepare(self) -> None:
        for pragma in ("journal_mode=WAL", "synchronous=NORMAL", "journal_size_limit=4194304", "busy_timeout=2000"):
            self._database.execute("PRAGMA " + pragma)
        (version,) = self._database.execute("PRAGMA user_version").fetchone()
        if version not in (0, 1, _VERSION):
            message = f"written by another version of the service (format {version}); move it away"
            raise sqlite3.DatabaseError(message)
        if version != _VERSION:
            self._database.executescript(_UPGRADE if version else _SCHEMA)
        # Nobody saw how these ended: the service was stopped or killed during them.
        self._database.execute('UPDATE events SET "end" = ? WHERE "end" = ?', (End.UNFINISHED, End.OPEN))

    def write(self, surface: str, commands: Iterable[Command], now_s: float) -> None:
        """Carry out commands at `now_s` [s since 1970, by the service's clock], all or none."""
        self._database.execute("BEGIN IMMEDIATE")
        try:
            for command in commands:
                self._carry_out(surface, command, now_s)
            self._database.execute("COMMIT")
        except BaseException:
            if self._database.in_transaction:
                self._database.execute("ROLLBACK")
            raise

    def _carry_out(self, surface: str, command: Command, now_s: float) -> None:
        if isinstance(command, Piece):
            self._add(command, now_s)
        elif isinstance(command, Finish):
            # A gap or silence ends only what goes on; a lift also what was interrupted just before it.
            endable = [end for end in End if end is not End.LIFT] if command.end is End.LIFT else [End.OPEN]
            self._database.execute(
                'UPDATE events SET "end" = ?, lifted_us = ? WHERE surface = ? AND boot_id = ? AND last_sequence = ? '
                'AND "end" IN (SELECT value FROM json_each(?))',
                (command.end, command.lifted_us, surface, command.boot_id, command.last_sequence, json.dumps(endable)),
            )
        elif isinstance(command, Loss):
            self._database.execute(_END_OPEN, (surface,))
        elif isinstance(command, TouchSeen):
            self._database.execute(
                'UPDATE events SET "begin" = ? WHERE surface = ? AND boot_id = ? AND first_sequence = ?',
                (Begin.TOUCH, surface, command.boot_id, command.first_sequence),
            )

    def _add(self, piece: Piece, now_s: float) -> None:
        key = (piece.surface, piece.boot_id, piece.model)
        where = "surface = ? AND boot_id = ? AND model = ?"
        # A sample that was sent again after a restart of the service must not be recorded twice: pieces may overlap.
        left = self._find(
            f'{where} AND first_sequence <= ? AND (last_sequence >= ? OR (last_sequence = ? AND "end" != ? AND ?)) '
            "ORDER BY first_sequence DESC",
            (
                *key,
                piece.first_sequence,
                piece.first_sequence,
                piece.first_sequence - 1,
                End.LIFT,
                piece.begin is Begin.UNSEEN,
            ),
        )
        if left and left[1].last_sequence >= piece.last_sequence:
            return
        row, whole = (left[0], joined(left[1], piece)) if left else (None, piece)
        right = self._find(
            f'{where} AND first_sequence > ? AND first_sequence <= ? AND "begin" = ? ORDER BY first_sequence',
            (*key, piece.first_sequence, piece.last_sequence + 1, Begin.UNSEEN),
        )
        if right:
            whole = joined(whole, right[1])
            if row is None:
                row = right[0]
            else:
                self._database.execute("DELETE FROM events WHERE id = ?", (right[0],))
        self._put(row, whole, now_s)

    def _find(self, condition: str, values: tuple[object, ...]) -> tuple[int, Piece] | None:
        query = f"SELECT id, {_NAMES} FROM events WHERE {condition} LIMIT 1"  # noqa: S608  # our own text only
        found = self._database.execute(query, values).fetchone()
        return (found[0], _piece(found[1:])) if found else None

    def _put(self, row: int | None, piece: Piece, now_s: float) -> None:
        if piece.end is End.OPEN:
            # A surface has one newest sample: an event that is still open beside this one was left so by a lost write.
            self._database.execute(f"{_END_OPEN} AND id IS NOT ?", (piece.surface, row))
        values = asdict(piece) | {"path": json.dumps(piece.path), "id": row, "recorded_s": now_s}
        names = ", ".join(f'"{name}"' for name in values)
        places = ", ".join(f":{name}" for name in values)
        self._database.execute(f"INSERT OR REPLACE INTO events ({names}) VALUES ({places})", values)  # noqa: S608

    def read(self, selection: Selection) -> list[tuple[int, Piece]]:
        """Return id and content of the selected events, newest touch first."""
        conditions, values = ["1"], list[object]()
        for condition, value in (
            ("surface = ?", selection.surface),
            ("touched_us >= ?", selection.since_us),
            ("touched_us < ?", selection.until_us),
        ):
            if value is not None:
                conditions.append(condition)
                values.append(value)
        if selection.after:
            conditions.append("(touched_us, id) < (?, ?)")
            values += selection.after
        names = _NAMES if selection.path else _NAMES.replace('"path"', "'[]'")
        query = (
            f"SELECT id, {names} FROM events WHERE {' AND '.join(conditions)} "  # noqa: S608  # our own text only
            "ORDER BY touched_us DESC, id DESC LIMIT ?"
        )
        return [(row[0], _piece(row[1:])) for row in self._database.execute(query, (*values, selection.limit))]

    def get(self, number: int) -> Piece | None:
        """Return the event of that id, None if there is none."""
        found = self._find("id = ?", (number,))
        return found[1] if found else None

    def recorded_since(self, since_s: float, most: int) -> tuple[list[Piece], int]:
        """Return what was recorded since then [s since 1970], the newest and `most` at most, and how many there are."""
        query = f"SELECT {_NAMES} FROM events WHERE recorded_s >= ? ORDER BY recorded_s DESC LIMIT ?"  # noqa: S608
        events = [_piece(row) for row in self._database.execute(query, (since_s, most))]
        query = "SELECT COUNT(*) FROM events WHERE recorded_s >= ?"
        return events, int(self._database.execute(query, (since_s,)).fetchone()[0])

    def goes_on(self, surface: str, boot_id: str, sequence: int) -> bool:
        """Return whether that sample is the last on record of a contact whose lift was not seen."""
        query = 'SELECT 1 FROM events WHERE surface = ? AND boot_id = ? AND last_sequence = ? AND "end" != ? LIMIT 1'
        return self._database.execute(query, (surface, boot_id, sequence, End.LIFT)).fetchone() is not None

    def prune(self, now_s: float) -> int:
        """Drop what is too old at `now_s` [s since 1970], then the oldest of what is too much; return how many."""
        dropped = self._database.execute("DELETE FROM events WHERE recorded_s < ?", (now_s - self._keep_s,)).rowcount
        while self.used_bytes() > self._most_bytes:
            (count,) = self._database.execute("SELECT COUNT(*) FROM events").fetchone()
            if not count:
                break
            share = max(1, count // _PRUNE_SHARE)
            dropped += self._database.execute(
                "DELETE FROM events WHERE id IN (SELECT id FROM events ORDER BY recorded_s LIMIT ?)", (share,)
            ).rowcount
        return dropped

    def used_bytes(self) -> int:
        """Return how much of the file is in use; what was dropped is used again, so the file grows no further."""
        pages, free, size = (
            self._database.execute(f"PRAGMA {name}").fetchone()[0]
            for name in ("page_count", "freelist_count", "page_size")
        )
        return int((pages - free) * size)

    def close(self) -> None:
        """Close the file; what goes on is unfinished. If that cannot be written, the next to open the file says so."""
        try:
            self._database.execute("PRAGMA busy_timeout=200")
            self._database.execute('UPDATE events SET "end" = ? WHERE "end" = ?', (End.UNFINISHED, End.OPEN))
        finally:
            self._release()


def _unusable(path: Path | None, reason: str) -> EventStoreError:
    return EventStoreError(f"{path}: {reason}; set events.file to one that the service can write")


def _piece(row: tuple[object, ...]) -> Piece:
    values = dict(zip(_COLUMNS, row, strict=True))
    values |= {
        "begin": Begin(str(values["begin"])),
        "end": End(str(values["end"])),
        "degraded": bool(values["degraded"]),
        "path": [tuple(point) for point in json.loads(str(values["path"]))],
    }
    return Piece(**values)  # type: ignore[arg-type]  # the columns are the fields
