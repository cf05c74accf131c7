"""Reading every surface for a moment: what `check` and `tare` do."""

import asyncio
from collections.abc import Mapping
from contextlib import aclosing
from dataclasses import dataclass

import numpy as np

from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.processing import stuck, tare
from beamtouch_daemon.processing.characteristic import QUALITIES, Calibration
from beamtouch_daemon.processing.pipeline import counts_of
from beamtouch_daemon.sources import source_of
from beamtouch_daemon.sources.reading import Reading, Source, SourceError
from beamtouch_service.samples import Quality


@dataclass(frozen=True, slots=True)
class ChannelState:
    """One channel in one reading."""

    channel: str
    counts: float | None
    gap_mm: float | None
    deflection_mm: float | None
    quality: Quality


@dataclass(frozen=True, slots=True)
class SurfaceState:
    """All channels of a surface in one reading, or why there is none."""

    surface: str
    channels: tuple[ChannelState, ...] = ()
    error: str | None = None
    limits: tuple[str, ...] = ()
    """What cannot be proven of its readings, a sentence each."""

    @property
    def is_good(self) -> bool:
        """Whether there is a reading and every channel in it is good."""
        return self.error is None and all(state.quality is Quality.GOOD for state in self.channels)


async def check(config: Config) -> list[SurfaceState]:
    """Read every surface once, all at the same time; ConfigError if a tare file does not fit."""
    rest = {name: tare.load(config.tare_file(name), s.channel_names) for name, s in config.surfaces.items()}
    return await asyncio.gather(*(_check(name, s, rest[name]) for name, s in config.surfaces.items()))


async def _check(name: str, surface: Surface, rest_gap_mm: dict[str, float]) -> SurfaceState:
    source = source_of(surface)
    try:
        (reading,) = await _take(source, 1)
    except SourceError as error:
        return SurfaceState(name, error=str(error))
    calibration = Calibration.of(surface.channels, rest_gap_mm)
    counts = counts_of([reading])
    gap = calibration.gap(counts)
    columns = zip(
        surface.channel_names,
        reading.counts,
        gap[0].tolist(),
        calibration.deflection(gap)[0].tolist(),
        calibration.quality(counts)[0].tolist(),
        strict=True,
    )
    return SurfaceState(
        name,
        tuple(
            ChannelState(channel, count, None, None, QUALITIES[code])
            if count is None
            else ChannelState(channel, count, gap_mm, deflection_mm, QUALITIES[code])
            for channel, count, gap_mm, deflection_mm, code in columns
        ),
        limits=source.limits,
    )


async def measure_rest(
    surface: Surface, last_mm: Mapping[str, float], *, accept_change: bool
) -> tuple[dict[str, float], int]:
    """Return the rest gaps [mm] by channel name and the number of readings; SourceError or TareRefusedError.

    Parameters
    ----------
    surface
        The configuration.
    last_mm
        The rest gaps of the last tare by channel name, empty without one.
    accept_change
        Whether rest gaps that contradict the last tare or the configuration are taken all the same.
    """
    readings = await _take(source_of(surface), tare.readings_needed(surface.rate_hz))
    calibration = Calibration.of(surface.channels)
    counts = counts_of(readings)
    lengths, _ = stuck.runs(counts, stuck.fresh(len(surface.channels)))
    most = stuck.longest_runs(surface.channels, calibration.steepest, surface.noise_mm, surface.rate_hz)
    for index in np.flatnonzero((lengths > most).any(axis=0)).tolist():
        message = f"{surface.channel_names[index]} is stuck: its counts do not change; check the sensor"
        raise tare.TareRefusedError(message)
    gaps = tare.rest_gaps(counts, calibration, surface.channel_names, surface.noise_mm)
    if (found := tare.contradictions(gaps, last_mm, surface)) and not accept_change:
        message = (
            f"{', '.join(found)}; take everything off the beam and tare again, "
            "or add --accept-change if the sensors were moved or the beam was changed"
        )
        raise tare.TareRefusedError(message)
    return gaps, len(readings)


async def _take(source: Source, number: int) -> list[Reading]:
    """Return the first `number` readings of a session."""
    readings: list[Reading] = []
    async with aclosing(source.readings()) as stream:
        async for arrived in stream:
            readings += arrived
            if len(readings) >= number:
                break
    return readings[:number]
