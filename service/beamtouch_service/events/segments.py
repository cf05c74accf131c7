"""Contact segments, and how two of them are joined. Pure: no clock, no I/O.

A segment is a run of consecutive samples of one contact. Segments of a contact arrive in any order; two that meet
become one. Nothing is assumed about missing samples: a contact next to a gap has an unseen touch or lift.
"""

from dataclasses import dataclass, field, replace
from enum import StrEnum

from beamtouch_service.surfaces.contact import Figures

MAX_POINTS = 200
"""Points of a path; a longer path is thinned to points evenly spread in time."""

Point = tuple[int, float, float | None]
"""Time [us since 1970], position [mm], force [N]."""


class Begin(StrEnum):
    """The beginning of a contact."""

    TOUCH = "touch"
    """The sample before the first was clear."""
    UNSEEN = "unseen"
    """The sample before the first is not known."""


class End(StrEnum):
    """The end of a contact."""

    LIFT = "lift"
    """The sample after the last was clear."""
    UNSEEN = "unseen"
    """The sample after the last is not known."""
    OPEN = "open"
    """The contact continues."""
    STALE = "stale"
    """No sample followed within the surface's limit."""
    UNFINISHED = "unfinished"
    """The service stopped during the contact."""


@dataclass(frozen=True)
class Segment:
    """A part of a contact, or all of it."""

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
    """Time of the first clear sample after it; None if the lift was not seen."""
    begin: Begin = Begin.UNSEEN
    end: End = End.OPEN
    samples: int = 0
    """Number of samples with a position."""
    position_sum_mm: float = 0.0
    peak_force_n: float | None = None
    peak_position_mm: float | None = None
    """Position at the peak force."""
    degraded: bool = False
    """At least one sample lacked channels or could not be decided."""
    path: list[Point] = field(default_factory=list)


class GrowingSegment:
    """A segment that is extended sample by sample, in place: `Segment` is too slow for a thousand samples a second."""

    def __init__(self, first: Segment) -> None:
        """Begin with a segment whose first sample has yet to be added."""
        self._first = first
        self._last = first.first_sequence, first.touched_us
        self._samples = 0
        self._position_sum_mm = 0.0
        self._peak: tuple[float | None, float | None] = None, None
        """Force [N] and its position [mm]."""
        self._degraded = False
        self._path: list[Point] = []

    @property
    def duration_us(self) -> int:
        """Time from the first sample to the last, by the sender's clock [us]."""
        return abs(self._last[1] - self._first.touched_us)

    def add(self, sequence: int, acquired_us: int, figures: Figures | None, *, degraded: bool) -> None:
        """Add the next sample; `figures` is None if it could not be decided."""
        self._last = sequence, acquired_us
        self._degraded |= degraded
        if figures is None or figures.position_mm is None:
            return
        position_mm, force_n = figures.position_mm, figures.force_n
        self._samples += 1
        self._position_sum_mm += position_mm
        if force_n is not None and (self._peak[0] is None or force_n > self._peak[0]):
            self._peak = force_n, position_mm
        self._path.append((acquired_us, position_mm, force_n))
        if len(self._path) > 2 * MAX_POINTS:
            self._path = thin(self._path)

    def segment(self) -> Segment:
        """Return the segment of all samples so far."""
        return replace(
            self._first,
            last_sequence=self._last[0],
            last_us=self._last[1],
            samples=self._samples,
            position_sum_mm=self._position_sum_mm,
            peak_force_n=self._peak[0],
            peak_position_mm=self._peak[1],
            degraded=self._degraded,
            path=list(self._path),
        )


def _without_first(segment: Segment, last_known: int) -> Segment:
    """Return a segment whose sums leave out the samples up to number `last_known`, in proportion."""
    known = last_known - segment.first_sequence + 1
    if known <= 0 or not segment.samples:
        return segment
    length = segment.last_sequence - segment.first_sequence + 1
    samples = round(segment.samples * max(0.0, 1 - known / length))
    return replace(segment, samples=samples, position_sum_mm=segment.position_sum_mm / segment.samples * samples)


def joined(left: Segment, right: Segment) -> Segment:
    """Return two segments that meet or overlap as one; `left` is the one that began earlier."""
    later = left if left.last_sequence > right.last_sequence else right
    added = _without_first(right, left.last_sequence)
    peaks = [(one.peak_force_n, one.peak_position_mm) for one in (left, added) if one.peak_force_n is not None]
    peak_force_n, peak_position_mm = max(peaks, key=lambda peak: peak[0] or 0.0, default=(None, None))
    return replace(
        left,
        last_sequence=later.last_sequence,
        last_us=later.last_us,
        lifted_us=later.lifted_us,
        end=later.end,
        samples=left.samples + added.samples,
        position_sum_mm=left.position_sum_mm + added.position_sum_mm,
        peak_force_n=peak_force_n,
        peak_position_mm=peak_position_mm,
        degraded=left.degraded or right.degraded,
        path=thin(sorted({point[0]: point for point in [*left.path, *right.path]}.values())),
    )


def thin(path: list[Point]) -> list[Point]:
    """Return a path of at most `MAX_POINTS` points, evenly spread in time, with the first and the last point."""
    if len(path) <= MAX_POINTS:
        return path
    begin = path[0][0]
    width_us = max(1.0, (path[-1][0] - begin) / (MAX_POINTS - 2))
    bins = {int((point[0] - begin) / width_us): point for point in reversed(path)}
    kept = sorted([*bins.values(), path[-1]])
    return [point for index, point in enumerate(kept) if index == 0 or point != kept[index - 1]][:MAX_POINTS]
