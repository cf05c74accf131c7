"""The health of the channels of a surface, as the service states it."""

from enum import StrEnum

from pydantic import BaseModel


class Part(StrEnum):
    """The properties of a channel that may change."""

    GAIN = "gain"
    """Measured deflections are wrong by a factor."""
    ZERO = "zero"
    """Measured deflections at rest are not zero."""


class ChannelHealth(BaseModel):
    """Changes of the gain and the zero of a channel since a baseline, with 95 % intervals.

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
    """True if the channel has changed for certain: one false statement in 1e6 contacts."""
    changes: list[Part]
    """The properties that have changed."""


class SurfaceHealth(BaseModel):
    """The health of all channels of a surface."""

    model: str
    channels: dict[str, ChannelHealth]
