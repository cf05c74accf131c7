"""`noise`: measures the noise of the readings at rest, and prints it in the keys of the daemon and of a scene."""

import argparse
import asyncio
import json
import math
import sys
from collections.abc import Sequence
from contextlib import aclosing
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beamtouch_common.commands import DONE
from beamtouch_common.digits import digits
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.outline import BEAM_AXES, BEAM_AXIS
from beamtouch_common.table import aligned
from beamtouch_common.units import MM
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.measuring.at_rest import NotAtRestError, select_rest
from beamtouch_daemon.measuring.figures import heads_with_unit
from beamtouch_daemon.measuring.noise import ChannelNoise, Keys, keys_of, measure_noise, readings_needed
from beamtouch_daemon.processing.pipeline import counts_of
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
HEAD = ("surface", "channel", "noise", "correlation ms", "effective", "drift", "step")
OF_UNIT = ("noise", "effective", "drift", "step")


class Recording(NamedTuple):
    """The readings of a surface."""

    counts: FloatArray
    """Shape (readings, channels), NaN where missing."""
    lost: int
    seconds: float


@dataclass(frozen=True)
class Measurement:
    """The noise of a surface."""

    surface: str
    settings: Surface
    recording: Recording
    channels: Sequence[ChannelNoise]
    keys: Keys

    def correlation_ms(self, channel: ChannelNoise) -> float:
        """Return the time after which a reading counts as independent; about a period for white noise."""
        return 1e3 * channel.correlated_readings / self.settings.rate_hz


def run(arguments: argparse.Namespace) -> int:
    """Run the command; FailedError if the noise of a surface was not measured, InputError for wrong input."""
    config = load_config(arguments.config)
    names = config.choose_surfaces(arguments.surface)
    seconds = {name: _seconds(arguments.seconds, config.surfaces[name]) for name in names}
    answers = asyncio.run(_measure_all(config, seconds, config.read_rest_gaps(names)))
    measurements = [answer for answer in answers.values() if isinstance(answer, Measurement)]
    reasons = {name: answer for name, answer in answers.items() if isinstance(answer, str)}
    if arguments.json:
        surfaces = {measurement.surface: _as_json(measurement) for measurement in measurements}
        print(json.dumps({"surfaces": surfaces | {name: {"error": reason} for name, reason in reasons.items()}}))
    elif measurements:
        print("\n".join(report(measurements)))
    if reasons:
        raise FailedError(*(f"{name}: not measured: {reason}" for name, reason in reasons.items()))
    return DONE


def _seconds(asked: float | None, surface: Surface) -> float:
    """Return the time to record; InputError if it is too short, or too long for the memory."""
    needed_s = readings_needed(surface) / surface.rate_hz
    longest_s = min(MAX_SECONDS, MAX_READINGS / surface.rate_hz)
    if needed_s > longest_s:
        raise InputError(f"its filter needs {needed_s:g} s of readings, and at most {longest_s:g} s are recorded")
    seconds = min(max(DEFAULT_S, MARGIN * needed_s), longest_s) if asked is None else asked
    if not needed_s <= seconds <= longest_s:
        raise InputError(f"--seconds: give {needed_s:g} to {longest_s:g}, as its rate and its filter require")
    return seconds


async def _measure_all(
    config: Config, seconds: dict[str, float], rest_mm: dict[str, dict[str, float]]
) -> dict[str, Measurement | str]:
    """Record all surfaces at the same time, as `run` reads them; return what is measured, or why nothing is."""
    buses: Buses = {}

    async def measure(name: str) -> Measurement | str:
        surface = config.surfaces[name]
        print(f"{name}: recording {digits(seconds[name], 3)} s at rest; keep everything off the beam", file=sys.stderr)
        try:
            recording = await _record(source_of(surface, name, buses), seconds[name], surface)
            return await asyncio.to_thread(_measure, name, surface, recording, rest_mm[name])
        except (SourceError, NotAtRestError) as error:
            return str(error)

    answers = await asyncio.gather(*map(measure, seconds))
    return dict(zip(seconds, answers, strict=True))


