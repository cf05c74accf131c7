"""Segments of contacts and of unexplained stretches, and how two of them are joined. Pure: no clock, no I/O.

A segment is a run of consecutive samples of one event. Segments of an event arrive in any order; two that meet become
one. Nothing is assumed about missing samples: an event next to a gap has an unseen beginning or end.

Consecutive samples that are not clear make at most two events: an unexplained stretch up to the first contact, and a
contact from there on, with all unexplained stretches that follow it.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

from beamtouch_service.events.best_samples import Best

MAX_POINTS = 200
"""Points of a path; a longer path is thinned to points evenly spread in time."""

Point = tuple[int, float, float | None]
"""Time [us since 1970], position [mm], force [N]."""


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
    """The sample after the last is not known."""
    OPEN = "open"
    """The event continues."""
    STALE = "stale"
    """No sample followed within the surface's limit."""
    UNFINISHED = "unfinished"
    """The service stopped during the event."""


AFTER_CLEAR = (Begin.TOUCH, Begin.CLEAR)
"""Nothing before such an event belongs to it."""
BEFORE_CLEAR = (End.LIFT, End.UNEXPLAINED, End.CLEAR)
"""Nothing after such an event belongs to it."""


@dataclass(frozen=True)
class Segment:
    """A part of an event, or all of it."""

    surface: str
    model: str
    boot_id: str
    first_sequence: int
    last_sequence: int
    touched_us: int
    """Time of the first sample, by the sender's clock [us since 1970]."""
    last_us: int
    """Time of the last sample."""
    lifted_us: int | None = None
    """Time of the first clear sample after it; None if that is not known."""
    kind: EventKind = EventKind.CONTACT
    begin: Begin = Begin.UNSEEN
    end: End = End.OPEN
    samples: int = 0
    """Number of samples that the position and the peak are of."""
    position_sum_mm: float = 0.0
    """Number of samples times the mean position, over samples that share no readings."""
    peak_force_n: float | None = None
    peak_position_mm: float | None = None
    """Position at the peak force."""
    unexplained_us: int = 0
    """Time from each unexplained sample to the next sample, up to the last one."""
    ends_unexplained: bool = False
    """Whether the last sample is unexplained."""
    degraded: bool = False
    """At least one sample lacked channels or could not be decided."""
    path: list[Point] = field(default_factory=list)
    unsteady: bool = False
    """Samples, position and peak are those of unsteady samples, as there are no others."""
    best: Best | None = None
    """None if no sample was steady with all channels."""


class Sums(NamedTuple):
    """The figures of some samples of a contact, as fields of a `Segment`."""

    samples: int = 0
    position_sum_mm: float = 0.0
    peak_force_n: float | None = None
    peak_position_mm: float | None = None
    unsteady: bool = False

    def plus(self, other: "Sums") -> "Sums":
        """Return the figures of both. Those of unsteady samples count only where there are no others."""
        if not (self.samples and other.samples) or self.unsteady != other.unsteady:
            return other if (other.samples > 0, not other.unsteady) > (self.samples > 0, not self.unsteady) else self
        higher = other if (other.peak_force_n or 0.0) > (self.peak_force_n or 0.0) else self
        return Sums(
            self.samples + other.samples,
            self.position_sum_mm + other.position_sum_mm,
            higher.peak_force_n,
            higher.peak_position_mm,
            self.unsteady,
        )


def sums_of(segment: Segment) -> Sums:
    """Return the figures of a segment."""
    return Sums(*(getattr(segment, name) for name in Sums._fields))


def thin(path: list[Point]) -> list[Point]:
    """Return a path of at most `MAX_POINTS` points, evenly spread in time, with the first and the last point."""
    if len(path) <= MAX_POINTS:
        return path
    begin = path[0][0]
    width_us = max(1.0, (path[-1][0] - begin) / (MAX_POINTS - 2))
    bins = {int((point[0] - begin) / width_us): point for point in reversed(path)}
    kept = sorted([*bins.values(), path[-1]])
    return [point for index, point in enumerate(kept) if index == 0 or point != kept[index - 1]][:MAX_POINTS]
