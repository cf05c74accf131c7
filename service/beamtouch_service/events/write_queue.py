"""Writes of new segments that wait for the worker thread, within bounds."""

from collections.abc import Sequence
from functools import partial
from threading import BoundedSemaphore

from beamtouch_service.events.findings import Command
from beamtouch_service.events.health_updates import log_failure
from beamtouch_service.events.losses import Losses
from beamtouch_service.events.worker import Worker
from beamtouch_service.events.writer import MakeCommands, Writer

_MAX_WRITES = 1000
"""Writes that may wait; beyond it, they are lost."""


class WriteQueue:
    """Lets the worker thread write what the surfaces did, in order."""

    def __init__(self, worker: Worker, writer: Writer, losses: Losses) -> None:
        self._worker, self._writer, self._losses = worker, writer, losses
        self._free = BoundedSemaphore(_MAX_WRITES)

    def add(self, surface: str, make: MakeCommands) -> None:
        """Write the commands that `make` returns in the worker thread."""
        if not self._free.acquire(blocking=False):
            self._writer.incomplete.add(surface)
            self._losses.note("the disk is too slow")
            return

        def run() -> None:
            try:
                self._writer.write_new(surface, make)
            finally:
                self._free.release()

        self._worker.prompt(run).add_done_callback(partial(log_failure, surface))

    def add_all(self, surface: str, commands: Sequence[Command]) -> None:
        """Write these commands in the worker thread."""
        if commands:
            self.add(surface, lambda: commands)
