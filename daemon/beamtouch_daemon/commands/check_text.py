"""The report of `check`: what it found on each channel, and the table and the JSON object that say it."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from beamtouch_daemon.commands.resolution import counts_text, rounded
from beamtouch_service.samples import Quality

_HEADINGS = ("surface", "channel", "counts", "gap mm", "deflection mm", "quality")
_NUMBERS = (2, 3, 4)
"""Columns with numbers, which stand to the right."""


_CAUSES = {
    Quality.OUT_OF_RANGE: "the gap is outside range_mm; take everything off the beam, or correct the characteristic",
    Quality.SATURATED: "the counts stand at an end of the ADC; check the wiring, and adc_bits or counts_range",
    Quality.MISSING: "the device sent no value; check unit and register, which counts from 0",
}
"""Qualities that a single reading can have beside good, with their usual causes."""


@dataclass(frozen=True, slots=True)
class ChannelState:
    """One channel in one reading."""

    channel: str
    counts: float | None
    gap_mm: float | None
    deflection_mm: float | None
    quality: Quality
    decimals: int
    """Decimals of lengths in mm that the channel resolves."""


@dataclass(frozen=True, slots=True)
class SurfaceState:
    """All channels of a surface in one reading, or the error that prevented it."""

    surface: str
    file: Path
    """The configuration file that has the surface."""
    channels: tuple[ChannelState, ...] = ()
    error: str | None = None
    limits: tuple[str, ...] = ()
    """Cases in which old or foreign readings may pass unnoticed, a sentence each."""
    refusal: str | None = None
    """Reason why the service does not take the samples of this surface; None: it takes them, or was not asked."""

    doubt: str | None = None
    """Reason why the service's model seems to be that of another surface."""

    @property
    def has_arrived(self) -> bool:
        """Whether there is a reading with all channels."""
        return self.error is None and all(one.quality is not Quality.MISSING for one in self.channels)

    @property
    def is_good(self) -> bool:
        """Whether every channel is good in a reading, and the service takes the samples, if it was asked."""
        return self.error is None and self.refusal is None and all(one.quality is Quality.GOOD for one in self.channels)

    @property
    def complaints(self) -> tuple[str, ...]:
        """What prevents readings, and what prevents samples."""
        return tuple(text for text in (self.error, *self._bad_channels(), self.refusal) if text)

    def _bad_channels(self) -> Iterator[str]:
        for quality, cause in _CAUSES.items():
            if names := [one.channel for one in self.channels if one.quality is quality]:
                yield f"{', '.join(names)} {quality.value}: {cause}"


def as_json(state: SurfaceState, *, asked: bool) -> dict[str, object]:
    """Return the state of a surface for JSON; `asked`: whether the service was asked."""
    channels = [
        {
            "channel": one.channel,
            "counts": None if one.counts is None else json.loads(counts_text(one.counts)),
            "gap_mm": _length(one.gap_mm, one),
            "deflection_mm": _length(one.deflection_mm, one),
            "quality": one.quality,
        }
        for one in state.channels
    ]
    said: dict[str, object] = {
        "file": str(state.file),
        "error": state.error,
        "channels": channels,
        "limits": state.limits,
    }
    # Null: not asked.
    said["service"] = (state.refusal or "takes samples") if asked else None
    said["doubt"] = state.doubt
    return said


def lines(states: Sequence[SurfaceState], *, with_files: bool) -> Iterator[str]:
    """Return the table, with the file of each surface if there are several, and the limits below it."""
    rows = [(*_HEADINGS, *["file"] * with_files)]
    rows += [(*_cells(state, one), *[str(state.file)] * with_files) for state in states for one in state.channels]
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (c.rjust(w) if i in _NUMBERS else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        yield "  ".join(cells).rstrip()
    for state in states:
        yield from (f"{state.surface}: {text}" for text in (*state.limits, state.doubt) if text)


def _cells(state: SurfaceState, one: ChannelState) -> tuple[str, ...]:
    counts = "-" if one.counts is None else counts_text(one.counts)
    gap, deflection = _length(one.gap_mm, one), _length(one.deflection_mm, one)
    lengths = ("-" if mm is None else f"{mm:.{one.decimals}f}" for mm in (gap, deflection))
    return state.surface, one.channel, counts, *lengths, one.quality.value


def _length(value_mm: float | None, one: ChannelState) -> float | None:
    return None if value_mm is None else rounded(value_mm, one.decimals)
