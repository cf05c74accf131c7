"""Sections of the TOML file, and the command line: strict, unknown keys are refused."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from beamtouch_service import limits
from beamtouch_service.samples import SurfaceName

_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)

Port = Annotated[int, Field(ge=0, le=65535)]
StaleMs = Annotated[FiniteFloat, Field(gt=0, le=60_000)]
_Text = Annotated[str, Field(min_length=1)]

RENAMED = {"token_file": "write_token_file", "most_mb": "max_mb"}
"""Keys of earlier versions, and their names now."""


class ServerSection(BaseModel):
    """`[server]`: address, tokens, certificate, and limits."""

    model_config = _STRICT

    host: _Text = "127.0.0.1"
    """Address to listen on. Addresses beyond loopback require a write token and a read token."""
    port: Port = 8420
    """0 picks a free port."""
    write_token_file: _Text | None = None
    """File with the token required for writes. Without it, every write is refused."""
    read_token_file: _Text | None = None
    """File with the token required for reads. Without it, reads need no token."""
    admin_token_file: _Text | None = None
    """File with the token required for administration. Without it, administration is disabled."""
    certificate_file: _Text | None = None
    """PEM, with its chain. With `key_file`, the service speaks HTTPS instead of HTTP."""
    key_file: _Text | None = None
    """PEM, the private key of the certificate."""
    max_clients: Annotated[int, Field(ge=1, le=limits.MAX_CLIENTS_LIMIT)] = limits.MAX_CLIENTS
    """Open connections. For one more, an idle one without a token is closed; if there is none, the new one gets 503."""
    max_clients_per_address: Annotated[int, Field(ge=1, le=limits.MAX_CLIENTS_LIMIT)] | None = None
    """The same for connections from one address that have not shown a token. Default: half of `max_clients`, or all
    of them for a replica, whose clients are all behind the balancer."""
    replica: bool = False
    """This service is one of several that share the surfaces, behind a load balancer. Needs `events.url`."""
    max_batches_per_s: Annotated[FiniteFloat, Field(ge=0.1, le=1e6)] = limits.MAX_BATCHES_PER_S
    """For each surface. Further batches get 429."""
    max_streams: Annotated[int, Field(ge=0, le=1000)] = limits.MAX_STREAMS
    """Open streams. Further ones get 503."""


class EventsSection(BaseModel):
    """`[events]`: the record of contacts."""

    model_config = _STRICT

    file: _Text | None = None
    """SQLite file. Without it and `url`, events are kept in memory until the service stops."""
    url: _Text | None = None
    """PostgreSQL database, as postgresql://USER@HOST/NAME. Several services can share it."""
    keep_days: Annotated[FiniteFloat, Field(gt=0, le=36_500)] = limits.KEEP_DAYS
    """Older events are deleted."""
    max_mb: Annotated[FiniteFloat, Field(ge=1, le=1e6)] = limits.MAX_MB
    """Size of the events. Beyond it, the oldest are deleted."""


class SurfaceSection(BaseModel):
    """`[surfaces.NAME]`: one surface."""

    model_config = _STRICT

    model: _Text | None = None
    """Model file. Without it, the surface accepts samples but gives no contact."""
    stale_ms: StaleMs = limits.STALE_MS
    """No contact is given from a sample older than this."""
    unexplained_after_s: Annotated[FiniteFloat, Field(gt=0, le=86_400)] = limits.UNEXPLAINED_AFTER_S
    """A state `unexplained` that lasts longer raises a metric and writes a line to the log."""


class ConfigFile(BaseModel):
    """The whole file. Relative paths in it are relative to its folder."""

    model_config = _STRICT

    server: ServerSection = ServerSection()
    events: EventsSection = EventsSection()
    surfaces: dict[SurfaceName, SurfaceSection] = Field(default_factory=dict)


class Overrides(BaseModel):
    """Options of the command line, as they are typed; None where an option was not given."""

    model_config = _STRICT | ConfigDict(alias_generator=lambda name: f"--{name.replace('_', '-')}")

    host: _Text | None = None
    port: Port | None = None
    write_token_file: _Text | None = None
    read_token_file: _Text | None = None
    admin_token_file: _Text | None = None
    certificate_file: _Text | None = None
    key_file: _Text | None = None
    model: _Text | None = None
    stale_ms: StaleMs | None = None
