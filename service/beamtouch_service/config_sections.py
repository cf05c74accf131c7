"""What the TOML file and the command line may say: strict, every key known."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from beamtouch_service import defaults
from beamtouch_service.samples import SurfaceName

_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)

Port = Annotated[int, Field(ge=0, le=65535)]
StaleMs = Annotated[FiniteFloat, Field(gt=0, le=60_000)]
_Text = Annotated[str, Field(min_length=1)]


class ServerSection(BaseModel):
    """`[server]`: where to listen, and who may do what."""

    model_config = _STRICT

    host: _Text = "127.0.0.1"
    """Beyond loopback only together with a token file for writing and one for reading."""
    port: Port = 8420
    """0 picks a free one."""
    token_file: _Text | None = None
    """Without one every write is refused."""
    max_streams: Annotated[int, Field(ge=0, le=1000)] = defaults.MAX_STREAMS
    """Most streams open at once."""

    read_token_file: _Text | None = None
    """Without one everyone on this machine may read."""
    admin_token_file: _Text | None = None
    """Without one nobody may administrate."""
    certificate_file: _Text | None = None
    """PEM, with the chain; together with `key_file`: HTTPS instead of HTTP."""
    key_file: _Text | None = None
    max_clients: Annotated[int, Field(ge=1, le=defaults.MOST_CLIENTS)] = defaults.MAX_CLIENTS
    """Connections at a time; for one more an idle one without a token is closed, and without such a one it gets 503."""
    max_clients_per_address: Annotated[int, Field(ge=1, le=defaults.MOST_CLIENTS)] | None = None
    """The same for the connections of one address that have not borne a token; None: half of `max_clients`."""
    max_batches_per_s: Annotated[FiniteFloat, Field(ge=0.1, le=1e6)] = defaults.BATCHES_PER_S
    """For each surface; more get 429."""


class EventsSection(BaseModel):
    """`[events]`: where contacts are kept on record, and how many."""

    model_config = _STRICT

    file: _Text | None = None
    """Without one they are kept in memory, until the service stops."""
    keep_days: Annotated[FiniteFloat, Field(gt=0, le=36_500)] = defaults.KEEP_DAYS
    most_mb: Annotated[FiniteFloat, Field(ge=1, le=1e6)] = defaults.MOST_MB


class SurfaceSection(BaseModel):
    """`[surfaces.NAME]`: one surface."""

    model_config = _STRICT

    model: _Text | None = None
    """Model file; without one the surface takes samples and gives no contact."""
    stale_ms: StaleMs = defaults.STALE_MS
    """No contact is given from a sample older than this."""


class ConfigFile(BaseModel):
    """The whole file; relative paths in it are relative to it."""

    model_config = _STRICT

    server: ServerSection = ServerSection()
    events: EventsSection = EventsSection()
    surfaces: dict[SurfaceName, SurfaceSection] = Field(default_factory=dict)


class Overrides(BaseModel):
    """What the command line says; None where it says nothing."""

    model_config = _STRICT

    host: _Text | None = None
    port: Port | None = None
    token_file: _Text | None = None
    read_token_file: _Text | None = None
    admin_token_file: _Text | None = None
    certificate_file: _Text | None = None
    key_file: _Text | None = None
    model: _Text | None = None
    stale_ms: StaleMs | None = None
