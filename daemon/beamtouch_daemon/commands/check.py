"""`check`: reads every channel once and prints counts, gap, deflection and quality."""

import argparse
import asyncio
import dataclasses
import json
import sys
from time import monotonic

from beamtouch_common.commands import DONE, FAILED
from beamtouch_daemon.commands.check_text import ChannelState, SurfaceState, as_json, lines
from beamtouch_daemon.commands.resolution import decimals_of
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.readiness import doubt_of, refusal_of
from beamtouch_daemon.exits import complain
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_daemon.processing.pipeline import counts_of
from beamtouch_daemon.sources.configured import Buses, source_of
from beamtouch_daemon.sources.reading import Reading, SourceError, first_readings

PAUSE_S = 0.5
"""Pause between two attempts of --wait."""

NOT_ASKED = "The service was not asked whether it takes these samples; check --wait 5 asks it."


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError if the configuration, a tare file or the token cannot be used."""
    settings = load_config(arguments.config)
    wait_s: float | None = arguments.wait
    states = asyncio.run(check(settings) if wait_s is None else wait(settings, wait_s))
    is_good = all(state.is_good for state in states)
    if arguments.json:
        surfaces = {state.surface: as_json(state, asked=wait_s is not None) for state in states}
        print(json.dumps({"good": is_good, "surfaces": surfaces}))
    else:
        print("\n".join(lines(states, with_files=bool(settings.include))))
        if wait_s is None:
            print(NOT_ASKED)
    for state in states:
        for text in state.complaints:
            complain(f"{state.surface}: {text}")
    return DONE if is_good else FAILED


async def wait(config: Config, wait_s: float) -> list[SurfaceState]:
    """Check until all channels arrive and the service takes samples, for about `wait_s` [s]; return the last states.

    An attempt that has begun is completed. InputError if a tare file, the token or a certificate cannot be used.
    """
    deadline_s = monotonic() + wait_s
    said: list[str] = []
    async with ServiceClient(config.publish.url, config.read_token(), config.read_certificates()) as client:
        while True:
            states = await check(config)
            states = await asyncio.gather(*(_ask(client, state, config.surfaces[state.surface]) for state in states))
            waiting = [f"{state.surface}: {_awaited(state)}" for state in states if _awaited(state)]
            left_s = deadline_s - monotonic()
            if not waiting or left_s <= 0:
                return states
            if waiting != said:
                print(*(f"waiting: {text}" for text in waiting), sep="\n", file=sys.stderr, flush=True)
                said = waiting
            await asyncio.sleep(min(PAUSE_S, left_s))


async def _ask(client: ServiceClient, state: SurfaceState, surface: Surface) -> SurfaceState:
    refusal = await refusal_of(client, state.surface, surface)
    doubt = None if refusal else await doubt_of(client, state.surface, surface)
    return dataclasses.replace(state, refusal=refusal, doubt=doubt)


def _awaited(state: SurfaceState) -> str:
    """Return what a surface lacks that may still come; empty if it lacks nothing."""
    missing = "" if state.has_arrived else "not all channels arrive"
    return state.error or missing or state.refusal or ""


async def check(config: Config) -> list[SurfaceState]:
    """Read every surface once, all at the same time; InputError if a tare file does not fit."""
    rest = {name: tare_file.load(config.tare_file(name), s.channel_names) for name, s in config.surfaces.items()}
    buses: Buses = {}

    async def one(name: str, surface: Surface) -> SurfaceState:
        source = source_of(surface, name, buses)
        try:
            (reading,) = await first_readings(source, 1)
        except SourceError as error:
            return SurfaceState(name, config.file_of(name), error=str(error))
        return SurfaceState(name, config.file_of(name), _channels(surface, rest[name], reading), limits=source.limits)

    return await asyncio.gather(*(one(name, surface) for name, surface in config.surfaces.items()))


def _channels(surface: Surface, rest_gap_mm: dict[str, float], reading: Reading) -> tuple[ChannelState, ...]:
    characteristic = Characteristic.of(surface.channels, rest_gap_mm)
    counts = counts_of([reading])
    gap = characteristic.gap(counts)
    columns = zip(
        surface.channel_names,
        reading.counts,
        gap[0].tolist(),
        characteristic.deflection(gap)[0].tolist(),
        characteristic.quality(counts)[0].tolist(),
        (decimals_of(step_mm, surface.noise_mm) for step_mm in characteristic.steepest.tolist()),
        strict=True,
    )
    return tuple(
        ChannelState(channel, count, None, None, QUALITIES[code], decimals)
        if count is None
        else ChannelState(channel, count, gap_mm, deflection_mm, QUALITIES[code], decimals)
        for channel, count, gap_mm, deflection_mm, code, decimals in columns
    )
