"""The settings of a service, checked."""

from dataclasses import dataclass, field
from pathlib import Path

from beamtouch_service.access import Access


@dataclass(frozen=True)
class SurfaceSettings:
    """One surface."""

    name: str
    """Empty: the name of its model."""
    model: Path | None
    stale_ms: float
    unexplained_after_s: float


@dataclass(frozen=True)
class EventSettings:
    """The record of contacts."""

    file: Path | None
    """None: in the database, or in memory."""
    keep_days: float
    max_mb: float
    url: str | None = field(default=None, repr=False)
    """PostgreSQL database; it may hold a password."""


@dataclass(frozen=True)
class TlsFiles:
    """Certificate and its key."""

    certificate: Path
    key: Path


@dataclass(frozen=True)
class Settings:
    """All settings, checked."""

    host: str
    port: int
    access: Access
    tls: TlsFiles | None
    max_clients: int
    max_clients_per_address: int
    replica: bool
    """This service is one of several that share the surfaces."""
    max_batches_per_s: float
    surfaces: tuple[SurfaceSettings, ...]
    max_streams: int
    events: EventSettings
