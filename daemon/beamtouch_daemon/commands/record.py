"""`record`: records known loads for `design-sensors calibrate`."""

import argparse
import asyncio
import sys

from beamtouch_common.commands import DONE, FAILED
from beamtouch_common.errors import FailedError, InputError
from beamtouch_common.typed import is_terminal
from beamtouch_daemon.commands.load_recorder import LoadRecorder, LoadRefusedError, require_stated
from beamtouch_daemon.commands.record_dialogue import ACCEPT, HELP, Dialogue, Undo, load_of
from beamtouch_daemon.commands.record_table import Load, Table, table
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config, Loads
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.tasks import cancel

MAX_SECONDS = 3600.0


def run(arguments: argparse.Namespace) -> int:
    """Run the command; InputError for wrong input, FailedError if a load was not recorded."""
    settings = load_config(arguments.config)
    names = ", ".join(settings.surfaces)
    name: str | None = arguments.surface or (names if len(settings.surfaces) == 1 else None)
    if name is None:
        message = f"--surface: choose one of {names}"
        raise InputError(message)
    if name not in settings.surfaces:
        message = f"--surface: there is no surface {name}; choose one of {names}"
        raise InputError(message)
    if not 0 < arguments.seconds <= MAX_SECONDS:
        message = f"--seconds: give more than 0 and at most {MAX_SECONDS:g}"
        raise InputError(message)
    try:
        given = _given(arguments, settings.surfaces[name].loads)
    except (ValueError, LoadRefusedError) as error:
        message = f"--at: {error}"
        raise InputError(message) from None
    return _record_to_file(settings, name, given, arguments)


def _given(arguments: argparse.Namespace, known: Loads | None) -> list[Load] | None:
    """Return the loads of --at, None without it."""
    if arguments.at is None:
        return None
    given = [load_of([*words, *([ACCEPT] * arguments.accept)]) for words in arguments.at]
    for load in given:
        require_stated(load, known)
    return given


def _record_to_file(settings: Config, name: str, given: list[Load] | None, arguments: argparse.Namespace) -> int:
    surface, path = settings.surfaces[name], arguments.output
    rest_gap_mm = tare_file.load(settings.tare_file(name), surface.channel_names)

    async def recorded(to: Table) -> list[Load]:
        dialogue = Dialogue(given, surface.loads)
        await record_loads(LoadRecorder(surface, rest_gap_mm), to, dialogue, arguments.seconds)
        return sorted(dialogue.not_recorded, key=str)

    with table(path, surface.channel_names, append=arguments.append) as to:
        if surface.loads is None:
            print(f"without [surfaces.{name}.loads], positions and forces are not checked", file=sys.stderr)
        if is_terminal():
            print(HELP, file=sys.stderr)
        try:
            not_recorded = asyncio.run(recorded(to))
        except SourceError as error:
            message = f"{name}: {error}; {to.loads} loads are in {path}"
            raise FailedError(message) from None
    print(f"{to.loads} loads in {path}; next: design-sensors calibrate MODEL {path} -o MODEL")
    if not_recorded:
        message = f"{name}: not recorded: {', '.join(map(str, not_recorded))}; put them on again"
        raise FailedError(message)
    return DONE if to.loads else FAILED


async def record_loads(recorder: LoadRecorder, to: Table, dialogue: Dialogue, seconds: float) -> None:
    """Record loads until the dialogue has no more; SourceError if the source fails."""
    following = asyncio.ensure_future(recorder.follow())
    recording = asyncio.ensure_future(_record_loads(recorder, to, dialogue, seconds))
    try:
        await asyncio.wait({following, recording}, return_when=asyncio.FIRST_COMPLETED)
        if following.done() and not recording.done():
            following.result()
        await recording
    finally:
        await cancel((recording, following))


async def _record_loads(recorder: LoadRecorder, to: Table, dialogue: Dialogue, seconds: float) -> None:
    while (load := await dialogue.next_load(to.loads + 1)) is not None:
        if isinstance(load, Undo):
            number, gone = to.loads, to.remove_last()
            dialogue.say("there is no load to remove" if gone is None else f"load {number}, {gone}, is removed")
            continue
        try:
            samples = await recorder.record(load, seconds)
        except LoadRefusedError as error:
            dialogue.refused(load, str(error))
        else:
            to.write(load, samples)
            dialogue.recorded(load, f"load {to.loads}: {load}, {len(samples)} samples")
