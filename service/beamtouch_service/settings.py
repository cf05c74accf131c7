"""The settings of a service, checked."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from beamtouch_service.access import Access

WordOrder = Literal["big", "little"]
"""The half of a 32-bit value that its first register holds: `big` the high one (ABCD), `little` the low one (CDAB)."""


@dataclass(frozen=True)
class SurfaceSettings:
    """One surface."""

    name: str
    """If empty, the name of its model."""
    model: Path | None
    stale_ms: float
    unexplained_after_s: float
    degraded_after_s: float


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
class ModbusSettings:
    """The Modbus TCP server."""

    host: str
    port: int
    word_order: WordOrder
    max_clients: int
    idle_s: float


@dataclass(frozen=True)
class MqttTls:
    """Trust and identity of a connection to the broker."""

    ca: Path | None
    """None: the certificates of the system."""
    own: TlsFiles | None


@dataclass(frozen=True)
class MqttSettings:
    """The MQTT broker, and what it gets."""

    host: str
    port: int
    prefix: str
    client_id: str
    max_rate_hz: float
    username: str | None
    password: str | None = field(repr=False)
    tls: MqttTls | None
    send_recorded_events: bool
    home_assistant_discovery: bool


@dataclass(frozen=True)
class Settings:
    """All settings, checked."""

    host: str
    port: int
    access: Access
    tls: TlsFiles | None
    replica: bool
    """This service is one of several that share the surfaces."""
    surfaces: tuple[SurfaceSettings, ...]
    max_streams: int
    events: EventSettings
    modbus_server: ModbusSettings | None
    """None: there is none."""
    mqtt: MqttSettings | None
    """None: no broker."""
