"""The characteristic of the channels: counts to gap to deflection, and the quality of each count."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_common.units import direction_of
from beamtouch_daemon.config.settings import Surface
from beamtouch_models.filters import FloatArray
from beamtouch_service.samples import Quality

QUALITIES = tuple(Quality)
"""A quality code is an index into this tuple; 0 is good."""

_CODE = {quality: np.int8(code) for code, quality in enumerate(QUALITIES)}


@dataclass(frozen=True)
class Characteristic:
    """The characteristics of all channels; each field has shape (channels,) unless stated otherwise."""

    counts: FloatArray
    """Beginning of each straight piece [counts], shape (channels, pieces), padded with inf."""
    gaps: FloatArray
    """Gap at the beginning of each piece [mm], shape (channels, pieces)."""
    slopes: FloatArray
    """Slope of each piece [mm per count], shape (channels, pieces)."""
    table_low: FloatArray
    table_high: FloatArray
    """Ends of the table [counts]; infinite without a table."""
    rest_gap: FloatArray
    """[mm]"""
    low: FloatArray
    """Lower end of the linear range [mm]."""
    high: FloatArray
    """Upper end of the linear range [mm]."""
    saturated_low: FloatArray
    saturated_high: FloatArray
    """Counts at these ends and beyond are saturated."""
    towards: FloatArray
    """Change of the gap, or of the value in its place, with the deflection: -1 for a gap."""

    @classmethod
    def of(cls, surface: Surface, rest_gap_mm: Mapping[str, float] | None = None) -> Self:
        """Return the characteristics of a surface; `rest_gap_mm`, by channel name, overrides its rest gaps."""
        channels, rest = surface.channels, rest_gap_mm or {}
        saturated = [channel.saturated_at(surface.value_type_of(channel)) for channel in channels]
        ends = [(c.table[0][0], c.table[-1][0]) if c.table else (-np.inf, np.inf) for c in channels]
        return cls(
            counts=_rows([[counts for counts, _ in channel.points] for channel in channels]),
            gaps=_rows([[gap for _, gap in channel.points] for channel in channels]),
            slopes=_rows([channel.slopes for channel in channels]),
            table_low=np.array([low for low, _ in ends]),
            table_high=np.array([high for _, high in ends]),
            rest_gap=np.array([rest.get(channel.name, channel.rest_gap_mm) for channel in channels]),
            low=np.array([channel.range_mm[0] for channel in channels]),
            high=np.array([channel.range_mm[1] for channel in channels]),
            saturated_low=np.array([low for low, _ in saturated]),
            saturated_high=np.array([high for _, high in saturated]),
            towards=np.array([direction_of(channel.value_unit) for channel in channels]),
        )

    @property
    def steepest(self) -> FloatArray:
        """Largest change of the gap with one count [mm per count], shape (channels,)."""
        steepest: FloatArray = np.where(np.isfinite(self.slopes), np.abs(self.slopes), 0.0).max(axis=1)
        return steepest

    @property
    def identity(self) -> str:
        """Short text that changes with any characteristic and any rest gap."""
        shapes_and_values = b"".join(repr(values.shape).encode() + values.tobytes() for values in astuple(self))
        return hashlib.sha256(shapes_and_values).hexdigest()[:12]

    def gap(self, counts: FloatArray) -> FloatArray:
        """Return gaps [mm] of counts, shape (readings, channels); NaN, a missing count, stays NaN.

        Beyond the ends of a table its end pieces continue, so that the record shows which way a channel left it.
        """
        if self.counts.shape[1] == 1:  # without a table: the same result, faster
            lines: FloatArray = self.gaps.ravel() + self.slopes.ravel() * (counts - self.counts.ravel())
            return lines
        begin, gap, slope = (self._at(counts, of) for of in (self.counts, self.gaps, self.slopes))
        gaps: FloatArray = gap + slope * (counts - begin)
        return gaps

    def mm_per_count(self, counts: FloatArray) -> FloatArray:
        """Return the change of each deflection with a count, at these counts (channels,); NaN stays NaN."""
        slopes: FloatArray = np.where(np.isnan(counts), np.nan, self.towards * self._at(counts, self.slopes))
        return slopes

    def deflection(self, gap: FloatArray) -> FloatArray:
        """Return deflections [mm], positive in the direction of the load, of gaps, shape (readings, channels)."""
        deflection: FloatArray = self.towards * (gap - self.rest_gap)
        return deflection

    def quality(self, counts: FloatArray, gap_mm: FloatArray | None = None) -> NDArray[np.int8]:
        """Return a quality code per count, shape (readings, channels); `gap_mm` are their gaps if these are known.

        A count at an end of the ADC is saturated, whatever its gap: the sensor may be anywhere beyond.
        """
        gap_mm = self.gap(counts) if gap_mm is None else gap_mm
        codes = np.full(counts.shape, _CODE[Quality.GOOD], dtype=np.int8)
        in_table = (counts >= self.table_low) & (counts <= self.table_high)
        in_range = (gap_mm >= self.low) & (gap_mm <= self.high) & in_table
        converted = (counts > self.saturated_low) & (counts < self.saturated_high)
        if (in_range & converted).all():  # False for NaN
            return codes
        codes[~in_range] = _CODE[Quality.OUT_OF_RANGE]
        codes[~converted] = _CODE[Quality.SATURATED]
        codes[np.isnan(counts)] = _CODE[Quality.MISSING]
        return codes

    def _at(self, counts: FloatArray, values: FloatArray) -> FloatArray:
        """Return which of the values of the pieces (channels, pieces) counts have, shape (..., channels) as theirs."""
        piece = (counts[..., np.newaxis] >= self.counts[:, 1:]).sum(axis=-1)
        chosen: FloatArray = values[np.arange(len(values)), piece]
        return chosen


def _rows(ragged: Sequence[Sequence[float]]) -> FloatArray:
    """Return rows of unequal length as one array, padded with inf, which no count reaches."""
    rows = np.full((len(ragged), max(map(len, ragged))), np.inf)
    for row, values in zip(rows, ragged, strict=True):
        row[: len(values)] = values
    return rows
