"""The load of a contact: where it lay and how hard it pressed, with 95 % intervals. Pure.

Successive samples share readings, so they are no independent witnesses, and a beam that rings swings about its load.
So a contact is cut into stays. The samples of a stay have a place and a force in common, within their intervals: one
load explains them all, and the swings are none of it. A load that moves makes a stay of each part that differs.

A load that lies still is known as well as the best sample. Where it changes and no sample is steady, none tells all of
a stay: its figures are the means of its samples over time. As these share errors, the half-width of a mean is the mean
half-width.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import prod
from typing import Any, NamedTuple

import numpy as np

from beamtouch_common.outline import Span
from beamtouch_service.surfaces.follower import Decision

MAX_STAYS = 25
"""Of more stays, the two neighbours that lasted least become one, unless its force or place is an extreme."""
RAMP = 0.2
"""The part of a contact that its ramps may last at most, at each end: stays that are weaker than the next one inwards,
as while a load is laid on or taken off."""
DECIMALS = 4

Spans = tuple[Span, ...]
"""The place along each axis [mm], and the force [N] if the model states it."""


class Sighting(NamedTuple):
    """A sample that counts in the figures of a contact."""

    at_us: int
    """Time of its newest reading [us since 1970]."""
    begin_us: float
    """Time of its oldest reading."""
    spans: Spans
    knows: float
    """Its information: the trace of the inverse of its covariance [1/mm^2]."""
    is_shown: bool
    """True if this sample alone shows a contact. One after the lift, or while the beam still swings far, does not."""
    is_unsteady: bool


def begin_us(decision: Decision, reading_us: float) -> float:
    """Return the time of the oldest reading of a sample, whose readings are that far apart."""
    sample = decision.estimate.sample
    return sample.acquired_unix_us - ((sample.readings or 1) - 1) * reading_us


def sighting_of(decision: Decision, touch: Sequence[float], reading_us: float) -> Sighting | None:
    """Return what a sample sees of the load; None if it has no figures.

    Parameters
    ----------
    touch : log odds above which a sample shows a contact, for each number of channels
    reading_us : time from one reading to the next
    """
    if decision.figures is None:
        return None
    place, force = tuple(decision.figures.place.values()), decision.figures.force
    evidence = decision.evidence
    return Sighting(
        decision.estimate.sample.acquired_unix_us,
        begin_us(decision, reading_us),
        place if force is None else (*place, force),
        float(np.square(evidence.whitening_per_mm).sum()),
        evidence.log_odds > touch[evidence.channels - 1],
        decision.is_unsteady,
    )


class Stay(NamedTuple):
    """A part of a contact in which one load explains all samples."""

    since_us: int
    """From the touch to its begin."""
    lasts_us: int
    is_unsteady: bool
    """True if its figures stand on unsteady samples."""
    spans: Spans

    @classmethod
    def read(cls, point: Sequence[float]) -> "Stay":
        """Return the stay of a point of a path."""
        since_us, lasts_us, is_unsteady, *ends = point
        spans = tuple(Span(*ends[at : at + 3]) for at in range(0, len(ends), 3))
        return cls(round(since_us), round(lasts_us), bool(is_unsteady), spans)

    @property
    def point(self) -> list[float]:
        """It as numbers: begin and length [us], 1 if it is unsteady, then middle, low and high of each span."""
        return [self.since_us, self.lasts_us, int(self.is_unsteady), *(end for span in self.spans for end in span)]

    @property
    def weight(self) -> int:
        """Return its weight: a single sample lasts no time, and the clock of a sender may be set back."""
        return max(1, self.lasts_us)

    def is_weaker(self, other: "Stay", axes: int = 1) -> bool:
        """Return whether its force is surely smaller than that of another one, on a structure with so many axes.

        Without forces, whether its place is known less than half as well: the interval of a load is the wider, the less
        it presses.
        """
        if len(self.spans) > axes:
            return self.spans[axes].high < other.spans[axes].middle
        width, others_width = (prod(span.high - span.low for span in stay.spans) for stay in (self, other))
        return width > float(2**axes) * others_width


@dataclass
class NewestStay:
    """The stay that goes on."""

    begin_us: float
    end_us: float
    common: list[tuple[float, float]]
    """The error that the intervals of its samples have in common."""
    best: Spans
    """The figures of the sample that knows most."""
    best_us: int
    knows: float
    is_shown: bool
    is_unsteady: bool
    """Of the best sample."""
    weight: float
    """How long the samples of the means lasted [us]."""
    means: Spans
    """The means of its samples over time."""

    @classmethod
    def of(cls, seen: Sighting, begin: float) -> "NewestStay":
        """Begin a stay with its first sample."""
        spans, common = seen.spans, [(span.low, span.high) for span in seen.spans]
        known = seen.at_us, seen.knows, seen.is_shown, seen.is_unsteady
        return cls(begin, seen.at_us, common, spans, *known, max(1.0, seen.at_us - begin), spans)

    @classmethod
    def read(cls, kept: dict[str, Any]) -> "NewestStay":
        """Return a stay that was kept as JSON; raises KeyError or TypeError for anything else."""
        common = [(low, high) for low, high in kept["common"]]
        best, means = (tuple(Span(*span) for span in kept[name]) for name in ("best", "means"))
        return cls(**kept | {"common": common, "best": best, "means": means})

    def explains(self, seen: Sighting) -> bool:
        """Return whether the load of this stay may be that of a sample."""
        if not (seen.is_shown and self.is_shown):
            return True
        each = zip(seen.spans, self.common, self.means, strict=True)
        # Of many samples, some have nothing in common by chance; few of these are far from the mean of all.
        return all(_meet(span, common) or span.low <= mean.middle <= span.high for span, common, mean in each)

    def add(self, seen: Sighting) -> None:
        """Add the next sample."""
        lasts_us, self.end_us = max(1.0, seen.at_us - self.end_us), seen.at_us
        if self.is_shown and not seen.is_shown:
            return
        if seen.is_shown and not self.is_shown:
            vars(self).update(vars(NewestStay.of(seen, self.begin_us)))
            return
        for number, (span, (low, high)) in enumerate(zip(seen.spans, self.common, strict=True)):
            if _meet(span, (low, high)):
                self.common[number] = max(low, span.low), min(high, span.high)
        if seen.knows >= self.knows:
            self.best, self.best_us, self.knows = seen.spans, seen.at_us, seen.knows
            self.is_unsteady = seen.is_unsteady
        self.means = _mean([self.means, seen.spans], [self.weight, lasts_us])
        self.weight += lasts_us

    def stay(self, touched_us: int, *, is_only: bool) -> Stay:
        """Return the stay so far, of a contact that began then; `is_only`: it is the only one."""
        is_best = not self.is_unsteady or (is_only and self._lay_still)
        spans = tuple(map(_within, self.best, self.common)) if is_best else self.means
        # The clock of a sender may be set back.
        since_us, lasts_us = max(0, round(self.begin_us) - touched_us), max(0, round(self.end_us - self.begin_us))
        return Stay(since_us, lasts_us, self.is_unsteady, _rounded(spans))

    @property
    def _lay_still(self) -> bool:
        """True if the means are within the intervals of the best sample.

        Those of a load that slides slowly are not, though its samples have something in common.
        """
        return all(best.low <= mean.middle <= best.high for best, mean in zip(self.best, self.means, strict=True))


def _within(span: Span, common: tuple[float, float]) -> Span:
    """Return a span with its middle as near to what all samples have in common as it allows.

    The best sample may be that of a turning point, and it may have nothing in common with the others.
    """
    nearest = min(max(span.middle, common[0]), common[1])
    return span._replace(middle=min(max(nearest, span.low), span.high))


def _rounded(spans: Spans) -> Spans:
    return tuple(Span(*(round(end, DECIMALS) for end in span)) for span in spans)


def _meet(span: Span, common: tuple[float, float]) -> bool:
    return span.low <= common[1] and common[0] <= span.high


def _mean(each: Sequence[Spans], weights: Sequence[float]) -> Spans:
    """Return the weighted means of spans, and of their ends."""
    share = np.array(weights) / sum(weights)
    return tuple(Span(*(float(share @ end) for end in zip(*spans, strict=True))) for spans in zip(*each, strict=True))


class AxisFigures(NamedTuple):
    """The place of a load along one axis."""

    mean: Span
    """Mean over its time."""
    least_mm: float
    most_mm: float
    """From where to where it was."""
    at_largest_mm: float | None
    """Place of the largest force; None if the model states no force."""


@dataclass(frozen=True)
class LoadFigures:
    """The figures of a load."""

    along: tuple["AxisFigures", ...]
    """Of each axis."""
    force: Span | None
    """Mean force; None if the model states none."""
    largest: Span | None
    """Largest force that lasted, rather than swung."""
    is_unsteady: bool
    """True if all of them stand on unsteady samples."""


class Load:
    """The load of a contact while its samples arrive."""

    def __init__(self, touched_us: int, axes: int = 1) -> None:
        """Begin with a contact that began then [us since 1970], on a structure with so many axes."""
        self._touched_us, self._axes = touched_us, axes
        self._closed: list[Stay] = []
        self._newest: NewestStay | None = None

    @classmethod
    def read(
        cls, touched_us: int, path: Sequence[Sequence[float]], memory: dict[str, Any] | None, axes: int = 1
    ) -> "Load":
        """Go on from a path on record and the memory beside it; raises KeyError or TypeError for anything else."""
        load = cls(touched_us, axes)
        load._closed = [Stay.read(point) for point in path[:-1]]
        load._newest = NewestStay.read(memory) if memory else None
        return load

    @property
    def memory(self) -> dict[str, Any] | None:
        """The state that it needs beside its path to go on, as JSON; None before the first sample."""
        return asdict(self._newest) if self._newest else None

    def add(self, seen: Sighting) -> None:
        """Add the next sample."""
        newest = self._newest
        if newest is None:
            self._newest = NewestStay.of(seen, self._touched_us)
        elif newest.explains(seen):
            newest.add(seen)
        else:
            # The load changed with the first reading of this sample, but not before the best one of the last stay.
            newest.end_us = max(newest.best_us, seen.begin_us)
            self._closed.append(newest.stay(self._touched_us, is_only=False))
            self._newest = NewestStay.of(seen, newest.end_us)
            if len(self._closed) == MAX_STAYS:
                self._join()

    def _join(self) -> None:
        """Make one of the two neighbours that lasted least, but none of those that say how hard and how far."""
        closed = self._closed
        kept = _extremes(_without_ramp(closed, RAMP * sum(stay.weight for stay in closed), self._axes), self._axes)
        pairs = [at for at in range(len(closed) - 1) if kept.isdisjoint(closed[at : at + 2])]
        first = min(pairs, key=lambda at: closed[at].weight + closed[at + 1].weight)
        one, other = closed[first : first + 2]
        means = _mean([one.spans, other.spans], [one.weight, other.weight])
        lasts_us, is_unsteady = one.lasts_us + other.lasts_us, one.is_unsteady and other.is_unsteady
        closed[first : first + 2] = [Stay(one.since_us, lasts_us, is_unsteady, _rounded(means))]

    def lift(self, at_us: int, begin: float) -> int:
        """End the load before a clear sample at this time with its oldest reading at `begin`; return when it ended."""
        newest = self._newest
        if newest is None:
            return at_us
        newest.end_us = min(float(at_us), max(float(newest.best_us), begin))
        return round(newest.end_us)

    @property
    def _stays(self) -> list[Stay]:
        newest = self._newest
        return [*self._closed, newest.stay(self._touched_us, is_only=not self._closed)] if newest else []

    @property
    def path(self) -> list[list[float]]:
        """The stays so far, each as a list of numbers."""
        return [stay.point for stay in self._stays]

    @property
    def figures(self) -> LoadFigures | None:
        """The figures so far; None before the first sample."""
        stays, axes = _without_ramps(self._stays, self._axes), self._axes
        if not stays:
            return None
        mean = _mean([stay.spans for stay in stays], [stay.weight for stay in stays])
        hardest = max((stay.spans for stay in stays), key=lambda spans: spans[-1].middle)
        has_force = len(mean) > axes
        along = []
        for axis in range(axes):
            places_mm = [stay.spans[axis].middle for stay in stays]
            at_mm = hardest[axis].middle if has_force else None
            along.append(AxisFigures(mean[axis], min(places_mm), max(places_mm), at_mm))
        force, largest = (mean[axes], hardest[axes]) if has_force else (None, None)
        return LoadFigures(tuple(along), force, largest, all(stay.is_unsteady for stay in stays))


def _extremes(stays: list[Stay], axes: int) -> set[Stay]:
    """Return the stays of the largest force, and of the first and last places along each axis."""
    forces = [stay.spans[-1].middle for stay in stays]
    at = {forces.index(max(forces))}
    for axis in range(axes):
        places_mm = [stay.spans[axis].middle for stay in stays]
        at |= {places_mm.index(min(places_mm)), places_mm.index(max(places_mm))}
    return {stays[index] for index in at}


def _without_ramps(stays: list[Stay], axes: int) -> list[Stay]:
    """Return the stays without those of the touch and of the lift."""
    most_us = RAMP * sum(stay.weight for stay in stays)
    return _without_ramp(_without_ramp(stays, most_us, axes)[::-1], most_us, axes)[::-1]


def _without_ramp(stays: list[Stay], most_us: float, axes: int) -> list[Stay]:
    """Return the stays without those at the begin that are ever stronger, as far as these last no longer."""
    while len(stays) > 1 and stays[0].is_weaker(stays[1], axes) and stays[0].weight <= most_us:
        most_us -= stays[0].weight
        stays = stays[1:]
    return stays
