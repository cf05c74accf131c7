"""The spool's ledger: counts of waiting, delivered, dropped and set-aside samples. In memory only."""

from collections import Counter
from collections.abc import Iterable

from beamtouch_daemon.delivery.spool_entries import Entry


class Ledger:
    """Counts of samples by surface, and the numbers of batches in the file that no longer wait."""

    def __init__(self) -> None:
        self.waiting: Counter[str] = Counter()
        """Samples that wait for delivery, by surface."""
        self.dropped: Counter[str] = Counter()
        """Samples that were dropped for lack of room or lost with a deleted file, by surface."""
        self.set_aside: Counter[str] = Counter()
        """Samples that cannot be delivered and are kept for inspection, by surface."""
        self.done: set[int] = set()
        """Numbers of delivered batches that are not deleted from the file yet."""
        self.skipped: set[int] = set()
        """Numbers of batches that are set aside, perhaps not yet in the file."""
        self.bytes = 0
        """Length of all batches in the file."""
        self.next = 1
        """Number of the next batch."""

    @property
    def over(self) -> set[int]:
        """Numbers of batches in the file that no longer wait."""
        return self.done | self.skipped

    def added(self, surface: str, samples: int, length: int) -> int:
        """Note a batch that was written; return its number."""
        self.waiting[surface] += samples
        self.bytes += length
        self.next += 1
        return self.next - 1

    def gave_way(self, deleted: Iterable[Entry]) -> None:
        """Note batches that were deleted for lack of room."""
        for number, name, samples, length, waits in deleted:
            self.bytes -= length
            if waits and number not in self.over:
                self.waiting[name.decode()] -= samples
                self.dropped[name.decode()] += samples

    def delivered(self, surface: str, number: int, samples: int) -> None:
        """Note a batch that was delivered."""
        self.done.add(number)
        self.waiting[surface] -= samples

    def swept(self, numbers: Iterable[int], freed: int) -> None:
        """Note delivered batches that were deleted, with their length."""
        self.bytes -= freed
        self.done.difference_update(numbers)

    def was_set_aside(self, surface: str, samples: int) -> None:
        """Note a batch that was set aside."""
        self.waiting[surface] -= samples
        self.set_aside[surface] += samples

    def lose_all(self) -> None:
        """Count all waiting samples as dropped."""
        self.dropped.update(self.waiting)
        self.waiting.clear()
        self.done.clear()
        self.skipped.clear()

    def take_stock(self, size: int, last: int, waiting: Counter[str], lost: Counter[str]) -> None:
        """Note the content of an opened file: its bytes, its highest number, its waiting samples, and its losses."""
        before = Counter(self.waiting)
        self.bytes = size
        self.next = max(self.next, last + 1)
        self.waiting.clear()
        self.waiting.update(waiting)
        for surface in before | lost:
            self.set_aside[surface] += max(lost[surface], before[surface] - self.waiting[surface])
