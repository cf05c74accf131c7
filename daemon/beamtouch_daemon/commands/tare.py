"""`tare`: measures the rest gaps, with nothing on the beam, and keeps them in the tare file."""

import argparse
import asyncio
from collections.abc import Mapping

import numpy as np

from beamtouch_common.commands import DONE
from beamtouch_common.errors import FailedError, InputError
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.readiness import contact_on
from beamtouch_daemon.exits import complain
from beamtouch_daemon.processing import stuck, tare
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.pipeline import counts_of
from beamtouch_daemon.sources.configured import source_of
from beamtouch_daemon.sources.reading import SourceError, first_readings

REMEDY = (
    "take everything off the beam and tare again, or add --accept-change if the sensors were moved or the beam was "
    "changed"
)
FIRST_REMEDY = (
    "take everything off the beam and tare again, or add --accept-change if nothing touches it: before the first tare, "
    "a load and a sensor mounted elsewhere look alike"
)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError if the configuration cannot be used."""
    settings = load_config(arguments.config)
    chosen: str | None = arguments.surface
    if chosen is not None and chosen not in settings.surfaces:
        names = ", ".join(settings.surfaces)
        message = f"--surface: there is no surface {chosen}; choose one of {names}"
        raise InputError(message)
    accept: bool = arguments.accept_change
    codes = [_tare(settings, name, accept_change=accept) for name in ([chosen] if chosen else settings.surfaces)]
    return max(codes)


def _tare(settings: Config, name: str, *, accept_change: bool) -> int:
    """Tare one surface and return the exit code."""
    surface, path = settings.surfaces[name], settings.tare_file(name)
    try:
        last_mm = tare_file.load(path, surface.channel_names)
    except (InputError, FailedError):
        last_mm = {}  # a file that cannot be used is replaced
    try:
        gaps, readings = asyncio.run(measure_rest(surface, last_mm, accept_change=accept_change))
        seen = asyncio.run(_seen(settings, name))
        if seen and not accept_change:
            return complain(f"{name}: not tared: the service sees {seen}; {REMEDY}")
        tare_file.save(path, name, readings, gaps)
    except (SourceError, tare.TareRefusedError) as error:
        return complain(f"{name}: not tared: {error}")
    except OSError as error:
        return complain(f"{name}: cannot write {path}: {error.strerror}")
    text = ", ".join(f"{channel} {gap:.4f} mm" for channel, gap in gaps.items())
    print(f"{name}: rest gaps {text}, mean of {readings} readings, in {path}")
    told = {None: "the service could not be asked, or has no contact to give", "": "the service sees a beam at rest"}
    print(f"{name}: {tare.comparison(gaps, last_mm, surface)}; {told.get(seen, f'the service sees {seen}')}")
    print(f"{name}: a running daemon takes them when it is told: systemctl reload beamtouch-daemon, or kill -HUP PID")
    return DONE


async def _seen(settings: Config, name: str) -> str | None:
    """Return what the service sees on a surface, as `contact_on` does; None also if it cannot be asked."""
    try:
        secrets = settings.read_token(), settings.read_certificates()
    except (InputError, FailedError):
        return None  # the daemon has them from elsewhere
    async with ServiceClient(settings.publish.url, *secrets) as client:
        return await contact_on(client, name)


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
        message = f"{', '.join(found)}; {REMEDY if last_mm else FIRST_REMEDY}"
        raise tare.TareRefusedError(message)
    return gaps, len(readings)
