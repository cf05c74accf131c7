"""The health of the channels of a surface, as the service states it."""

from enum import StrEnum

from pydantic import BaseModel


class Part(StrEnum):
    """What can change about a channel."""

    GAIN = "gain"
    """What it measures is proportional to what it should measure, but not equal."""
    ZERO = "zero"
    """It measures a deflection at rest."""


class ChannelHealth(BaseModel):
    """How the gain and the zero of a channel have changed since a baseline, with 95 % intervals.

    Contacts show how the gains differ from each other. A change that is common to all gains looks like force and is not
    seen. A change that looks like another place of the contact is hardly seen: it makes the intervals of outer channels
    wide.
    """

    gain_percent: float
    """Change of the gain, relative to the other channels."""
    gain_low_percent: float
    gain_high_percent: float
    zero_mm: float | None
    """Change of the deflection at rest, as the sender states it: without what its zero tracking removed. Null if no
    contact began after a rest that was seen."""
    zero_low_mm: float | None
    zero_high_mm: float | None
    since: str
    """Time of the change, or else of the first contact of the baseline (RFC 3339)."""
    contacts: int
    """Number of contacts since then."""
    changed: bool
    """Whether the channel has changed for certain: one false statement in 1e6 contacts."""
    changes: list[Part]
    """What has changed."""


class SurfaceHealth(BaseModel):
    """The health of all channels of a surface."""

    model: str
    channels: dict[str, ChannelHealth]
