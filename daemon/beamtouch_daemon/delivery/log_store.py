"""The logs of all surfaces, and the file behind them: what stays in memory for long is written to it, once a second."""

import asyncio
import logging
from collections.abc import Callable, Set
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import monotonic
from typing import TypeVar

from beamtouch_common.log import Repeated
from beamtouch_daemon.delivery.log import Counts, Log
from beamtouch_daemon.delivery.log_file import Chunk, ForeignFileError, LogFile, LogFileError
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
        self.name = name
        self.counts = Counts(name)
        self.fault = Repeated(_log, f"{name}: publishing")
        """Of the delivery to the service."""
        self.by_boot: dict[str, Log] = {}
        self.present: Log | None = None
        """That of the worker; None if the surface is not configured."""

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

    def begin(self, head: Batch, max_samples: int) -> Log:
        """Return the log of the present boot, whose batches begin with `head`."""
        self.present = self.by_boot[head.boot_id] = Log(head, self.counts, max_samples)
        self.present.told_s = monotonic()  # its first live batch asks
        return self.present

    def adopt(self, chunk: Chunk, example: Batch) -> None:
        """Take over a chunk of an earlier boot; `example` is one of that boot."""
        log = self.by_boot.get(example.boot_id)
        if log is None:
            log = self.by_boot[example.boot_id] = Log(example.model_copy(update={"samples": []}), self.counts, 0)
            log.end()
        log.adopt(chunk)

    def give_up(self) -> int:
        """Drop all samples in memory; return their number."""
        return sum(log.give_up() for log in self.by_boot.values())

    def prune(self) -> None:
        """Forget earlier boots without samples."""
        self.by_boot = {boot: log for boot, log in self.by_boot.items() if not log.is_empty or log is self.present}

    def others(self, log: Log) -> list[str]:
        """Return the boots beside that of a log that hold samples, and the present one, which may get some."""
        others = [one for one in self.by_boot.values() if one is not log and (not one.is_empty or one is self.present)]
        others.sort(key=lambda one: one is self.present)
        return [one.head.boot_id for one in others[-MAX_EARLIER:]]


class LogStore:
    """All logs. One thread makes all calls of the file, because each may wait for the disk.

    Parameters
    ----------
    path : The file; None: the logs are in memory only.
    max_bytes : Limit of what the file holds.
    """

    def __init__(self, path: Path | None, max_bytes: int) -> None:
        self._file = None if path is None else LogFile(path, max_bytes)
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="log")
        self._surfaces: dict[str, SurfaceLogs] = {}
        self._fault = Repeated(_log, "log file")
        self._writes = asyncio.Lock()

    def surface(self, name: str) -> SurfaceLogs:
        """Return the logs of a surface."""
        return self._surfaces.setdefault(name, SurfaceLogs(name))

    def surfaces(self) -> dict[str, SurfaceLogs]:
        """Return the logs of all surfaces, also of those that are not configured."""
        return dict(self._surfaces)

    async def open(self) -> None:
        """Open the file, if that is possible now; ForeignFileError if it never will be."""
        if self._file is None or self._file.is_open:
            return
        try:
            entries = await self._call(LogFile.open)
        except ForeignFileError:
            raise
        except LogFileError as error:
            self._failed(error)
            return
        for surface, chunk, example in entries:
            self.surface(surface).adopt(chunk, example)
        self._fault.over()

    async def run(self) -> None:
        """Write what has been in memory for long, until cancelled."""
        while True:
            await asyncio.sleep(WRITE_S)
            await asyncio.shield(self.write(MEMORY_S))  # a stop waits for what has begun

    async def write(self, max_age_s: float | None) -> None:
        """Write the samples that are older, and delete what is durable; None: write all of them."""
        async with self._writes:
            try:
                await self.open()
                if self._file is not None and self._file.is_open:
                    await self._change(max_age_s, self._file.rows.keys())
            except LogFileError as error:
                self._failed(error)
            for surface in self._surfaces.values():
                surface.prune()

    async def _change(self, max_age_s: float | None, rows: Set[int]) -> None:
        logs = [(name, log) for name, surface in self._surfaces.items() for log in surface.by_boot.values()]
        now_s = uptime_s()
        pieces = [(name, log, piece) for name, log in logs for piece in log.for_disk(max_age_s, now_s)]
        keep = {row for _, log in logs for row in log.rows}
        if pieces or rows - keep:
            add = [(name, log.batch(piece)) for name, log, piece in pieces]
            added = await self._call(lambda file: file.change(add, keep))
            for (_, log, piece), row in zip(pieces, added, strict=True):
                log.adopt(Chunk(row, piece[0].sample.sequence, piece[-1].sample.sequence))
            self._drop_lost()
            self._fault.over()

    async def read(self, chunk: Chunk) -> Batch | None:
        """Return a chunk of the file, None if it was dropped meanwhile; LogFileError if it cannot be read."""
        try:
            return await self._call(lambda file: file.read(chunk.row))
        except LogFileError as error:
            self._failed(error)
            raise

    async def close(self) -> None:
        """Close the file after the calls in progress."""
        if self._file is not None:
            await self._call(LogFile.close)
        self._thread.shutdown()

    async def _call(self, work: Callable[[LogFile], _T]) -> _T:
        """Do something with the file in the thread."""
        if self._file is None:
            raise LogFileError("there is no log file")
        return await asyncio.get_running_loop().run_in_executor(self._thread, work, self._file)

    def _failed(self, error: LogFileError) -> None:
        self._fault.failed(f"{error}; samples stay in memory, trying again")
        self._drop_lost()

    def _drop_lost(self) -> None:
        """Drop the samples in rows that the file no longer holds."""
        rows = set(self._file.rows) if self._file is not None else set[int]()
        for surface in self._surfaces.values():
            for log in surface.by_boot.values():
                log.keep(rows)
