"""The channels of one surface: out for a stated time (the note `degraded`), or changed since a baseline. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from pydantic import BaseModel

from beamtouch_common.units import MM
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.contact import rfc3339


class Part(StrEnum):
    """The properties of a channel that may change."""

    GAIN = "gain"
    """Measured deflections are wrong by a factor."""
    ZERO = "zero"
    """Measured deflections at rest are not zero."""


class ChannelOut(BaseModel):
    """A channel that is out."""

    quality: Quality
    """Its quality when it was last not good."""
    since: str
    """Time of the first sample in which it was not good, by the sender's clock (RFC 3339)."""


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
    unit: str = MM
    """Unit of the deflection, and of these three."""
    since: str
    """Time of the change, or else of the first contact of the baseline (RFC 3339)."""
    contacts: int
    """Number of contacts since then."""
    changed: bool
    """True if the channel has changed for certain: one false statement in 1e6 contacts."""
    changes: list[Part]
    """The properties that have changed."""


class SurfaceHealth(NamedTuple):
    """The health of all channels of a surface under a model."""

    model: str
    channels: dict[str, ChannelHealth]


class ChannelTransition(NamedTuple):
    """A channel that went out, or is back."""

    channel: str
    out: ChannelOut
    is_back: bool


@dataclass(slots=True)
class _Spell:
    """A channel that has not been good of late."""

    since_us: int
    quality: Quality
    bad_s: float = 0.0
    """Time in which it was not good, less the time in which it was."""
    is_out: bool = False

    def describe(self) -> ChannelOut:
        return ChannelOut(quality=self.quality, since=rfc3339(self.since_us))


class ChannelsOut:
    """Follows the samples that move the answer.

    A channel is out once the time in which it was not good exceeds that in which it was by `after_s`, and back once it
    has made up for that. So a loose cable is noticed if it is off for more than half of the time, and a channel that
    comes and goes is not told each time.
    """

    def __init__(self, after_s: float) -> None:
        self.after_s = after_s
        self._spells: dict[str, _Spell] = {}
        self._transitions: list[ChannelTransition] = []

    @property
    def now(self) -> dict[str, ChannelOut]:
        """The channels that are out, by name."""
        return {name: spell.describe() for name, spell in self._spells.items() if spell.is_out}

    @property
    def any(self) -> bool:
        """True if a channel is out."""
        return any(spell.is_out for spell in self._spells.values())

    def add(self, unix_us: int, bad: Mapping[str, Quality], passed_s: float) -> None:
        """Add the next sample.

        Parameters
        ----------
        unix_us : its time by the sender's clock [us since 1970]
        bad : the channels that are not good in it
        passed_s : time since the sample before [s]
        """
        for name, quality in bad.items():
            self._worsen(name, quality, unix_us, passed_s)
        for name in self._spells.keys() - bad.keys():
            self._mend(name, passed_s)

    def take_transitions(self) -> list[ChannelTransition]:
        """Return the channels that went out or came back since the last call."""
        transitions, self._transitions = self._transitions, []
        return transitions

    def forget(self) -> None:
        """Start over, as with another model, which may have other channels."""
        self._spells.clear()

    def _worsen(self, name: str, quality: Quality, unix_us: int, passed_s: float) -> None:
        spell = self._spells.get(name)
        if spell is None:
            self._spells[name] = _Spell(unix_us, quality)
            return
        spell.quality, spell.bad_s = quality, min(self.after_s, spell.bad_s + passed_s)
        if spell.bad_s >= self.after_s and not spell.is_out:
            spell.is_out = True
            self._transitions.append(ChannelTransition(name, spell.describe(), is_back=False))

    def _mend(self, name: str, passed_s: float) -> None:
        spell = self._spells[name]
        spell.bad_s -= passed_s
        if spell.bad_s <= 0.0:
            del self._spells[name]
            if spell.is_out:
                self._transitions.append(ChannelTransition(name, spell.describe(), is_back=True))
