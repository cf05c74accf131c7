"""The summary of a surface: the answer of `GET /surfaces`."""

from pydantic import BaseModel

from beamtouch_models.modelfile import State
from beamtouch_service.problems import ProblemBody
from beamtouch_service.surfaces.channels_out import ChannelOut
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
    beam: str | None
    """Identity of the beam and layout that the model is of; null without one."""
    channels: list[str]
    """Channels that a batch must contain, in the order of the model; empty without one."""
    stale_ms: float
    """No contact is served from a sample older than this."""
    age_ms: float | None
    """Age of the newest sample; null before the first."""
    state: State | None
    """State, as `GET /contact` gives it; null where that is a problem."""
    problem: ProblemBody | None
    """Problem that `GET /contact` answers with; null where there is a contact."""
    notes: list[str]
    """Notes, as `GET /contact` gives them."""
    misfit: float | None
    """Misfit, as `GET /contact` gives it; null where that is a problem."""
    misfit_limit: float | None
    """Its scale: neither rest nor a single contact explains a sample with a larger one."""
    channels_out: dict[str, ChannelOut]
    """Channels that have not been good for longer than `degraded_after_s`."""
    wiring: str | None
    """Cables that seem to be swapped, or a sensor that seems to be inverted: put right, they explain several contacts
    that are unexplained as they are. Null if there is none."""
    model_error: str | None
    """Reason not to use the newest model file; null if it is used."""
    samples: SampleCounts
    health: dict[str, ChannelHealth] | None = None
    """Channel -> how it has changed; empty before the first contact. Null without a model, or if its file does not hold
    what this takes: build it again."""
