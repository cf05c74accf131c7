"""The record of a service, as far as a sender sees it: a cursor per boot, and every sample once and in order."""

from dataclasses import dataclass, field

from beamtouch_service.samples import Batch, Sample

Boot = tuple[str, str]
"""Surface and boot id."""


@dataclass
class Record:
    """What outlasts a service."""

    durable: dict[Boot, int] = field(default_factory=dict)
    samples: dict[Boot, list[Sample]] = field(default_factory=dict)
    lost: dict[Boot, list[int]] = field(default_factory=dict)
    """Numbers that the sender no longer had."""
    is_away: bool = False

    def numbers(self, surface: str = "bench") -> dict[str, list[int]]:
        """Return the numbers of the samples of each boot, in the order in which they were recorded."""
        return {
            boot: [one.sequence for one in found] for (name, boot), found in self.samples.items() if name == surface
        }

    def whole(self, surface: str = "bench") -> list[Sample]:
        """Return the samples of all boots."""
        return [sample for (name, _), found in self.samples.items() if name == surface for sample in found]


@dataclass
class _Part:
    """What a service knows of a boot and has not made durable."""

    expected: int
    samples: list[Sample] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)


class Recorder:
    """A service in front of a record; a crash forgets all of it."""

    MAX_PENDING = 20_000

    def __init__(self, record: Record) -> None:
        self.record = record
        self._parts: dict[Boot, _Part] = {}

    def receive(self, surface: str, batch: Batch) -> tuple[int | None, int | None]:
        """Take a batch; return `durable` and `expected`."""
        boot = surface, batch.boot_id
        part = self._parts.get(boot)
        if part is None:
            if self.record.is_away:
                return None, None
            part = self._parts[boot] = _Part(self.record.durable.get(boot, 0) + 1)
        assert batch.oldest is not None
        if batch.oldest > part.expected:
            part.lost += range(part.expected, batch.oldest)
            part.expected = batch.oldest
        for sample in batch.samples:
            if sample.sequence == part.expected and len(part.samples) < self.MAX_PENDING:
                part.samples.append(sample)
                part.expected += 1
        return self.record.durable.get(boot, 0), part.expected

    def commit(self) -> None:
        """Make everything durable, unless the record is away."""
        for boot, part in self._parts.items() if not self.record.is_away else ():
            self.record.samples.setdefault(boot, []).extend(part.samples)
            self.record.lost.setdefault(boot, []).extend(part.lost)
            self.record.durable[boot] = part.expected - 1
            part.samples, part.lost = [], []
