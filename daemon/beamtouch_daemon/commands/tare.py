"""`tare`: measures the rest gaps, with nothing on the beam, and keeps them in the tare file."""

import argparse
import asyncio
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from beamtouch_common.commands import DONE
from beamtouch_common.errors import InputError
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.file import load_config, require_ports
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.exits import complain
from beamtouch_daemon.processing import stuck, tare
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.pipeline import counts_of
from beamtouch_daemon.sources.configured import source_of
from beamtouch_daemon.sources.reading import SourceError, first_readings


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError if the configuration cannot be used."""
    settings = load_config(arguments.config)
    chosen: str | None = arguments.surface
    if chosen is not None and chosen not in settings.surfaces:
        names = ", ".join(settings.surfaces)
        message = f"--surface: there is no surface {chosen}; choose one of {names}"
        raise InputError(message)
    require_ports(settings)
    accept: bool = arguments.accept_change
    codes = [
        _tare(settings.surfaces[name], name, settings.tare_file(name), accept_change=accept)
        for name in ([chosen] if chosen else settings.surfaces)
    ]
    return max(codes)


def _tare(surface: Surface, name: str, path: Path, *, accept_change: bool) -> int:
    """Tare one surface and return the exit code."""
    try:
        last_mm = tare_file.load(path, surface.channel_names)
    except InputError:
        last_mm = {}  # a file that cannot be used is replaced
    try:
        gaps, readings = asyncio.run(measure_rest(surface, last_mm, accept_change=accept_change))
        tare_file.save(path, name, readings, gaps)
    except (SourceError, tare.TareRefusedError) as error:
        return complain(f"{name}: not tared: {error}")
    except OSError as error:
        return complain(f"{name}: cannot write {path}: {error.strerror}")
    text = ", ".join(f"{channel} {gap:.4f} mm" for channel, gap in gaps.items())
    print(f"{name}: rest gaps {text}, mean of {readings} readings, in {path}")
    return DONE


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
        Whether to accept rest gaps that contradict the last tare or the configuration.
    """
    readings = await first_readings(source_of(surface), tare.readings_needed(surface.rate_hz))
    characteristic = Characteristic.of(surface.channels)
    counts = counts_of(readings)
    lengths, _ = stuck.runs(counts, stuck.fresh(len(surface.channels)))
    longest = stuck.longest_runs(surface.channels, characteristic.steepest, surface.noise_mm, surface.rate_hz)
    for index in np.flatnonzero((lengths > longest).any(axis=0)).tolist():
        message = f"{surface.channel_names[index]} is stuck: its counts do not change; check the sensor"
        raise tare.TareRefusedError(message)
    gaps = tare.rest_gaps(counts, characteristic, surface.channel_names, surface.noise_mm)
    if (found := tare.contradictions(gaps, last_mm, surface)) and not accept_change:
        message = (
            f"{', '.join(found)}; take everything off the beam and tare again, "
            "or add --accept-change if the sensors were moved or the beam was changed"
        )
        raise tare.TareRefusedError(message)
    return gaps, len(readings)
