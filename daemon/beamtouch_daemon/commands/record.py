"""`record`: records known loads for `design-sensors calibrate`.

`calibrate` trusts what is recorded. So a load must be within the configured limits, it must deflect the beam visibly,
and it must not move while it is recorded. A load that the user accepts is recorded without these checks.
"""

import argparse
import asyncio
import shlex
import sys
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import aclosing, suppress
from dataclasses import replace

import numpy as np

from beamtouch_common.commands import DONE
from beamtouch_common.digits import digits
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.outline import BEAM_AXES
from beamtouch_common.typed import is_terminal, typed_line
from beamtouch_common.units import MM
from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.tare_file import NOT_TARED
from beamtouch_daemon.measuring.at_rest import NotAtRestError, describe_motion, noise_of, rest_gaps, steps_mm
from beamtouch_daemon.measuring.known_loads import Load, LoadFile, parse_load
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_daemon.processing.pipeline import Pipeline, TimedSample, counts_of
from beamtouch_daemon.sources.configured import source_of
from beamtouch_daemon.sources.reading import Reading, SourceError
from beamtouch_service.samples import Quality

MAX_SECONDS = 3600.0
SETTLED_S = 0.5
MIN_READINGS = 20
"""All channels must be steady for the longer of this time and this number of readings before a load is recorded."""
MIN_SAMPLES = 2
"""Smallest number of samples of a load; a single one cannot show whether the load was steady."""
GIVE_UP_S = 30.0
"""Limit on waiting for a load to settle, and on recording for longer than asked when readings are lost."""
VISIBLE_DEVIATIONS = 3.0
"""A load is visible if it deflects a channel by more than this, in standard deviations of one reading."""

ACCEPT, UNDO = "accept", "undo"
"""Answers: record a load without checks, and remove the load that was recorded last."""
HELP = f"""\
Put a load on the beam, then answer. Two more answers are possible:
  {UNDO:7} removes the last load. The recording ends with the last load of --at; to replace that one, record it again
          with --append and without --at
  {ACCEPT:7} after a load (or alone, with --at) records it without checks"""


class LoadRefusedError(Exception):
    """The load is not recorded; the text is one line with the reason."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError for wrong input, FailedError if a load was not recorded."""
    config = load_config(arguments.config)
    names, path = config.choose_surfaces(arguments.surface), arguments.output
    if len(names) > 1:
        raise InputError(f"--surface: choose one of {', '.join(names)}")
    if not 0 < arguments.seconds <= MAX_SECONDS:
        raise InputError(f"--seconds: give more than 0 and at most {MAX_SECONDS:g}")
    (name,) = names
    surface = config.surfaces[name]
    try:
        given = [parse_load(words, surface, is_accepted=arguments.accept) for words in arguments.at or ()]
    except ValueError as error:
        raise InputError(f"--at: {error}") from None
    rest_gap_mm = config.read_rest_gaps([name])[name]
    file = LoadFile(path, surface, append=arguments.append)
    if surface.loads is None:
        print(f"without [surfaces.{name}.loads], positions and forces are not checked", file=sys.stderr)
    if not rest_gap_mm:
        _say(f"{name}: {NOT_TARED}")
    if is_terminal():
        print(HELP, file=sys.stderr)
    dialogue = Dialogue(
        file, surface, lambda load: asyncio.run(record_load(surface, rest_gap_mm, load, arguments.seconds))
    )
    try:
        if given:
            dialogue.record_given(given)
        else:
            dialogue.record_stated()
    except SourceError as error:
        raise FailedError(f"{name}: {error}; {file}") from None
    if file.loads:
        print(f"{file.loads} loads in {path}; next: {_next_step(shlex.quote(str(path)), name, surface)}")
    _require_all(dialogue, file, name)
    return DONE


def _next_step(path: str, name: str, surface: Surface) -> str:
    """Return the command that takes the recording; a configuration that names no beam may have no model yet."""
    calibrate = f"design-sensors calibrate MODEL {path} -o MODEL"
    if surface.beam is not None:
        return calibrate
    return f"{calibrate}, or without a model design-sensors build --loads {path} -o {name}.onnx"


def _require_all(dialogue: "Dialogue", file: LoadFile, name: str) -> None:
    """Raise FailedError if loads were refused, or none was recorded."""
    if dialogue.refused:
        raise FailedError(f"{name}: not recorded: {', '.join(map(str, dialogue.refused))}; put them on again")
    if not file.loads:
        raise FailedError(f"{name}: {file}, so {file.path} is not written")


