"""The boots of one surface: the log of each, and how far its delivery is."""

import asyncio
import logging
import math
from collections.abc import Sequence
from contextlib import suppress
from enum import Enum
from time import monotonic

from beamtouch_common.log_lines import Repeated
from beamtouch_common.waits import Backoff
from beamtouch_daemon.delivery.live_window import ENDED, LiveWindow
from beamtouch_daemon.delivery.log import Counts, Log
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.delivery.pace import RequestPace
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_service.samples import MAX_EARLIER, Batch, Receipt

BACKLOG_RETRY_S = 5.0
"""Longest wait of the backlog after a request that brought the record no further."""
_logger = logging.getLogger(__name__)


class BacklogState(Enum):
    """States of the backlog of a boot."""

    RESTS = "rests"
    WAITS = "waits"
    """It lets a live batch go before its next request."""
    SENDS = "sends"
    """Its request is in flight, and brings samples."""


class Boot:
    """The log of one boot, and how far its delivery is.

    Parameters
    ----------
    head, counts, max_samples : those of the log
    """

    def __init__(self, head: Batch, counts: Counts, max_samples: int) -> None:
        self.log = Log(head, counts, max_samples)
        self.pace = RequestPace(len(head.channels))
        self.live = LiveWindow()
        self.fresh = asyncio.Event()
        """Set when there are new samples for a live batch."""
        self.expected: int | None = None
        """Number of the sample that the record takes next; None if that is not known."""
        self.refusal = ""
        """Reason why the service refuses this boot; empty if it does not."""
        self.last_receipt_s = -math.inf
        """Time of the last receipt, on the monotonic clock."""
        self.due_s = 0.0
        """Time of the next request of the backlog on the monotonic clock, at the earliest."""
        self.backoff = Backoff(max_s=BACKLOG_RETRY_S)
        self.backlog_state = BacklogState.RESTS
        self.live_failed = False
        """True if a live batch was not taken since the record lacked nothing. It is not repeated."""
        self.changed = asyncio.Event()
        """Set when a live batch goes out or is over, and when the backlog waits or a request of it is over."""
        self._counts = counts
        self._refused = ENDED
        """Number of a sample that was refused alone; it is dropped once all before it are durable."""

    @property
    def missing(self) -> range:
        """Numbers of the samples that the record lacks and no live batch will bring; empty while that is unknown."""
        first = ENDED if self.expected is None else max(self.expected, self.log.oldest)
        return range(first, min(self.live.first, self._refused, self.log.next))

    @property
    def is_behind(self) -> bool:
        """True if the record would not take the next live batch, as it lacks samples before it, or cannot be read."""
        return self.expected is None or bool(self.missing)

    @property
    def is_gap_small(self) -> bool:
        """True if the record lacks so little that the next live batch may begin with it."""
        missing, is_refused = self.missing, self._refused != ENDED
        if not missing or self.live_failed or is_refused or missing.start < self.log.oldest_in_memory:
            return False
        return self.log.next - missing.start <= self.pace.most

    def put(self, samples: Sequence[TimedSample]) -> None:
        """Add samples with the next numbers to the log."""
        self.log.put(samples)

    def wake_live(self) -> None:
        """Have a live batch take new samples."""
        self.fresh.set()

    async def wait_for_change(self, within_s: float) -> None:
        """Wait for a change, at most so long [s]; the caller looks what it is."""
        self.changed.clear()
        with suppress(TimeoutError):
            async with asyncio.timeout(within_s if math.isfinite(within_s) else None):
                await self.changed.wait()

    def acknowledge(self, receipt: Receipt) -> None:
        """Forget what is durable. Receipts may come late: what one says of fewer samples changes nothing in the log."""
        self.last_receipt_s = monotonic()
        self.pace.stale_s = receipt.stale_ms / 1e3
        self.refusal = ""
        self.expected = receipt.expected
        if receipt.durable is not None:
            self._counts.published += self.log.forget(receipt.durable)
            self._drop_refused()
        self.live_failed &= self.is_behind

    def refuse(self, number: int) -> None:
        """Drop a single sample, as soon as all before it are durable."""
        self._refused = number
        self._drop_refused()

    def end(self) -> None:
        """Leave all samples to the backlog, which asks first: a last live batch may have arrived without an answer."""
        self.live.close()
        self.expected = None

    def hasten(self) -> None:
        """Let the backlog go on at once: the service answers again."""
        self.due_s = 0.0
        self.backoff.reset()

    def _drop_refused(self) -> None:
        if self._refused <= self.log.oldest:
            self._counts.drop(self.log.forget(self._refused))
            self._refused = ENDED


class SurfaceLogs:
    """The boots of one surface: the present one, and earlier ones whose logs still hold samples."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.counts = Counts(name)
        self.fault = Repeated(_logger, f"{name}: publishing")
        """Failures of the delivery to the service."""
        self.slow = Repeated(_logger, name)
        """A line that carries less than is measured, or carries a backlog slowly."""
        self.by_boot: dict[str, Boot] = {}
        self.present: Boot | None = None
        """That of this start of the daemon; None if the surface is not configured."""

    @property
    def in_memory(self) -> int:
        """Number of samples in memory."""
        return sum(boot.log.in_memory for boot in list(self.by_boot.values()))

    @property
    def on_disk(self) -> int:
        """Number of samples in the file."""
        return sum(boot.log.on_disk for boot in list(self.by_boot.values()))

    @property
    def is_line_thin(self) -> bool:
        """True if requests to the service take so long that they are made small."""
        return self.present is not None and self.present.pace.is_thin

    @property
    def refused(self) -> int:
        """Number of boots that the service refuses."""
        return sum(bool(boot.refusal) for boot in list(self.by_boot.values()))

    @property
    def waiting(self) -> list[Boot]:
        """The boots with samples that the record lacks, oldest first."""
        return [boot for boot in self.by_boot.values() if not boot.log.is_empty]

    def begin(self, head: Batch, max_samples: int) -> Boot:
        """Return the present boot, whose batches begin with `head`."""
        self.present = self.by_boot[head.boot_id] = Boot(head, self.counts, max_samples)
        self.present.last_receipt_s = monotonic()  # its first live batch asks
        return self.present

    def adopt(self, chunk: Chunk, example: Batch) -> None:
        """Take over a chunk of an earlier boot; `example` is one of that boot."""
        boot = self.by_boot.get(example.boot_id)
        if boot is None:
            boot = self.by_boot[example.boot_id] = Boot(example.model_copy(update={"samples": []}), self.counts, 0)
            boot.end()
        boot.log.adopt(chunk)

    def give_up(self) -> int:
        """Drop all samples in memory; return their number."""
        return sum(boot.log.give_up() for boot in self.by_boot.values())

    def prune(self) -> None:
        """Forget earlier boots without samples."""
        self.by_boot = {
            name: boot for name, boot in self.by_boot.items() if not boot.log.is_empty or boot is self.present
        }

    def others(self, boot: Boot) -> list[str]:
        """Return the boots beside one that hold samples, and the present one, which may get some."""
        others = [
            other
            for other in self.by_boot.values()
            if other is not boot and (not other.log.is_empty or other is self.present)
        ]
        others.sort(key=lambda other: other is self.present)
        return [other.log.head.boot_id for other in others[-MAX_EARLIER:]]
