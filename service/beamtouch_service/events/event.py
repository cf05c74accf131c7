"""One contact from touch to lift, or one unexplained stretch. Pure: no clock, no I/O.

Consecutive samples that are not clear make at most two events: an unexplained stretch up to the first contact, and a
contact from there on, with all unexplained stretches that follow it.
"""

from copy import copy
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from pydantic import BaseModel

from beamtouch_models.modelfile import State
from beamtouch_service.events.best import Best, DisjointMean
from beamtouch_service.events.path import Path
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

    name: str
    deflection_mm: float
    """Positive in the direction of the load."""
    misfit_without: float | None
    """Misfit of the best single contact without this channel; null where too few channels would be left."""
    explained_without: bool
    """Whether rest or a single contact explains all other channels."""


class Contradiction(BaseModel):
    """A sample that neither rest nor a single contact explains."""

    sequence: int
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
    """An event as it is on record. `tables.EVENTS` has a column for each field; `api.events` makes the answers."""

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
    """Time of the first clear sample after it; None if that is not known."""
    samples: int = 0
    """Number of samples that the position and the peak are of."""
    mean_position_mm: float | None = None
    """Mean over samples that share no readings."""
    peak_force_n: float | None = None
    peak_position_mm: float | None = None
    """Position at the peak force."""
    unexplained_us: int = 0
    """Time from each unexplained sample to the next sample, up to the last one."""
    ends_unexplained: bool = False
    """Whether the last sample is unexplained."""
    degraded: bool = False
    """At least one sample lacked channels or could not be decided."""
    unsteady: bool = False
    """Samples, position and peak are those of unsteady samples, as there are no others."""
    path: str = "[]"
    """JSON of the path; empty while the event goes on, and if it was read without."""
    path_part_ms: int = 1
    """Of each part of the event that is this long [ms], the path has one point."""
    best: dict[str, Any] | None = None
    """Its best sample, as `Best`; None if no sample was steady with all channels."""
    zones: dict[str, int] = field(default_factory=dict)
    """Zone that the contact was inside -> for how long [us]."""
    capture: list[dict[str, Any]] = field(default_factory=list)
    """Its first unexplained samples, each as a `Contradiction`."""


class OpenEvent:
    """An event while its samples arrive."""

    def __init__(self, event: Event, number: int | None = None, means: list[Any] | None = None) -> None:
        """Begin with an event whose first sample has yet to be added, or go on with one on record and its `means`."""
        self.event = event
        self.number = number
        """Its id; None until it is on record."""
        self.best = Best.read(event.best)
        self._path = Path.read(event.touched_us, event.path, event.path_part_ms)
        self._means = [DisjointMean.read(kept) for kept in means or [None, None]]
        """Positions of steady samples, and of unsteady ones."""

    @property
    def means(self) -> list[Any]:
        """What it needs beside its event on record to go on, as JSON."""
        return [mean.to_json() for mean in self._means]

    def add(self, decision: Decision, reading_us: float) -> None:
        """Add the next sample, whose readings are that far apart."""
        event, sample = self.event, decision.estimate.sample
        if event.ends_unexplained:
            event.unexplained_us += max(0, sample.acquired_unix_us - event.last_us)
        event.last_sequence, event.last_us = sample.sequence, sample.acquired_unix_us
        event.ends_unexplained = decision.held is State.UNEXPLAINED
        event.degraded |= bool(decision.estimate.bad) or decision.state is None
        for zone, longer_us in decision.zones.stays_us.items():
            event.zones[zone] = event.zones.get(zone, 0) + longer_us
        position_mm, force_n = decision.figures.position_mm, decision.figures.force_n
        if decision.is_odd or event.ends_unexplained or position_mm is None:
            return
        self._path.add(sample.acquired_unix_us, position_mm, force_n)
        self._count(decision, position_mm)
        # Readings from before the event do not count.
        most = 1 + round((sample.acquired_unix_us - event.touched_us) / reading_us)
        mean = self._means[decision.is_unsteady]
        mean.add(sample.acquired_unix_us, min(sample.readings or 1, max(1, most)), reading_us, [position_mm], [0.0])
        if event.unsteady == decision.is_unsteady and (whole := mean.of_all()):
            event.mean_position_mm = whole.mm[0]

    def _count(self, decision: Decision, position_mm: float) -> None:
        """Count the figures of a sample. Those of unsteady samples count only where there are no others."""
        event, force_n = self.event, decision.figures.force_n
        if event.samples and event.unsteady != decision.is_unsteady:
            if decision.is_unsteady:
                return
            event.samples, event.peak_force_n, event.peak_position_mm = 0, None, None
        event.samples += 1
        event.unsteady = decision.is_unsteady
        if force_n is not None and (event.peak_force_n is None or force_n > event.peak_force_n):
            event.peak_force_n, event.peak_position_mm = force_n, position_mm

    def finish(self, end: End, lifted_us: int | None = None) -> None:
        """End the event."""
        self.event.end, self.event.lifted_us = end, lifted_us

    def lift(self, at_us: int) -> None:
        """End the event before a clear sample at this time."""
        if self.event.kind is EventKind.UNEXPLAINED:
            self.finish(End.CLEAR, at_us)
        else:
            self.finish(End.UNEXPLAINED if self.event.ends_unexplained else End.LIFT, at_us)

    def row(self) -> dict[str, Any]:
        """Return the event so far, as it is recorded; its path as points."""
        values = {name: copy(value) for name, value in vars(self.event).items()}
        path = {"path": self._path.points, "path_part_ms": self._path.part_ms}
        return values | path | {"best": asdict(self.best) if self.best else None}
