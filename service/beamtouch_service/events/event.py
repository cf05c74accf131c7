"""One contact from touch to lift, or one unexplained stretch. Pure: no clock, no I/O.

Consecutive samples that are not clear make at most two events: an unexplained stretch up to the first contact, and a
contact from there on, with all unexplained stretches that follow it.
"""

from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any, NamedTuple

from beamtouch_service.events.best import Best
from beamtouch_service.surfaces.contact import Figures

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
    """The sample after the last is not known: it is lost, or its state is."""
    OPEN = "open"
    """The event continues."""


@dataclass(frozen=True)
class Event:
    """An event on record."""

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
    path: list[Point] = field(default_factory=list)
    best: dict[str, Any] | None = None
    """Its best sample, as `Best`; None if no sample was steady with all channels."""
    capture: list[dict[str, Any]] = field(default_factory=list)
    """Its first unexplained samples, each as a `Contradiction`."""


class Taken(NamedTuple):
    """What an event keeps of one sample."""

    sequence: int
    acquired_us: int
    readings: int
    figures: Figures | None
    """None if it is unexplained or undecided."""
    unexplained: bool
    degraded: bool
    unsteady: bool


class OpenEvent:
    """An event while its samples arrive."""

    def __init__(self, first: Event, number: int | None = None, means: list[list[Any]] | None = None) -> None:
        """Begin with an event whose first sample has yet to be added, or go on with one on record and its `means`."""
        self.number = number
        """Its id; None until it is on record."""
        self._values = dict(vars(first))
        self.kind = first.kind
        self.path = list(first.path)
        self.capture = list(first.capture)
        self.best = Best.of(first.best)
        self._means = [DisjointMean(*kept) for kept in means or [[first.first_sequence - 1]] * 2]
        """Of steady samples and of unsteady ones."""

    @property
    def means(self) -> list[list[Any]]:
        """What it needs beside its event on record to go on."""
        return [mean.kept() for mean in self._means]

    def add(self, sample: Taken) -> None:
        """Add the next sample."""
        values = self._values
        if values["ends_unexplained"]:
            values["unexplained_us"] += max(0, sample.acquired_us - values["last_us"])
        values["last_sequence"], values["last_us"] = sample.sequence, sample.acquired_us
        values["ends_unexplained"] = sample.unexplained
        values["degraded"] |= sample.degraded
        figures = sample.figures
        if figures is None or figures.position_mm is None:
            return
        self._means[sample.unsteady].add(sample.sequence, sample.readings, figures.position_mm)
        self.path.append((sample.acquired_us, figures.position_mm, figures.force_n))
        if len(self.path) > 2 * MAX_POINTS:
            self.path = thin(self.path)
        self._count(figures, is_unsteady=sample.unsteady)

    def _count(self, figures: Figures, *, is_unsteady: bool) -> None:
        """Count the figures of a sample. Those of unsteady samples count only where there are no others."""
        values = self._values
        if values["samples"] and values["unsteady"] != is_unsteady:
            if is_unsteady:
                return
            values |= {"samples": 0, "peak_force_n": None, "peak_position_mm": None}
        values["samples"] += 1
        values["unsteady"] = is_unsteady
        peak_n = values["peak_force_n"]
        if figures.force_n is not None and (peak_n is None or figures.force_n > peak_n):
            values["peak_force_n"], values["peak_position_mm"] = figures.force_n, figures.position_mm

    def finish(self, end: End, lifted_us: int | None = None) -> None:
        """End the event."""
        self._values |= {"end": end, "lifted_us": lifted_us}

    def lift(self, at_us: int) -> None:
        """End the event before a clear sample at this time."""
        if self.kind is EventKind.UNEXPLAINED:
            self.finish(End.CLEAR, at_us)
        else:
            self.finish(End.UNEXPLAINED if self._values["ends_unexplained"] else End.LIFT, at_us)

    def row(self) -> dict[str, Any]:
        """Return the event so far, as it is recorded."""
        mean_mm = self._means[self._values["unsteady"]].mean_mm
        return self._values | {
            "mean_position_mm": self._values["mean_position_mm"] if mean_mm is None else mean_mm,
            "path": list(self.path),
            "best": asdict(self.best) if self.best else None,
            "capture": list(self.capture),
        }


class DisjointMean:
    """Averages positions, weighted by their readings.

    Means of successive samples share readings. Of samples that share some, the one with the most readings counts; of
    equal ones the first. The next one is the first that shares none with it. Readings from before the event do not
    count.
    """

    def __init__(
        self,
        before: float,
        readings: float = 0,
        sum_mm: float = 0.0,
        newest: tuple[float, float, float] | None = None,
    ) -> None:
        """Begin after the sample with the number `before`."""
        self._before, self._readings, self._sum_mm = before, readings, sum_mm
        self._newest = newest
        """Number, readings and position of the newest sample that counts; the sums are of those before it."""

    def kept(self) -> list[Any]:
        """Return the arguments that make it anew."""
        return [self._before, self._readings, self._sum_mm, self._newest]

    def add(self, sequence: int, readings: int, position_mm: float) -> None:
        """Add the sample with this number, the mean of the `readings` up to it."""
        taken, newest = min(readings, sequence - self._before), self._newest
        if newest is not None and sequence - taken >= newest[0]:
            self._readings += newest[1]
            self._sum_mm += newest[1] * newest[2]
        elif newest is not None and taken <= newest[1]:
            return
        self._newest = sequence, taken, position_mm

    @property
    def mean_mm(self) -> float | None:
        """The mean; None without samples."""
        if self._newest is None:
            return None
        _, readings, position_mm = self._newest
        return (self._sum_mm + readings * position_mm) / (self._readings + readings)


def thin(path: list[Point]) -> list[Point]:
    """Return a path of at most `MAX_POINTS` points, evenly spread in time, with the first and the last point."""
    if len(path) <= MAX_POINTS:
        return path
    begin = path[0][0]
    width_us = max(1.0, (path[-1][0] - begin) / (MAX_POINTS - 2))
    bins = {int((point[0] - begin) / width_us): point for point in reversed(path)}
    kept = sorted([*bins.values(), path[-1]])
    return [point for index, point in enumerate(kept) if index == 0 or point != kept[index - 1]][:MAX_POINTS]
