"""The logs of all surfaces, and the file behind them: what stays in memory for long is written to it, once a second."""

import asyncio
import logging
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import monotonic
from typing import TypeVar

from beamtouch_daemon.delivery.log import Chunk, Counts, Log, Sender
from beamtouch_daemon.delivery.log_file import Entry, ForeignFileError, LogFile, LogFileError, LostFileError
from beamtouch_daemon.faults import Fault
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import MAX_EARLIER, Batch

WRITE_S = 1.0
"""Time between two looks at what must be written, and between two attempts to open the file."""
MEMORY_S = 5.0
"""Samples that are not durable after this time go to the file; in fair weather they are within a second or two."""
_log = logging.getLogger(__name__)
_T = TypeVar("_T")


class SurfaceLogs:
    """The logs of one surface: that of the present boot, and those of earlier ones that still hold samples."""

    def __init__(self, name: str) -> None:
        self.counts = Counts(name)
        self.present: Log | None = None
        """That of the worker; None if the surface is not configured."""
        self.by_boot: dict[str, Log] = {}

    @property
    def in_memory(self) -> int:
        """Number of samples in memory."""
        return sum(log.in_memory for log in list(self.by_boot.values()))

    @property
    def on_disk(self) -> int:
        """Number of samples in the file."""
        return sum(log.on_disk for log in list(self.by_boot.values()))

    @property
    def refused(self) -> int:
        """Number of boots that the service refuses."""
        return sum(bool(log.refusal) for log in list(self.by_boot.values()))

    def begin(self, sender: Sender, max_samples: int) -> Log:
        """Return the log of a new boot; the one before becomes an earlier one."""
        self.end()
        self.present = self.by_boot[sender.boot_id] = Log(sender, self.counts, max_samples)
        self.present.told_s = monotonic()  # its first live batch asks
        return self.present

    def end(self) -> None:
        """Make the present boot an earlier one."""
        if self.present is not None:
            self.present.end()
            self.present = None

    def prune(self) -> None:
        """Forget earlier boots without samples."""
        for boot_id, log in list(self.by_boot.items()):
            if not len(log) and not log.forgotten and log is not self.present:
                del self.by_boot[boot_id]

    def others(self, log: Log) -> list[str]:
        """Return the boots beside that of a log that hold samples, and the present one, which may get some."""
        logs = [one for one in self.by_boot.values() if len(one) and one is not self.present]
        logs += [self.present] if self.present is not None else []
        return [one.sender.boot_id for one in logs if one is not log][-MAX_EARLIER:]


class LogStore:
    """All logs. One thread makes all calls of the file, because each may wait for the disk.

    Parameters
    ----------
    path
        The file; None: the logs are in memory only.
    max_bytes
        Limit of what the file holds.
    """

    def __init__(self, path: Path | None, max_bytes: int) -> None:
        self._file = None if path is None else LogFile(path, max_bytes)
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="log")
        self._surfaces: dict[str, SurfaceLogs] = {}
        self._fault = Fault(_log, "log file")
        self._writes = asyncio.Lock()

    def surface(self, name: str) -> SurfaceLogs:
        """Return the logs of a surface."""
        return self._surfaces.setdefault(name, SurfaceLogs(name))

    def surfaces(self) -> dict[str, SurfaceLogs]:
        """Return the logs of all surfaces, also of those that are no longer configured."""
        return dict(self._surfaces)

    async def open(self) -> None:
        """Open the file, if that is possible now; ForeignFileError if it never will be."""
        if self._file is None or self._file.is_open:
            return
        try:
            entries = await self._call(self._file.open)
            for entry in entries:
                await self._adopt(entry)
        except ForeignFileError:
            raise
        except LogFileError as error:
            self._failed(error)
        else:
            self._fault.recovered()

    async def run(self) -> None:
        """Write what has been in memory for long, until cancelled."""
        while True:
            await asyncio.sleep(WRITE_S)
            await asyncio.shield(self.write(MEMORY_S))  # a stop waits for what has begun

    async def write(self, max_age_s: float | None) -> None:
        """Write the samples that are older, and delete what is durable; None: write all of them."""
        async with self._writes:
            for surface in self._surfaces.values():
                surface.prune()
            try:
                await self.open()
            except ForeignFileError as error:
                self._failed(error)
            logs = [(name, log) for name, surface in self._surfaces.items() for log in surface.by_boot.values()]
            now_s = uptime_s()
            pieces = [(name, log, piece) for name, log in logs for piece in log.pieces(max_age_s, now_s)]
            remove = [(log, row) for _, log in logs for row in log.forgotten]
            if self._file is not None and self._file.is_open and (pieces or remove):
                add = [(name, log.sender.batch(piece)) for name, log, piece in pieces]
                change, rows = self._file.change, [row for _, row in remove]
                try:
                    added, dropped = await self._call(lambda: change(add, rows))
                except LogFileError as error:
                    self._failed(error)
                    return
                for log, row in remove:
                    log.forgotten.remove(row)
                for (_, log, piece), row in zip(pieces, added, strict=True):
                    log.adopt(Chunk(row, piece[0].sample.sequence, piece[-1].sample.sequence))
                for row in dropped:
                    self._lose(row)
                self._fault.recovered()

    async def read(self, chunk: Chunk) -> Batch:
        """Return a chunk of the file; LogFileError if it cannot be read."""
        if self._file is None:
            message = "there is no file"
            raise LogFileError(message)
        try:
            file = self._file
            return await self._call(lambda: file.read(chunk.row))
        except LogFileError as error:
            self._failed(error)
            raise

    async def close(self) -> None:
        """Close the file after the calls in progress."""
        if self._file is not None:
            await self._call(self._file.close)
        self._thread.shutdown()

    async def _call(self, work: Callable[[], _T]) -> _T:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    async def _adopt(self, entry: Entry) -> None:
        """Take over a chunk of an earlier run."""
        surface = self.surface(entry.surface)
        if entry.boot_id not in surface.by_boot:
            sender = Sender.of(await self.read(entry.chunk))
            surface.by_boot[entry.boot_id] = Log(sender, surface.counts, 0)
            surface.by_boot[entry.boot_id].end()
        surface.by_boot[entry.boot_id].adopt(entry.chunk)

    def _failed(self, error: LogFileError) -> None:
        if isinstance(error, LostFileError):
            self._lose(None)
        else:
            self._fault.failed(f"{error}; samples stay in memory, trying again")

    def _lose(self, row: int | None) -> None:
        """Drop the samples of a row that the file no longer holds; None: of all rows."""
        for log in self._logs():
            log.lose(row)

    def _logs(self) -> Iterator[Log]:
        return (log for surface in self._surfaces.values() for log in surface.by_boot.values())
