"""The summary of a surface: the answer of `GET /surfaces`."""

from pydantic import BaseModel

from beamtouch_models.modelfile import State
from beamtouch_service.surfaces.health import ChannelHealth


class SampleCounts(BaseModel):
    """Counts of samples since the service started."""

    accepted: int = 0
    repeated: int = 0
    """Received before; they changed nothing."""
    lost: int = 0
    """Gaps in the sequence numbers."""


class SurfaceSummary(BaseModel):
    """Channels, model, state, ages and counts of one surface."""

    name: str
    model: str | None
    """Name and fingerprint of the model; null without one."""
    channels: list[str]
    """Channels that a batch must contain, in the order of the model; empty without one."""
    stale_ms: float
    """No contact is served from a sample older than this."""
    age_ms: float | None
    """Age of the newest sample; null before the first."""
    state: State | None
    """State, as `GET /contact` gives it; null where that is a problem."""
    notes: list[str]
    """Notes, as `GET /contact` gives them."""
    model_error: str | None
    """Reason not to use the newest model file; null if it is used."""
    samples: SampleCounts
    health: dict[str, ChannelHealth] | None = None
    """Channel -> how it has changed; empty before the first contact. Null without a model, or if its file does not hold
    what this takes: build it again."""
