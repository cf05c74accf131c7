"""`noise`: measures the noise of the readings at rest, and prints it in the keys of the daemon and of a scene."""

import argparse
import asyncio
import json
import math
import sys
from contextlib import aclosing
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beamtouch_common.commands import DONE, FAILED
from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_daemon.commands import noise_text
from beamtouch_daemon.commands.noise_text import Measured
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.exits import complain
from beamtouch_daemon.processing.noise_keys import keys_of
from beamtouch_daemon.processing.pipeline import counts_of
from beamtouch_daemon.processing.rest_checks import NotMeasuredError, at_rest
from beamtouch_daemon.processing.rest_noise import measured, readings_needed
from beamtouch_daemon.sources.configured import Buses, source_of
from beamtouch_daemon.sources.reading import Source, SourceError
from beamtouch_models.filters import FloatArray

DEFAULT_S = 60.0
MARGIN = 1.2
"""Without --seconds, a filter that averages long gets this many times the readings that it needs."""
MAX_SECONDS = 3600.0
MAX_READINGS = 2_000_000
"""Limit of the readings of a surface, for memory."""
PATIENCE_S = 60.0
"""Limit of the extra time when readings are lost; the time that was asked for, if that is longer."""
PROGRESS_S = 10.0


class Recording(NamedTuple):
    """The readings of a surface."""

    counts: FloatArray
    """Shape (readings, channels), NaN where missing."""
    lost: int
    seconds: float


@dataclass(frozen=True)
class Refused:
    """A surface whose noise was not measured."""

    surface: str
    reason: str


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError if the configuration, a tare file or an argument cannot be used."""
    config = load_config(arguments.config)
    chosen: str | None = arguments.surface
    if chosen is not None and chosen not in config.surfaces:
        message = f"--surface: there is no surface {chosen}; choose one of {', '.join(config.surfaces)}"
        raise InputError(message)
    names = [chosen] if chosen else list(config.surfaces)
    seconds = {name: _seconds(arguments.seconds, config.surfaces[name]) for name in names}
    answers = asyncio.run(_measure(config, seconds))
    done = [answer for answer in answers if isinstance(answer, Measured)]
    refused = [answer for answer in answers if isinstance(answer, Refused)]
    if arguments.json:
        surfaces = {answer.surface: noise_text.as_json(answer) for answer in done}
        print(json.dumps({"surfaces": surfaces | {answer.surface: {"error": answer.reason} for answer in refused}}))
    elif done:
        print("\n".join(noise_text.lines(done)))
    for answer in refused:
        complain(f"{answer.surface}: not measured: {answer.reason}")
    return FAILED if refused else DONE


def _seconds(asked: float | None, surface: Surface) -> float:
    """Return the time to record; InputError if it is too short, or too long for the memory."""
    needed_s = readings_needed(surface) / surface.rate_hz
    seconds = max(DEFAULT_S, MARGIN * needed_s) if asked is None else asked
    longest_s = min(MAX_SECONDS, MAX_READINGS / surface.rate_hz)
    if not needed_s <= seconds <= longest_s:
        message = f"--seconds: give {_rounded(needed_s)} to {_rounded(longest_s)}, as its rate and its filter require"
        if needed_s > longest_s:
            message = (
                f"its filter needs {_rounded(needed_s)} s of readings, and at most {_rounded(longest_s)} s are recorded"
            )
        raise InputError(message)
    return seconds


def _rounded(seconds: float) -> str:
    """Return a time in at least three digits, never as a power of ten."""
    return digits(seconds, 3) if seconds < 999.5 else f"{seconds:.0f}"


async def _measure(config: Config, seconds: dict[str, float]) -> list[Measured | Refused]:
    """Record all surfaces at the same time, as `run` reads them; InputError if a tare file does not fit."""
    rest = {name: tare_file.load(config.tare_file(name), config.surfaces[name].channel_names) for name in seconds}
    buses: Buses = {}

    async def one(name: str) -> Measured | Refused:
        surface = config.surfaces[name]
        try:
            recording = await _record(source_of(surface, name, buses), name, seconds[name], surface)
            return await asyncio.to_thread(_measured, name, surface, recording, rest[name])
        except (SourceError, NotMeasuredError) as error:
            return Refused(name, str(error))

    return await asyncio.gather(*(one(name) for name in seconds))


def _measured(name: str, surface: Surface, recording: Recording, rest_mm: dict[str, float]) -> Measured:
    found = measured(at_rest(recording.counts, surface, rest_mm), surface)
    return Measured(
        name, surface, len(recording.counts), recording.lost, recording.seconds, found, keys_of(found, surface)
    )


async def _record(source: Source, name: str, seconds: float, surface: Surface) -> Recording:
    """Return the readings of the next seconds; SourceError if the source fails."""
    needed, taken = readings_needed(surface), 0
    print(f"{name}: recording {digits(seconds, 3)} s at rest; keep everything off the beam", file=sys.stderr)
    parts: list[FloatArray] = []
    lost, first_s, passed_s, said_s = 0, math.nan, 0.0, PROGRESS_S
    async with aclosing(source.readings()) as stream:
        async for readings in stream:
            if not parts:
                first_s = readings[0].monotonic_s - 1 / surface.rate_hz
            parts.append(counts_of(readings))
            lost += sum(reading.lost for reading in readings)
            passed_s = readings[-1].monotonic_s - first_s
            taken += len(readings)
            if passed_s >= seconds + (0.0 if taken >= needed else max(PATIENCE_S, seconds)):
                break
            if passed_s >= said_s:
                print(f"{name}: {passed_s:.0f} of {seconds:.0f} s", file=sys.stderr)
                said_s += PROGRESS_S
    return Recording(np.concatenate(parts), lost, passed_s)
