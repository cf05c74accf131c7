"""The mean position over samples that share no readings. Pure."""

from typing import NamedTuple


class _Sample(NamedTuple):
    sequence: int
    readings: int
    position_mm: float


class DisjointMean:
    """Averages positions, weighted by their readings.

    Means of successive samples share readings. Of samples that share some, the one with the most readings counts; of
    equal ones the first. The next one is the first that shares none with it. Readings from before the first sample
    count with the samples before it: an event may be recorded in parts.
    """

    def __init__(self, first_sequence: int) -> None:
        """Begin with the samples from this number on."""
        self._before = first_sequence - 1
        self._newest: _Sample | None = None
        self._readings = 0
        """Readings in the samples before the newest one."""
        self._sum_mm = 0.0

    def add(self, sequence: int, readings: int, position_mm: float) -> None:
        """Add the sample with this number, the mean of the `readings` up to it."""
        readings = min(readings, sequence - self._before)
        sample, newest = _Sample(sequence, readings, position_mm), self._newest
        if newest is not None and sequence - readings >= newest.sequence:
            self._readings += newest.readings
            self._sum_mm += newest.readings * newest.position_mm
        elif newest is not None and readings <= newest.readings:
            return
        self._newest = sample

    @property
    def mean_mm(self) -> float:
        """The mean; 0 without samples."""
        if self._newest is None:
            return 0.0
        _, readings, position_mm = self._newest
        return (self._sum_mm + readings * position_mm) / (self._readings + readings)
