"""A segment while its samples arrive. Pure: no clock, no I/O."""

from dataclasses import replace

from beamtouch_service.events.best_samples import Best
from beamtouch_service.events.disjoint_mean import DisjointMean
from beamtouch_service.events.segments import MAX_POINTS, Point, Segment, Sums, thin
from beamtouch_service.surfaces.contact import Figures

_NO_SUMS = Sums()


class GrowingSegment:
    """A segment that is extended sample by sample, in place: `Segment` is too slow for a thousand samples a second."""

    def __init__(self, first: Segment) -> None:
        """Begin with a segment whose first sample has yet to be added."""
        self._first = first
        self._last = first.first_sequence, first.touched_us
        self._figures = _NO_SUMS
        self._positions = DisjointMean(first.first_sequence), DisjointMean(first.first_sequence)
        """Of steady samples and of unsteady ones."""
        self._unexplained_us = 0
        self._is_unexplained = False
        """Whether the last sample is unexplained."""
        self._degraded = False
        self._path: list[Point] = []
        self.best: Best | None = None
        """The best sample so far."""

    @property
    def duration_us(self) -> int:
        """Time from the first sample to the last, by the sender's clock [us]."""
        return abs(self._last[1] - self._first.touched_us)

    def add(
        self,
        sequence: int,
        acquired_us: int,
        figures: Figures | None,
        *,
        unexplained: bool,
        degraded: bool,
        unsteady: bool = False,
        readings: int = 1,
    ) -> None:
        """Add the next sample, the mean of `readings`; `figures` is None if it is unexplained or undecided."""
        if self._is_unexplained:
            self._unexplained_us += max(0, acquired_us - self._last[1])
        self._last = sequence, acquired_us
        self._is_unexplained = unexplained
        self._degraded |= degraded
        if figures is None or figures.position_mm is None:
            return
        position_mm, force_n = figures.position_mm, figures.force_n
        at_peak = None if force_n is None else position_mm
        self._figures = self._figures.plus(Sums(1, position_mm, force_n, at_peak, unsteady))
        self._positions[unsteady].add(sequence, readings, position_mm)
        self._path.append((acquired_us, position_mm, force_n))
        if len(self._path) > 2 * MAX_POINTS:
            self._path = thin(self._path)

    def segment(self) -> Segment:
        """Return the segment of all samples so far."""
        figures, position = self._figures, self._positions[self._figures.unsteady]
        return replace(
            self._first,
            last_sequence=self._last[0],
            last_us=self._last[1],
            **figures._replace(position_sum_mm=figures.samples * position.mean_mm)._asdict(),
            unexplained_us=self._unexplained_us,
            ends_unexplained=self._is_unexplained,
            degraded=self._degraded,
            path=list(self._path),
            best=self.best,
        )
