"""`check`: reads every channel once and prints counts, gap, deflection and quality."""

import argparse
import asyncio
import dataclasses
import json
from collections.abc import Sequence
from dataclasses import dataclass

from beamtouch_common.commands import DONE, FAILED
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.file import load_config, require_ports
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.exits import complain
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_daemon.processing.pipeline import counts_of
from beamtouch_daemon.sources.configured import Buses, source_of
from beamtouch_daemon.sources.reading import SourceError, first_readings
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
    """All channels of a surface in one reading, or the error that prevented it."""

    surface: str
    channels: tuple[ChannelState, ...] = ()
    error: str | None = None
    limits: tuple[str, ...] = ()
    """Cases in which old or foreign readings may pass unnoticed, a sentence each."""

    @property
    def is_good(self) -> bool:
        """Whether there is a reading and every channel in it is good."""
        return self.error is None and all(state.quality is Quality.GOOD for state in self.channels)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError if the configuration or a tare file cannot be used."""
    settings = load_config(arguments.config)
    require_ports(settings)
    states = asyncio.run(check(settings))
    is_good = all(state.is_good for state in states)
    if arguments.json:
        print(json.dumps({"good": is_good, "surfaces": {state.surface: _as_json(state) for state in states}}))
    else:
        _print_table(states)
        for state in states:
            for limit in state.limits:
                print(f"{state.surface}: {limit}")
    for state in states:
        if state.error:
            complain(f"{state.surface}: {state.error}")
    return DONE if is_good else FAILED


async def check(config: Config) -> list[SurfaceState]:
    """Read every surface once, all at the same time; InputError if a tare file does not fit."""
    rest = {name: tare_file.load(config.tare_file(name), s.channel_names) for name, s in config.surfaces.items()}
    buses: Buses = {}
    return await asyncio.gather(*(_check(name, s, rest[name], buses) for name, s in config.surfaces.items()))


async def _check(name: str, surface: Surface, rest_gap_mm: dict[str, float], buses: Buses) -> SurfaceState:
    source = source_of(surface, name, buses)
    try:
        (reading,) = await first_readings(source, 1)
    except SourceError as error:
        return SurfaceState(name, error=str(error))
    characteristic = Characteristic.of(surface.channels, rest_gap_mm)
    counts = counts_of([reading])
    gap = characteristic.gap(counts)
    columns = zip(
        surface.channel_names,
        reading.counts,
        gap[0].tolist(),
        characteristic.deflection(gap)[0].tolist(),
        characteristic.quality(counts)[0].tolist(),
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


def _as_json(state: SurfaceState) -> dict[str, object]:
    channels = [dataclasses.asdict(channel) for channel in state.channels]
    return {"error": state.error, "channels": channels, "limits": state.limits}


def _print_table(states: Sequence[SurfaceState]) -> None:
    rows = [("surface", "channel", "counts", "gap mm", "deflection mm", "quality")]
    rows += [
        (
            state.surface,
            channel.channel,
            "-" if channel.counts is None else f"{channel.counts:.10g}",
            "-" if channel.gap_mm is None else f"{channel.gap_mm:.4f}",
            "-" if channel.deflection_mm is None else f"{channel.deflection_mm:.4f}",
            channel.quality.value,
        )
        for state in states
        for channel in state.channels
    ]
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (c.rjust(w) if 2 <= i <= 4 else c.ljust(w) for i, (c, w) in enumerate(zip(row, widths, strict=True)))
        print("  ".join(cells).rstrip())