async def _record(source: Source, seconds: float, surface: Surface) -> Recording:
    """Return the readings of the next seconds, and some more if many are lost; SourceError if the source fails."""
    needed, parts = readings_needed(surface), list[FloatArray]()
    taken, lost, begin_s = 0, 0, math.nan
    async with aclosing(source.readings()) as stream:
        async for readings in stream:
            if not parts:
                begin_s = readings[0].monotonic_s - 1 / surface.rate_hz
            parts.append(counts_of(readings))
            taken += len(readings)
            lost += sum(reading.lost for reading in readings)
            passed_s = readings[-1].monotonic_s - begin_s
            if passed_s >= seconds + (0.0 if taken >= needed else max(PATIENCE_S, seconds)):
                break
    if taken < needed:
        raise NotAtRestError(f"{taken} readings arrived and its filter needs {needed}; give a longer --seconds")
    return Recording(np.concatenate(parts), lost, passed_s)


def _measure(name: str, surface: Surface, recording: Recording, rest_mm: dict[str, float]) -> Measurement:
    """Return the noise of a recording; NotAtRestError if it does not show the noise at rest."""
    channels = measure_noise(select_rest(recording.counts, surface, rest_mm), surface)
    return Measurement(name, surface, recording, channels, keys_of(channels, surface))


def _as_json(measurement: Measurement) -> dict[str, object]:
    keys = measurement.keys
    scene: dict[str, object] = {"noise_mm": keys.scene_noise_mm, "zero_drift_mm": keys.zero_drift_mm}
    if keys.adc_bits is not None:
        scene["adc_bits"] = keys.adc_bits
    scene |= _places_of(measurement.settings)
    rate = keys.drift_um_per_min
    return {
        "error": None,
        "readings": len(measurement.recording.counts),
        "readings_lost": measurement.recording.lost,
        "seconds": measurement.recording.seconds,
        "filter": measurement.settings.filter.in_words,
        "channels": [
            {
                "channel": channel.channel,
                "noise_mm": channel.noise_mm,
                "correlation_ms": measurement.correlation_ms(channel),
                "effective_noise_mm": channel.effective_noise_mm,
                "drift_mm": channel.drift_mm,
                "step_mm": channel.step_mm,
                "steps_hide_noise": channel.is_rounded,
            }
            for channel in measurement.channels
        ],
        "daemon": {"noise_mm": keys.daemon_noise_mm, "stuck_after_ms": keys.stuck_after_ms},
        "scene": scene,
        "environment": {} if rate is None else {"drift_um_per_min": rate},
    }


def report(measurements: Sequence[Measurement]) -> list[str]:
    """Return the lines for people: a table of all channels, then the lines to paste for each surface."""
    head, ends = heads_with_unit(HEAD, OF_UNIT, [measurement.settings.value_unit for measurement in measurements])
    rows = [
        (
            measurement.surface,
            channel.channel,
            digits(channel.noise_mm, 3) + end,
            digits(measurement.correlation_ms(channel), 2),
            digits(channel.effective_noise_mm, 3) + end,
            digits(channel.drift_mm, 2) + end,
            digits(channel.step_mm, 3) + end if channel.step_mm else "-",
        )
        for measurement, end in zip(measurements, ends, strict=True)
        for channel in measurement.channels
    ]
    table = aligned(head, rows, right=range(2, len(head)))
    return [*table, *(line for measurement in measurements for line in _lines_to_paste(measurement))]


