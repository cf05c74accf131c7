"""From readings to samples: calibration, quality, filter, sequence number."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_daemon.calibration import QUALITIES, Calibration
from beamtouch_daemon.filters import Chain
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Quality, Sample

GAP_PERIODS = 3.0
"""Readings further apart than this many periods have a gap between them, and the filter starts anew."""


@dataclass(frozen=True, slots=True)
class Taken:
    """A sample, and when its reading was taken."""

    monotonic_s: float
    """On the monotonic clock of this host; the age is computed from it when the sample is sent."""
    sample: Sample


def counts_of(readings: Sequence[Reading]) -> NDArray[np.float64]:
    """Return the counts, shape (readings, channels), NaN where a channel is missing or no number."""
    counts = np.array(
        [[np.nan if count is None else count for count in reading.counts] for reading in readings], dtype=np.float64
    )
    counts[np.isinf(counts)] = np.nan
    return counts


class Pipeline:
    """The way of one surface's readings, in order.

    A channel that is not good passes with its own unfiltered deflection, for the record, and never enters the filter.
    After a gap in the readings the filter starts anew, so that an old value is never passed for a new one.
    """

    def __init__(self, calibration: Calibration, chain: Chain, rate_hz: float) -> None:
        self._calibration = calibration
        self._chain = chain
        self._gap_s = GAP_PERIODS / rate_hz
        self._last_s: float | None = None
        self._sequence = 0

    def restart(self) -> None:
        """Start the filter anew, as after a gap; sequence numbers go on."""
        self._chain.restart()
        self._last_s = None

    def process(self, readings: Sequence[Reading], unix_minus_monotonic_s: float) -> list[Taken]:
        """Return one sample per reading.

        Parameters
        ----------
        readings
            At least one, oldest first.
        unix_minus_monotonic_s
            Wall clock less monotonic clock now [s]; it dates the samples for the record.
        """
        times = np.array([reading.monotonic_s for reading in readings])
        counts = counts_of(readings)
        codes = self._calibration.quality(counts)
        raw = self._calibration.deflection(self._calibration.gap(counts))
        good = codes == QUALITIES.index(Quality.GOOD)
        filtered = self._filter(times, np.where(good, raw, np.nan))
        values = np.where(good, filtered, raw)
        return [
            Taken(reading.monotonic_s, self._sample(reading.monotonic_s + unix_minus_monotonic_s, value, code))
            for reading, value, code in zip(readings, values, codes, strict=True)
        ]

    def _filter(self, times: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        before = times[0] if self._last_s is None else self._last_s
        self._last_s = float(times[-1])
        starts = np.flatnonzero(np.diff(times, prepend=before) > self._gap_s)
        parts = []
        for number, part in enumerate(np.split(values, starts)):
            if number:
                self._chain.restart()
            parts.append(self._chain.apply(part))
        return np.concatenate(parts)

    def _sample(self, unix_s: float, values: NDArray[np.float64], codes: NDArray[np.int8]) -> Sample:
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