class Dialogue:
    """Asks for loads and records them. After a wrong answer, and a load that is refused, it asks again.

    Parameters
    ----------
    file : Where loads are written.
    surface : Its axes, and the loads that the model covers, if they are known.
    record : Returns the samples of a load; LoadRefusedError if it cannot be recorded.
    """

    def __init__(self, file: LoadFile, surface: Surface, record: Callable[[Load], list[TimedSample]]) -> None:
        self.refused: list[Load] = []
        """Loads that were refused or removed, and have not been recorded since."""
        self._file = file
        self._surface = surface
        self._samples_of = record

    def record_stated(self) -> None:
        """Record loads whose place and force are typed, until an empty line."""
        place = "position" if self._surface.axes == BEAM_AXES else "x and y"
        question = f"put it on, then enter {place} in mm and force in N (empty line: done; {UNDO})"
        count = len(self._surface.axes) + 1
        while words := self._ask(question).split():
            if words == [UNDO]:
                self._undo()
                continue
            is_accepted = words[count:] == [ACCEPT]
            try:
                load = parse_load(words[:count] if is_accepted else words, self._surface, is_accepted=is_accepted)
            except ValueError as error:
                _say(str(error))
            else:
                self._record(load)

    def record_given(self, given: Sequence[Load]) -> None:
        """Record these loads, each after Enter says that it is on."""
        begun = self._file.loads
        while (done := self._file.loads - begun) < len(given):
            load = given[done]
            answer = self._ask(f"put {load} on, then press Enter ({UNDO})")
            if not answer:
                return
            match answer.split():
                case []:
                    self._record(load)
                case ["accept"]:
                    self._record(replace(load, is_accepted=True))
                case ["undo"]:
                    self.refused += [removed for removed in [self._undo()] if removed]
                case _:
                    _say(f"{answer.strip()!r}: press Enter once the load is on, or type {UNDO} or {ACCEPT}")

    def _record(self, load: Load) -> None:
        try:
            samples = self._samples_of(load)
        except LoadRefusedError as error:
            self.refused += [] if load in self.refused else [load]
            _say(f"{load} not recorded: {error}; put it on again, or answer {ACCEPT} to record it without checks")
        else:
            self._file.write(load, samples)
            self.refused = [other for other in self.refused if other != load]
            _say(f"load {self._file.loads}: {load}, {len(samples)} samples")

    def _undo(self) -> Load | None:
        number, load = self._file.loads, self._file.remove_last()
        _say(f"load {number}, {load}, is removed" if load else "there is no load to remove")
        return load

    def _ask(self, question: str) -> str:
        """Return the answer to a question, with its line end; empty at the end of the answers."""
        end = "" if is_terminal() else "\n"
        print(f"load {self._file.loads + 1}: {question}: ", end=end, file=sys.stderr, flush=True)
        return typed_line()


async def record_load(surface: Surface, rest_gap_mm: dict[str, float], load: Load, seconds: float) -> list[TimedSample]:
    """Wait until the surface has settled, then return the samples of the next `seconds` [s].

    Lost readings are waited for, for up to `GIVE_UP_S`.

    Raises
    ------
    LoadRefusedError
        The surface did not settle within `GIVE_UP_S`, or the load moved, is not seen, or opens gaps.
    SourceError
        The source failed.
    """
    pipeline = Pipeline(surface, rest_gap_mm)
    samples: list[TimedSample] = []
    enough = max(MIN_SAMPLES, round(seconds * surface.rate_hz))
    async with aclosing(source_of(surface).readings()) as stream:
        if not load.is_accepted:
            await _settle(stream, pipeline, surface)
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds + GIVE_UP_S):
                async for readings in stream:
                    samples += pipeline.process(readings, time.time() - uptime_s())
                    if len(samples) >= enough:
                        break
    if not load.is_accepted:
        _require_still_and_seen([sample.reading for sample in samples], surface, rest_gap_mm)
    return samples


async def _settle(stream: AsyncIterator[list[Reading]], pipeline: Pipeline, surface: Surface) -> None:
    """Wait until the surface is steady, and fill its filter; LoadRefusedError if it is not within `GIVE_UP_S`."""
    recent: deque[Reading] = deque(maxlen=max(MIN_READINGS, round(SETTLED_S * surface.rate_hz)))
    reason = "no readings arrived"
    with suppress(TimeoutError):
        async with asyncio.timeout(GIVE_UP_S):
            async for readings in stream:
                pipeline.process(readings, time.time() - uptime_s())
                recent.extend(readings)
                if len(recent) < (recent.maxlen or 0):
                    continue
                try:
                    rest_gaps(counts_of(list(recent)), surface)
                except NotAtRestError as error:
                    reason = str(error).partition(";")[0]
                else:
                    return
    raise LoadRefusedError(f"not settled within {GIVE_UP_S:g} s: {reason}")


def _require_still_and_seen(readings: Sequence[Reading], surface: Surface, rest_gap_mm: dict[str, float]) -> None:
    """Raise LoadRefusedError if a channel moved, none deflects visibly, or the load lifts the beam."""
    characteristic = Characteristic.of(surface, rest_gap_mm)
    counts = counts_of(readings) if readings else np.empty((0, len(surface.channels)))
    good = characteristic.quality(counts) == QUALITIES.index(Quality.GOOD)
    deflections = characteristic.deflection(characteristic.gap(counts))
    is_seen, largest, channel, noise = False, 0.0, "", 0.0
    for index, (name, step) in enumerate(zip(surface.channel_names, steps_mm(counts, surface).tolist(), strict=True)):
        values = deflections[good[:, index], index]
        if len(values) < 2:
            continue
        if moved := describe_motion(values, step, surface):
            raise LoadRefusedError(f"the load moved while it was recorded: {name}, {moved}")
        mean, noise_mm = float(np.mean(values)), noise_of(values, surface.noise_mm)
        is_seen = is_seen or abs(mean) > VISIBLE_DEVIATIONS * noise_mm + step
        if not channel or abs(mean) > abs(largest):
            largest, channel, noise = mean, name, noise_mm
    message, unit = "", surface.value_unit
    if not channel:
        message = "no channel gave good readings"
    elif not is_seen:
        message = f"no load is seen: the largest deflection is {digits(abs(largest), 2)} {unit} ({channel}), noise "
        message += f"{digits(noise, 2)} {unit}"
    elif largest < 0 and unit == MM:
        message = f"the largest deflection is negative: {digits(largest, 2)} mm ({channel}), against the load, "
        message += "which is right only where an overhang lifts"
    if message:
        raise LoadRefusedError(message)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