def _lines_to_paste(measurement: Measurement) -> list[str]:
    keys, name = measurement.keys, measurement.surface
    unit = "" if measurement.settings.value_unit == MM else f"        # in {measurement.settings.value_unit}"
    counts, lost, seconds = measurement.recording
    taken = f"{len(counts)} readings in {digits(seconds, 3)} s{f', {lost} lost' if lost else ''}"
    return [
        "",
        f"{name}: {taken}; effective noise for {measurement.settings.filter.in_words}",
        *_remarks(measurement),
        "",
        f"[surfaces.{json.dumps(name)}]        # in the daemon's configuration",
        f"noise_mm = {keys.daemon_noise_mm!r}{unit}",
        *(
            f"stuck_after_ms = {time!r}        # under the channel {channel}: noise_mm would call it stuck"
            for channel, time in keys.stuck_after_ms.items()
        ),
        "",
        "[sensors]        # in the scene, without noise_percent_of_max; then build the model again",
        f"noise_mm = {keys.scene_noise_mm!r}{unit}",
        f"zero_drift_mm = {keys.zero_drift_mm!r}        # {_drift_within(keys)}",
        *([] if keys.adc_bits is None else [f"adc_bits = {keys.adc_bits}"]),
        *_places(measurement.settings),
        *_drift(keys),
    ]


def _drift_within(keys: Keys) -> str:
    if keys.drift_um_per_min is None:
        return "within such a time; zeros drift further in a longer one"
    return "beside the drift that is followed"


def _drift(keys: Keys) -> list[str]:
    """Return the lines on the drift of the zeros, if the recording says how fast it is."""
    if not keys.drift_um_per_min:
        return []
    line = f"drift_um_per_min = {keys.drift_um_per_min!r}        # also in zero_tracking of the daemon's configuration"
    return ["", "[environment]        # in the scene", line]


def _places(surface: Surface) -> list[str]:
    """Return the line that keeps the sensors where they are mounted, if the configuration says where."""
    words = "where the sensors are mounted; without it, a new layout may move them"
    return [f"{key} = {_as_toml(places)}        # {words}" for key, places in _places_of(surface).items()]


def _places_of(surface: Surface) -> dict[str, list[float] | list[dict[str, float]]]:
    """Return the key of the scene that keeps the sensors where they are, and its value; empty if a place is missing."""
    places_mm = [channel.place_mm for channel in surface.channels]
    if not all(places_mm):
        return {}
    if surface.axes == BEAM_AXES:
        return {"fixed_mm": [place_mm[BEAM_AXIS] for place_mm in places_mm]}
    return {"fixed": [{f"{axis}_mm": at_mm for axis, at_mm in place_mm.items()} for place_mm in places_mm]}


def _as_toml(places: list[float] | list[dict[str, float]]) -> str:
    return f"[{', '.join(_inline(one) if isinstance(one, dict) else repr(one) for one in places)}]"


def _inline(place: dict[str, float]) -> str:
    return f"{{ {', '.join(f'{key} = {at_mm!r}' for key, at_mm in place.items())} }}"


def _remarks(measurement: Measurement) -> list[str]:
    remarks = []
    if hidden := [channel.channel for channel in measurement.channels if channel.is_rounded]:
        remarks.append(
            f"  {', '.join(hidden)}: the ADC's steps hide the noise, so a mean stays as wrong as a reading; "
            "a finer ADC or more noise would help"
        )
    if repeated := [channel for channel in measurement.channels if channel.is_repeated]:
        names, times = ", ".join(channel.channel for channel in repeated), min(channel.mean_run for channel in repeated)
        rate_hz = measurement.settings.rate_hz
        remarks.append(
            f"  {names}: values come about {digits(times, 2)} times in a row, "
            f"so they change {digits(rate_hz / times, 2)} times a second; set rate_hz to that, also in the scene"
        )
    if alike := [channel for channel in measurement.channels if channel.is_coloured]:
        times = max(channel.effective_noise_mm / channel.noise_mm for channel in alike)
        remarks.append(
            f"  {', '.join(channel.channel for channel in alike)}: successive readings are alike, so "
            f"{measurement.settings.filter.in_words} is up to {digits(times, 2)} times as noisy as with white noise"
        )
    return remarks
