"""From counts to gap to deflection, and what each channel is worth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_daemon.config import Channel
from beamtouch_service.samples import Quality

FloatArray = NDArray[np.float64]
QUALITIES = tuple(Quality)
"""A quality code is an index into this tuple; 0 is good."""

_CODE = {quality: np.int8(code) for code, quality in enumerate(QUALITIES)}


@dataclass(frozen=True)
class Calibration:
    """The characteristic of every channel; each field has shape (channels,)."""

    gain: FloatArray
    """[mm per count]"""
    offset: FloatArray
    """[mm]"""
    rest_gap: FloatArray
    """[mm]"""
    low: FloatArray
    """Lower end of the linear range [mm]."""
    high: FloatArray
    """Upper end of the linear range [mm]."""
    full_scale: FloatArray
    """The largest count of the ADC."""

    @classmethod
    def of(cls, channels: Sequence[Channel], rest_gap_mm: Mapping[str, float] | None = None) -> Self:
        """Take the characteristics from the configuration; `rest_gap_mm`, by channel name, overrides its rest gaps."""
        rest = rest_gap_mm or {}
        return cls(
            gain=np.array([channel.gain_mm_per_count for channel in channels]),
            offset=np.array([channel.offset_mm for channel in channels]),
            rest_gap=np.array([rest.get(channel.name, channel.rest_gap_mm) for channel in channels]),
            low=np.array([channel.range_mm[0] for channel in channels]),
            high=np.array([channel.range_mm[1] for channel in channels]),
            full_scale=np.array([2.0**channel.adc_bits - 1 for channel in channels]),
        )

    def gap(self, counts: FloatArray) -> FloatArray:
        """Return gaps [mm] of counts, shape (readings, channels); NaN, a missing count, stays NaN."""
        return self.offset + self.gain * counts

    def deflection(self, gap: FloatArray) -> FloatArray:
        """Return deflections [mm], positive in the direction of the load, of gaps, shape (readings, channels)."""
        return self.rest_gap - gap

    def quality(self, counts: FloatArray) -> NDArray[np.int8]:
        """Return a quality code per count, shape (readings, channels).

        A count at the end of the ADC is saturated whatever gap it stands for: the sensor may be anywhere beyond.
        """
        gap = self.gap(counts)
        codes = np.full(counts.shape, _CODE[Quality.GOOD], dtype=np.int8)
        codes[(gap < self.low) | (gap > self.high)] = _CODE[Quality.OUT_OF_RANGE]
        codes[(counts <= 0) | (counts >= self.full_scale)] = _CODE[Quality.SATURATED]
        codes[np.isnan(counts)] = _CODE[Quality.MISSING]
        return codes
