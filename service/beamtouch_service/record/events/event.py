"""One contact from touch to lift, or one unexplained stretch. Pure: no clock, no I/O.

Consecutive samples that are not clear make at most two events: an unexplained stretch up to the first contact, and a
contact from there on, with all unexplained stretches that follow it.
"""

from copy import copy
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict

from beamtouch_common.outline import names_of
from beamtouch_models.runtime import State
from beamtouch_service.record.events.best import Best
from beamtouch_service.record.events.load import DECIMALS, Load, Sighting
from beamtouch_service.surfaces.follower import Decision


class EventKind(StrEnum):
    """Kinds of events."""

    CONTACT = "contact"
    """A single contact, with the unexplained stretches during it."""
    UNEXPLAINED = "unexplained"
    """A stretch that neither rest nor a single contact explains, without a contact before it."""


class Begin(StrEnum):
    """The beginning of an event."""

    TOUCH = "touch"
    """Of a contact: the sample before the first was clear."""
    CLEAR = "clear"
    """Of an unexplained stretch: the sample before the first was clear."""
    UNEXPLAINED = "unexplained"
    """Of a contact: the sample before the first was unexplained, so the touch was not seen."""
    UNSEEN = "unseen"
    """The sample before the first is not known."""


class End(StrEnum):
    """The end of an event."""

    LIFT = "lift"
    """Of a contact: the sample after the last was clear."""
    UNEXPLAINED = "unexplained"
    """Of a contact: its last samples are unexplained and a clear one follows, so the lift was somewhere in them."""
    CLEAR = "clear"
    """Of an unexplained stretch: the sample after the last was clear."""
    CONTACT = "contact"
    """Of an unexplained stretch: the sample after the last was a contact, which is an event of its own."""
    UNSEEN = "unseen"
    """The sample after the last is not known: it is lost, or its state is."""
    OPEN = "open"
    """The event continues."""


class ChannelDoubt(BaseModel):
    """One channel of an unexplained sample."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    name: str
    """Name of the channel."""
    deflection_mm: float
    """Its deflection, positive in the direction of the load."""
    misfit_without: float | None
    """Misfit of the best single contact without this channel; null where too few channels would be left."""
    explained_without: bool
    """True if rest or a single contact explains all other channels."""


class Contradiction(BaseModel):
    """A sample that neither rest nor a single contact explains."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    sequence: int
    """The sample's number."""
    sampled_at: str
    """Time of the sample by the sender's clock (RFC 3339)."""
    misfit: float | None
    """Misfit of the best single contact."""
    rest_misfit: float | None
    """Misfit of rest."""
    channels: list[ChannelDoubt]
    """Channels that took part, in the order of the model."""


@dataclass
class Event:
    """An event as it is on record. `tables.EVENTS` has a column for each field; `record.fields` makes the answers."""

    surface: str
    model: str
    boot_id: str
    first_sequence: int
    last_sequence: int
    touched_us: int
    """Time of the first sample, by the sender's clock [us since 1970]."""
    last_us: int
    """Time of the last sample."""
    kind: EventKind
    begin: Begin
    end: End = End.OPEN
    lifted_us: int | None = None
    """Time of the first clear reading after it, or clear sample after a stretch; None if it is not known."""
    samples: int = 0
    """Number of samples in the figures of the load."""
    unsteady_samples: int = 0
    """How many of them were unsteady."""
    place: dict[str, list[float | None] | None] = field(default_factory=dict)
    """Axis -> mean place of the load with the ends of its interval, the least and the largest place, and that of the
    peak force (None without forces) [mm]; None without a load."""
    mean_force_n: float | None = None
    mean_force_low_n: float | None = None
    mean_force_high_n: float | None = None
    peak_force_n: float | None = None
    """Largest force of the load; no swing of the beam."""
    peak_force_low_n: float | None = None
    peak_force_high_n: float | None = None
    unexplained_us: int = 0
    """Time from each unexplained sample to the next sample, up to the last one."""
    ends_unexplained: bool = False
    """True if the last sample is unexplained."""
    degraded: bool = False
    """At least one sample lacked channels or could not be decided."""
    unsteady: bool = False
    """True if the figures stand on unsteady samples."""
    path: list[list[float]] = field(default_factory=list)
    """The stays of the load, as `Load.path`; empty if it was read without."""
    best: dict[str, Any] | None = None
    """Its best sample, as `Best`; None if no sample was steady with all channels."""
    zones: dict[str, int] = field(default_factory=dict)
    """Zone that the contact was inside -> for how long [us]."""
    capture: list[dict[str, Any]] = field(default_factory=list)
    """Its first unexplained samples, each as a `Contradiction`."""


class Numbered(NamedTuple):
    """An event with its id."""

    number: int
    event: Event


class OpenEvent:
    """An event while its samples arrive."""

    def __init__(self, event: Event, number: int | None = None, memory: dict[str, Any] | None = None) -> None:
        """Begin with an event whose first sample has yet to be added, or go on with one on record and its memory."""
        self.event = event
        self.number = number
        """Its id; None until it is on record."""
        self.best = Best.read(event.best)
        self.load = Load.read(event.touched_us, event.path, memory, len(event.place))

    def add(self, decision: Decision, seen: Sighting | None) -> None:
        """Add the next sample, and what it sees of the load, if it counts there."""
        event, sample = self.event, decision.estimate.sample
        if event.ends_unexplained:
            event.unexplained_us += max(0, sample.acquired_unix_us - event.last_us)
        event.last_sequence, event.last_us = sample.sequence, sample.acquired_unix_us
        event.ends_unexplained = decision.held is State.UNEXPLAINED
        event.degraded |= bool(decision.estimate.bad) or decision.state is None
        for zone, longer_us in decision.zones.stays_us.items():
            event.zones[zone] = event.zones.get(zone, 0) + longer_us
        if decision.is_odd or event.ends_unexplained or seen is None:
            return
        event.samples += 1
        event.unsteady_samples += seen.is_unsteady
        self.load.add(seen)

    def finish(self, end: End, lifted_us: int | None = None) -> None:
        """End the event."""
        self.event.end, self.event.lifted_us = end, lifted_us

    def lift(self, at_us: int, begin_us: float) -> None:
        """End the event before a clear sample at this time, whose oldest reading was taken at `begin_us`."""
        if self.event.kind is EventKind.UNEXPLAINED:
            self.finish(End.CLEAR, at_us)
        elif self.event.ends_unexplained:
            self.finish(End.UNEXPLAINED, at_us)
        else:
            self.finish(End.LIFT, self.load.lift(at_us, begin_us))

    def row(self) -> dict[str, Any]:
        """Return the event so far, as it is recorded."""
        values = {name: copy(value) for name, value in vars(self.event).items()}
        best = asdict(self.best) if self.best else None
        return values | self._figures() | {"path": self.load.path, "best": best}

    def _figures(self) -> dict[str, Any]:
        """Return the figures of the load so far."""
        load = self.load.figures
        if load is None:
            return {}
        place = {
            axis: [_rounded(one) for one in (*along.mean, along.least_mm, along.most_mm, along.at_largest_mm)]
            for axis, along in zip(self.event.place, load.along, strict=True)
        }
        figures: dict[str, Any] = {"place": place, "unsteady": load.is_unsteady}
        for figure, span in (("mean_force", load.force), ("peak_force", load.largest)):
            figures |= dict(zip(names_of(figure, "n"), map(_rounded, span or ()), strict=False))
        return figures


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, DECIMALS)
