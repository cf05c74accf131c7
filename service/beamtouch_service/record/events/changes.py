"""How far the record of a boot is, and what is to become durable of it. Pure: no database, no clock."""

from dataclasses import dataclass
from typing import Any

from beamtouch_service.record.events.best import Best
from beamtouch_service.record.events.event import End, Numbered, OpenEvent
from beamtouch_service.record.events.health import HealthHistory


@dataclass(frozen=True)
class Cursor:
    """How far the record of one boot is."""

    boot_id: str
    durable: int
    """Number of the last sample on record."""
    version: int
    """How often this was written."""
    model: str
    memory: dict[str, Any]
    event: Numbered | None
    """The open event."""


@dataclass(frozen=True)
class BootChange:
    """The additions to the record by the samples of one boot since its last change."""

    boot_id: str
    version: int
    """The version that it follows; 0 for a new boot."""
    durable: int
    model: str
    memory: dict[str, Any]
    events: list[tuple[OpenEvent, int | None, dict[str, Any]]]
    """Events that began, went on or ended: each with its id, if it is on record, and its row."""
    open_event: OpenEvent | None


@dataclass(frozen=True)
class Change:
    """The changes of one surface that are to become durable."""

    surface: str
    boots: list[BootChange]
    best: list[Best]
    """Best samples of events that ended."""
    health: HealthHistory

    @property
    def has_ended(self) -> bool:
        """True if events ended."""
        return any(row["end"] is not End.OPEN for boot in self.boots for _, _, row in boot.events)
