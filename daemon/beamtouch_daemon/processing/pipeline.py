"""Turns readings into samples: characteristic, quality, filter, zero, covariance, sequence number."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.value_types import LARGEST
from beamtouch_daemon.processing import stuck
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_daemon.processing.filters import Uncertainty, chain_of, uncertainties
from beamtouch_daemon.processing.zero_tracking import ZeroTracker
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.filters import TARED, Filtered, FloatArray, Hurried, Rest, Rested
from beamtouch_service.samples import Note, Quality, Sample

_GOOD = QUALITIES.index(Quality.GOOD)
_MISSING = QUALITIES.index(Quality.MISSING)
_STUCK = QUALITIES.index(Quality.STUCK)


@dataclass(frozen=True, slots=True)
class TimedSample:
    """A sample and the newest reading in it."""

    reading: Reading
    sample: Sample
    notes: tuple[Note, ...] = ()
    """Notes on the surface at that time."""

    @property
    def monotonic_s(self) -> float:
        """Time of the reading by the clock of `uptime_s` [s]; determines the age when the sample is sent."""
        return self.reading.monotonic_s


def counts_of(readings: Sequence[Reading]) -> FloatArray:
    """Return the counts, shape (readings, channels), NaN where a count is missing or larger than any value."""
    counts = np.array(
        [[np.nan if count is None else count for count in reading.counts] for reading in readings], dtype=np.float64
    )
    counts[~(np.abs(counts) <= LARGEST)] = np.nan
    return counts


class Pipeline:
    """Turns the readings of one surface into samples, in order.

    A channel that is not good passes with its unfiltered deflection, for the record, and never enters the filter. Lost
    readings are counted by whoever takes them, because times jitter on a busy machine. The filter, the stuck check and
    the zeros continue over a gap with what they knew; only a gap as long as they look back makes them start again. A
    channel is missing until its filter has enough readings. No samples are emitted until at least one channel's filter
    has filled, so the newest sample before a gap stays in use until then.
    """

    def __init__(
        self,
        surface: Surface,
        rest_gap_mm: Mapping[str, float] | None = None,
        rest: Rest | None = None,
        rested: Rested = TARED,
    ) -> None:
        """Begin with nothing known but the last rest; without `rest`, each reading becomes a sample."""
        self._characteristic = Characteristic.of(surface, rest_gap_mm)
        self._chain = chain_of(surface)
        self._rest = rest
        self._longest_runs = stuck.longest_runs(surface)
        self._judges_runs = bool(np.isfinite(self._longest_runs).any())
        self._runs = stuck.Runs.of(surface)
        self._zeros = ZeroTracker.of(surface, rested)
        self._rate_hz = surface.rate_hz
        self.last_s: float | None = None
        """Time of the newest reading that was processed, by the clock of `uptime_s`."""
        self._next_number = 1

    @property
    def most_waiting(self) -> int:
        """Readings that may wait before they are processed, as nothing happens; 0 while something does."""
        return self._rest.most_waiting if self._rest is not None and self._rest.lasts else 0

    @property
    def rested(self) -> Rested | None:
        """The last rest, before the next reading; None if zeros are not tracked."""
        return None if self._zeros is None else self._zeros.rested

    @property
    def far_zero_mm(self) -> float | None:
        """The largest drift of a zero since the last tare [mm]; None unless it is nearly as far as is followed."""
        return None if self._zeros is None else self._zeros.far_mm

    @property
    def hurried_zero(self) -> Hurried | None:
        """The zero that drifts faster than is stated; None if none does."""
        return None if self._zeros is None else self._zeros.hurried

    def explains(self, reading: Reading) -> bool:
        """Return whether a reading at rest is explained by those before it."""
        return self._rest is not None and self._rest.explains(reading.counts)

    def process(
        self, readings: Sequence[Reading], unix_minus_monotonic_s: float, notes: tuple[Note, ...] = ()
    ) -> list[TimedSample]:
        """Return one sample per reading, one of all of them if nothing happens, or none.

        There is none while the filter has too few readings of every channel.

        Parameters
        ----------
        readings : At least one, oldest first.
        unix_minus_monotonic_s : Wall clock minus the clock of the readings now [s]; dates the samples for the record.
        notes : Notes on the surface, which the samples carry.
        """
        self.last_s = readings[-1].monotonic_s
        counts = counts_of(readings)
        gap_mm = self._characteristic.gap(counts)
        codes = self._quality(counts, gap_mm)
        raw = self._characteristic.deflection(gap_mm)
        lost = [reading.lost for reading in readings]
        good = codes == _GOOD
        good_mm = np.where(good, raw, np.nan)
        filtered = self._filtered(good_mm, readings, good, raw[-1], counts[-1])
        at_rest = len(readings) - len(filtered.moves)
        readings, codes, good, raw = readings[at_rest:], codes[at_rest:], good[at_rest:], raw[at_rest:]
        values, stated = np.where(good, filtered.mean_mm, raw), uncertainties(filtered)
        drifts: list[list[float] | None] = [None] * len(readings)
        if self._zeros is not None:
            zeros = self._zeros.track(good_mm, lost, filtered)
            values -= zeros.zero_mm[at_rest:]  # not of each reading: a mean holds some from before a zero moved
            drifts = self._zeros.stated(zeros, filtered)
        unsettled = (codes == _GOOD) & np.isnan(values)  # the filter has too few readings
        waits = [False] * len(readings)
        if unsettled.any():
            codes[unsettled] = _MISSING
            waits = (unsettled.any(axis=1) & ~(codes == _GOOD).any(axis=1)).tolist()
        if self.far_zero_mm is not None or self.hurried_zero is not None:
            notes = (*notes, Note.ZEROS)
        rows = zip(readings, values.tolist(), codes.tolist(), stated, drifts, strict=True)
        settled = [row for row, wait in zip(rows, waits, strict=True) if not wait]
        samples = [
            TimedSample(
                reading, _sample(number, reading.monotonic_s + unix_minus_monotonic_s, value, code, doubt, drift), notes
            )
            for number, (reading, value, code, doubt, drift) in enumerate(settled, self._next_number)
        ]
        self._next_number += len(samples)
        return samples

    def _quality(self, counts: FloatArray, gap_mm: FloatArray) -> NDArray[np.int8]:
        codes = self._characteristic.quality(counts, gap_mm)
        if self._judges_runs:
            codes[(codes == _GOOD) & (self._runs.lengths(counts) > self._longest_runs)] = _STUCK
        return codes

    def _filtered(
        self,
        values_mm: FloatArray,
        readings: Sequence[Reading],
        good: NDArray[np.bool_],
        newest_mm: FloatArray,
        counts: FloatArray,
    ) -> Filtered:
        """Return the means after all readings, or only that after the last one if nothing happened before and up to it.

        `newest_mm` and `counts` are those of the last reading.
        """
        lost = [reading.lost for reading in readings]
        times = [reading.likely_s * self._rate_hz for reading in readings]
        if self._rest is None:
            return self._chain.apply(values_mm, lost, times)
        mm_per_count = self._characteristic.mm_per_count(counts)
        if self._rest.lasts:
            before = self._chain.state
            newest = self._chain.apply_at_rest(values_mm, lost)
            if self._rest.follow(newest, good, newest_mm, counts, mm_per_count):
                return newest
            self._chain.state = before
            return self._chain.apply(values_mm, lost, times)
        filtered = self._chain.apply(values_mm, lost, times)
        self._rest.follow(filtered, good, newest_mm, counts, mm_per_count)
        return filtered


def _sample(
    number: int,
    unix_s: float,
    values: list[float],
    codes: list[int],
    uncertainty: Uncertainty,
    zero_mm: list[float] | None,
) -> Sample:
    # The service validates what it receives; to do so here as well would double the cost of a covariance.
    return Sample.model_construct(
        sequence=number,
        acquired_unix_us=round(unix_s * 1e6),
        deflection_mm=[None if code == _MISSING else value for value, code in zip(values, codes, strict=True)],
        quality=[QUALITIES[code] for code in codes],
        readings=uncertainty.readings,
        covariance_mm2=uncertainty.covariance_mm2,
        zero_mm=zero_mm,
    )
