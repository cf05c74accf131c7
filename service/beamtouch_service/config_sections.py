"""Sections of the TOML file, and the command line: strict, unknown keys are refused."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from beamtouch_common.files import file_path
from beamtouch_common.hosts import host_name
from beamtouch_service import limits
from beamtouch_service.samples import SurfaceName
from beamtouch_service.settings import WordOrder

_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)

Port = Annotated[int, Field(ge=0, le=65535)]
StaleMs = Annotated[FiniteFloat, Field(gt=0, le=60_000)]
_Text = Annotated[str, Field(min_length=1)]
_Host = Annotated[_Text, AfterValidator(host_name)]
_File = Annotated[_Text, AfterValidator(file_path)]


class ServerSection(BaseModel):
    """`[server]`: address, tokens, certificate, and limits."""

    model_config = _STRICT

    host: _Host = "127.0.0.1"
    """Address to listen on. Addresses beyond loopback require a write token and a read token."""
    port: Port = 8420
    """0 picks a free port."""
    write_token_file: _File | None = None
    """File with the token required for writes. Without it, every write is refused."""
    read_token_file: _File | None = None
    """File with the token required for reads. Without it, reads need no token."""
    certificate_file: _File | None = None
    """PEM, with its chain. With `key_file`, the service speaks HTTPS instead of HTTP."""
    key_file: _File | None = None
    """PEM, the private key of the certificate."""
    replica: bool = False
    """This service is one of several that share the surfaces, behind a load balancer. Needs `events.url`."""
    max_streams: Annotated[int, Field(ge=0, le=1000)] = limits.MAX_STREAMS
    """Open streams. Further ones get 503."""


class EventsSection(BaseModel):
    """`[events]`: the record of contacts."""

    model_config = _STRICT

    file: _File | None = None
    """SQLite file. Without it and `url`, events are kept in memory until the service stops."""
    url: _Text | None = None
    """PostgreSQL database, as postgresql://USER@HOST/NAME. Several services can share it."""
    keep_days: Annotated[FiniteFloat, Field(gt=0, le=36_500)] = limits.KEEP_DAYS
    """Age at which events are deleted."""
    max_mb: Annotated[FiniteFloat, Field(ge=1, le=1e6)] = limits.MAX_MB
    """Size of the record. Beyond it, the oldest events are deleted."""


class ModbusServerSection(BaseModel):
    """`[modbus_server]`: contacts as Modbus input registers. Without this section, there is no Modbus server."""

    model_config = _STRICT

    host: _Host = "127.0.0.1"
    """Address to listen on. Modbus knows no tokens: everyone who reaches it can read the contacts."""
    port: Port = 502
    """0 picks a free port. Ports below 1024 require a privilege."""
    word_order: WordOrder = "big"
    """Order of the two registers of a 32-bit value: `big` (ABCD) or `little` (CDAB)."""
    max_clients: Annotated[int, Field(ge=1, le=limits.MAX_CLIENTS_LIMIT)] = limits.MAX_MODBUS_CLIENTS
    """Open connections. For one more, an idle one is closed; docs/reference/registers.md says which."""
    idle_s: Annotated[FiniteFloat, Field(ge=0.1, le=86_400)] = limits.MODBUS_IDLE_S
    """A connection without a request for this long is closed."""


class MqttSection(BaseModel):
    """`[mqtt]`: contacts and events to an MQTT 5 broker. Without this section, the service knows no broker."""

    model_config = _STRICT

    host: _Host
    """Name or address of the broker."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """Default: 1883, with TLS 8883."""
    prefix: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+(/[A-Za-z0-9_.-]+)*$", max_length=200)] = "beamtouch"
    """Every topic begins with it. Each service at a broker needs a prefix of its own."""
    client_id: Annotated[str, Field(pattern=r"^[ -~]{1,200}$")] | None = None
    """Identifier at the broker. Default: the prefix."""
    max_rate_hz: Annotated[FiniteFloat, Field(ge=1, le=200)] = limits.MQTT_RATE_HZ
    """Contacts per second and surface while the state does not change."""
    username: _Text | None = None
    """User at the broker. Default: no user."""
    password_file: _File | None = None
    """File with the password of `username`."""
    tls: bool = False
    """Encrypt the connection and check the broker's certificate."""
    ca_file: _File | None = None
    """PEM, the certificates that are trusted. Default: those of the system."""
    certificate_file: _File | None = None
    """PEM, the certificate of this client, for brokers that ask for one."""
    key_file: _File | None = None
    """PEM, the private key of the certificate."""
    send_recorded_events: bool = False
    """Also send a new broker the events that were recorded before."""
    home_assistant_discovery: bool = False
    """Describe each surface to Home Assistant."""


class SurfaceSection(BaseModel):
    """`[surfaces.NAME]`: one surface."""

    model_config = _STRICT

    model: _File | None = None
    """Model file. Without it, the surface accepts samples but gives no contact."""
    stale_ms: StaleMs = limits.STALE_MS
    """No contact is given from a sample older than this."""
    unexplained_after_s: Annotated[FiniteFloat, Field(gt=0, le=86_400)] = limits.UNEXPLAINED_AFTER_S
    """A state `unexplained` that lasts longer raises a metric and writes a line to the log."""
    degraded_after_s: Annotated[FiniteFloat, Field(gt=0, le=86_400)] = limits.DEGRADED_AFTER_S
    """A channel that is missing, stuck, saturated or out of range for longer is out: the contact gets the note
    `degraded`, and log, metrics, MQTT status and `/health/ready?health=true` say so."""


class ConfigFile(BaseModel):
    """The whole file. Relative paths in it are relative to its folder."""

    model_config = _STRICT

    server: ServerSection = ServerSection()
    """Address, tokens, certificate, and limits."""
    events: EventsSection = EventsSection()
    """The record of contacts."""
    modbus_server: ModbusServerSection | None = None
    """Contacts as Modbus input registers. Default: no Modbus server."""
    mqtt: MqttSection | None = None
    """Contacts and events to an MQTT 5 broker. Default: no broker."""
    surfaces: dict[SurfaceName, SurfaceSection] = Field(default_factory=dict)
    """In their order in the file, which is that of their blocks of Modbus registers."""


class Overrides(BaseModel):
    """Options of the command line, as they are typed; None where an option was not given."""

    model_config = _STRICT | ConfigDict(alias_generator=lambda name: f"--{name.replace('_', '-')}")

    host: _Host | None = None
    port: Port | None = None
    write_token_file: _File | None = None
    read_token_file: _File | None = None
    certificate_file: _File | None = None
    key_file: _File | None = None
    model: _File | None = None
    stale_ms: StaleMs | None = None
