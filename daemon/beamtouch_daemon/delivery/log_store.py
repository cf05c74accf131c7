"""The logs of all surfaces, and the file behind them: what stays in memory for long is written to it, once a second."""

import asyncio
import logging
import math
from collections.abc import Callable, Set
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from beamtouch_common.log_lines import Repeated
from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.delivery.boots import Boot, SurfaceLogs
from beamtouch_daemon.delivery.log_file import Chunk, ForeignFileError, LogFile, LogFileError
from beamtouch_daemon.delivery.pace import most_in_batch
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_service.samples import Batch

WRITE_S = 1.0
"""Time between two looks at what must be written, and between two attempts to open the file."""
MEMORY_S = 5.0
"""Samples that are not durable after this time go to the file. Usually the service makes them durable a second earlier
(`LATE_S` in its `record/events/surface_record.py`)."""
_logger = logging.getLogger(__name__)
_T = TypeVar("_T")


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
        self._fault = Repeated(_logger, "log file")
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
        boots = [(name, boot) for name, surface in self._surfaces.items() for boot in surface.by_boot.values()]
        pieces = [(name, boot.log, piece) for name, boot in boots for piece in _for_disk(boot, max_age_s)]
        keep = {row for _, boot in boots for row in boot.log.rows}
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
            for boot in surface.by_boot.values():
                boot.log.keep(rows)


def _for_disk(boot: Boot, max_age_s: float | None) -> list[list[TimedSample]]:
    """Return what to write of a boot, in pieces for one chunk each. New samples are left for a live batch."""
    log, most = boot.log, most_in_batch(len(boot.log.head.channels))
    if max_age_s is None:
        return log.for_disk(-math.inf, 0.0, log.next, most)
    return log.for_disk(max_age_s, uptime_s(), boot.live.first, most)
