"""From readings to samples: calibration, quality, zero, filter, sequence number."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing import stuck, zero_tracking
from beamtouch_daemon.processing.characteristic import QUALITIES, Calibration
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.filters import Chain, stages
from beamtouch_service.samples import Note, Quality, Sample

FloatArray = NDArray[np.float64]

GAP_PERIODS = 3.0
"""Readings further apart than this many periods have a gap between them, and the filter starts anew."""

_GOOD = QUALITIES.index(Quality.GOOD)
_MISSING = QUALITIES.index(Quality.MISSING)
_STUCK = QUALITIES.index(Quality.STUCK)


@dataclass(frozen=True, slots=True)
class Taken:
    """A sample, and the newest reading in it."""

    reading: Reading
    sample: Sample
    notes: tuple[Note, ...] = ()
    """What was known of the surface then."""

    @property
    def monotonic_s(self) -> float:
        """When it was taken, on the monotonic clock of this host; the age is computed from it at sending [s]."""
        return self.reading.monotonic_s


def counts_of(readings: Sequence[Reading]) -> FloatArray:
    """Return the counts, shape (readings, channels), NaN where a channel is missing or no number."""
    counts = np.array(
        [[np.nan if count is None else count for count in reading.counts] for reading in readings], dtype=np.float64
    )
    counts[np.isinf(counts)] = np.nan
    return counts


class Pipeline:
    """The way of one surface's readings, in order.

    A channel that is not good passes with its own unfiltered deflection, for the record, and never enters the filter.
    After a gap in the readings the filter starts anew, so that an old value is never passed for a new one; what is
    known of stuck channels and of the zeros stays. Until the filter has enough readings of a channel, it is missing;
    until it has of any, there are no samples: the last one before a short gap stands until there is a better one.
    """

    def __init__(self, surface: Surface, rest_gap_mm: Mapping[str, float] | None = None) -> None:
        channels = len(surface.channels)
        self._calibration = Calibration.of(surface.channels, rest_gap_mm)
        self._chain = Chain(stages(surface.filter, surface.rate_hz), channels)
        self._longest_runs = stuck.longest_runs(
            surface.channels, self._calibration.steepest, surface.noise_mm, surface.rate_hz
        )
        self._judges_runs = bool(np.isfinite(self._longest_runs).any())
        self._runs = stuck.fresh(channels)
        tracking = surface.zero_tracking
        self._zero_rules = None if tracking is None else zero_tracking.Rules.of(tracking, surface.rate_hz)
        self._zero = zero_tracking.fresh(channels)
        self._gap_s = GAP_PERIODS / surface.rate_hz
        self._last_s: float | None = None
        self._sequence = 0

    def restart(self) -> None:
        """Start the filter anew, as after a gap; sequence numbers go on."""
        self._chain.restart()
        self._zero = self._zero.disturbed()
        self._last_s = None

    def process(
        self, readings: Sequence[Reading], unix_minus_monotonic_s: float, notes: tuple[Note, ...] = ()
    ) -> list[Taken]:
        """Return one sample per reading, but none as long as the filter has too few readings of every channel.

        Parameters
        ----------
        readings
            At least one, oldest first.
        unix_minus_monotonic_s
            Wall clock less monotonic clock now [s]; it dates the samples for the record.
        notes
            What is known of the surface; the samples carry it.
        """
        times = np.array([reading.monotonic_s for reading in readings])
        counts = counts_of(readings)
        codes = self._quality(counts)
        raw = self._calibration.deflection(self._calibration.gap(counts))
        values = np.empty_like(raw)
        for part in self._without_gaps(times):
            values[part] = self._values(raw[part], codes[part] == _GOOD)
        unsettled = (codes == _GOOD) & np.isnan(values)  # the filter has too few readings yet
        codes[unsettled] = _MISSING
        waits = unsettled.any(axis=1) & ~(codes == _GOOD).any(axis=1)
        return [
            Taken(reading, self._sample(reading.monotonic_s + unix_minus_monotonic_s, value, code), notes)
            for reading, value, code, wait in zip(readings, values, codes, waits, strict=True)
            if not wait
        ]

    def _quality(self, counts: FloatArray) -> NDArray[np.int8]:
        codes = self._calibration.quality(counts)
        if self._judges_runs:
            lengths, self._runs = stuck.runs(counts, self._runs)
            codes[(codes == _GOOD) & (lengths > self._longest_runs)] = _STUCK
        return codes

    def _without_gaps(self, times: FloatArray) -> Iterator[slice]:
        """Yield the parts of some readings between which there are gaps, having started anew before each."""
        before = times[0] if self._last_s is None else self._last_s
        self._last_s = float(times[-1])
        starts = np.flatnonzero(np.diff(times, prepend=before) > self._gap_s).tolist()
        for start, end in pairwise([*sorted({0, *starts}), len(times)]):
            if start in starts:
                self._chain.restart()
                self._zero = self._zero.disturbed()
            yield slice(start, end)

    def _values(self, raw: FloatArray, good: NDArray[np.bool_]) -> FloatArray:
        """Return the deflections to publish of readings without a gap."""
        if self._zero_rules is not None:
            zeros, self._zero = zero_tracking.track(np.where(good, raw, np.nan), self._zero, self._zero_rules)
            raw = raw - zeros
        filtered = self._chain.apply(np.where(good, raw, np.nan))
        return np.where(good, filtered, raw)

    def _sample(self, unix_s: float, values: FloatArray, codes: NDArray[np.int8]) -> Sample:
        qualities = [QUALITIES[code] for code in codes]
        sample = Sample(
            sequence=self._sequence,
            acquired_unix_us=round(unix_s * 1e6),
            deflection_mm=[
                None if quality is Quality.MISSING else value
                for value, quality in zip(values.tolist(), qualities, strict=True)
            ],
            quality=qualities,
        )
        self._sequence += 1
        return sample
