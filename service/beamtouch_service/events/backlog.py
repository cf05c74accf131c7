"""Writes that wait while the database is away, within bounds. Pure: no clock, no I/O."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from beamtouch_service.events.captures import Capture
from beamtouch_service.events.findings import Command
from beamtouch_service.events.joining import are_one, joined
from beamtouch_service.events.segments import Segment

MAX_WEIGHT = 500_000
"""Points of paths that may wait, some 80 MB: about an hour of two contacts a second."""
_SAMPLE_WEIGHT = 8
"""Weight of a captured sample, in points of a path."""


@dataclass
class Write:
    """The commands of one transaction."""

    surface: str
    commands: list[Command]

    @property
    def weight(self) -> int:
        """Size in memory, in points of a path."""
        return sum(_weight(command) for command in self.commands)


class Backlog:
    """Writes of all surfaces, oldest first."""

    def __init__(self, max_weight: int = MAX_WEIGHT) -> None:
        self._max_weight = max_weight
        self._weight = 0
        self._writes: deque[Write] = deque()
        self._newest: dict[str, Write] = {}
        """The newest write of each surface."""

    def __len__(self) -> int:
        return len(self._writes)

    def add(self, surface: str, commands: Sequence[Command]) -> bool:
        """Add a write; return False if there is no room for it. A contact that continues takes no more room."""
        newest = self._newest.get(surface)
        if newest and (one := _continued(newest.commands[-1], commands[0])):
            merged = Write(surface, [one, *commands[1:]])
            before = _weight(newest.commands[-1])
            if self._weight + merged.weight - before > self._max_weight:
                return False
            self._weight += merged.weight - before
            newest.commands[-1:] = merged.commands
            return True
        write = Write(surface, list(commands))
        if self._weight + write.weight > self._max_weight:
            return False
        self._weight += write.weight
        self._writes.append(write)
        self._newest[surface] = write
        return True

    def take_first(self) -> Write | None:
        """Remove and return the oldest write; None if there is none."""
        if not self._writes:
            return None
        write = self._writes.popleft()
        self._weight -= write.weight
        if self._newest.get(write.surface) is write:
            del self._newest[write.surface]
        return write

    def put_back(self, write: Write) -> None:
        """Make a write the oldest again, as it was: it may have been carried out, although nobody said so."""
        self._writes.appendleft(write)
        self._weight += write.weight


def _weight(command: Command) -> int:
    if isinstance(command, Segment):
        return 1 + len(command.path)
    return 1 + _SAMPLE_WEIGHT * len(command.samples) if isinstance(command, Capture) else 1


def _continued(left: Command, right: Command) -> Segment | None:
    """Return two segments as one if they follow each other in one event."""
    if not (isinstance(left, Segment) and isinstance(right, Segment)):
        return None
    follow = (left.boot_id, left.model, left.last_sequence + 1) == (right.boot_id, right.model, right.first_sequence)
    return joined(left, right) if follow and are_one(left, right) else None
