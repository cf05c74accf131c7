"""Command line of the daemon. Exit 0: done; 1: failed; 2: wrong input, with one line that says what to do."""

import argparse
import asyncio
import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_daemon import logs

if TYPE_CHECKING:
    from beamtouch_daemon.commands.once import SurfaceState
    from beamtouch_daemon.running.surface_worker import Summary

DONE, FAILED, WRONG_INPUT = 0, 1, 2
INTERRUPTED = 130
LONGEST_RECORDING_S = 3600.0
_EXTRA_MODULES = {"numpy", "serial", "pymodbus", "cobs", "aiohttp", "prometheus_client"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    arguments = _parser().parse_args(argv)
    logs.set_up(as_json=getattr(arguments, "log_format", "text") == "json")
    try:
        from beamtouch_daemon.config.settings import ConfigError  # noqa: PLC0415 - needs the extra, which may be missing

        try:
            code: int = arguments.command(arguments)
        except ConfigError as error:
            return _complain(str(error), WRONG_INPUT)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in _EXTRA_MODULES:
            raise
        return _complain(f"{error.name} is not installed: pip install 'beamtouch[daemon]'", WRONG_INPUT)
    except KeyboardInterrupt:
        return INTERRUPTED
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="beamtouch-daemon", description="Read the sensors and publish samples.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, function, text in (
        ("run", _run, "read all surfaces and publish their samples until stopped"),
        ("check", _check, "read every channel once and print what it gives"),
        ("tare", _tare, "measure the rest gaps, with nothing on the beam"),
        ("record", _record, "record known loads for design-sensors calibrate"),
    ):
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        command.add_argument("config", metavar="CONFIG", type=Path, help="configuration file (TOML)")
        command.set_defaults(command=function)
        if name == "run":
            command.add_argument("--summary", metavar="FILE", type=Path, help="write the final counts to FILE (JSON)")
            command.add_argument(
                "--log-format", choices=("text", "json"), default="text", help="of the log on standard error"
            )
        elif name == "check":
            command.add_argument("--json", action="store_true", help="print one JSON object")
        else:
            command.add_argument("--surface", metavar="NAME", help="this surface only")
        if name == "tare":
            command.add_argument(
                "--accept-change",
                action="store_true",
                help="take rest gaps also where they contradict the last tare or the configuration: "
                "after sensors were moved",
            )
        if name == "record":
            _add_record(command)
    return parser


def _add_record(command: argparse.ArgumentParser) -> None:
    command.add_argument("-o", "--output", metavar="FILE.csv", type=Path, required=True, help="file to write")
    command.add_argument("--append", action="store_true", help="add to a file that is there already")
    command.add_argument(
        "--at",
        nargs=2,
        action="append",
        metavar=("MM", "N"),
        help="a load: position and force; may be given several times, instead of typing them when asked",
    )
    command.add_argument(
        "--accept",
        action="store_true",
        help="record the loads of --at whatever speaks against them: off the beam, too heavy, not seen, not still",
    )
    command.add_argument(
        "--seconds", type=float, default=2.0, metavar="S", help="how long each load is recorded (default 2)"
    )


def _run(arguments: argparse.Namespace) -> int:
    from beamtouch_daemon.running import runtime  # noqa: PLC0415

    summary_file: Path | None = arguments.summary
    if summary_file and not summary_file.parent.is_dir():
        return _complain(f"--summary: {summary_file.parent} is not a directory", WRONG_INPUT)
    summaries = asyncio.run(runtime.run(arguments.config))
    for name, summary in summaries.items():
        _print_summary(name, summary)
    return _write_summary(summary_file, summaries) if summary_file else DONE


def _print_summary(name: str, summary: "Summary") -> None:
    print(
        f"{name}: {summary.readings} readings taken, {summary.readings_lost} lost; "
        f"{summary.samples_published} samples published, {summary.samples_dropped} dropped"
        + (f", {summary.samples_set_aside} set aside in the spool" if summary.samples_set_aside else "")
        + (f", {summary.samples_spooled} kept on disk for the next start" if summary.samples_spooled else ""),
        file=sys.stderr,
    )


def _write_summary(path: Path, summaries: dict[str, "Summary"]) -> int:
    from beamtouch_daemon.processing import tare  # noqa: PLC0415

    content = {"surfaces": {name: dataclasses.asdict(summary) for name, summary in summaries.items()}}
    try:
        tare.write_atomically(path, json.dumps(content, indent=2) + "\n")
    except OSError as error:
        return _complain(f"--summary: cannot write {path}: {error.strerror}", FAILED)
    return DONE


def _check(arguments: argparse.Namespace) -> int:
    from beamtouch_daemon.commands import once  # noqa: PLC0415
    from beamtouch_daemon.config import file as config_file  # noqa: PLC0415

    settings = config_file.load(arguments.config)
    config_file.require_ports(settings)
    states = asyncio.run(once.check(settings))
    if arguments.json:
        surfaces = {
            state.surface: {
                "error": state.error,
                "channels": [dataclasses.asdict(c) for c in state.channels],
                "limits": state.limits,
            }
            for state in states
        }
        print(json.dumps({"good": all(state.is_good for state in states), "surfaces": surfaces}))
    else:
        _print_table(states)
        for state in states:
            for limit in state.limits:
                print(f"{state.surface}: {limit}")
    for state in states:
        if state.error:
            _complain(f"{state.surface}: {state.error}", FAILED)
    return DONE if all(state.is_good for state in states) else FAILED


def _print_table(states: Sequence["SurfaceState"]) -> None:
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


def _tare(arguments: argparse.Namespace) -> int:
    from beamtouch_daemon.commands import once  # noqa: PLC0415
    from beamtouch_daemon.config import file as config_file  # noqa: PLC0415
    from beamtouch_daemon.config.settings import ConfigError  # noqa: PLC0415
    from beamtouch_daemon.processing import tare  # noqa: PLC0415
    from beamtouch_daemon.sources.reading import SourceError  # noqa: PLC0415

    settings = config_file.load(arguments.config)
    chosen: str | None = arguments.surface
    if chosen is not None and chosen not in settings.surfaces:
        names = ", ".join(settings.surfaces)
        return _complain(f"--surface: there is no {chosen}; the configuration has {names}", WRONG_INPUT)
    config_file.require_ports(settings)
    code = DONE
    for name in [chosen] if chosen else list(settings.surfaces):
        path, surface = settings.tare_file(name), settings.surfaces[name]
        try:
            last_mm = tare.load(path, surface.channel_names)
        except ConfigError:
            last_mm = {}  # it is replaced
        accept: bool = arguments.accept_change
        try:
            gaps, readings = asyncio.run(once.measure_rest(surface, last_mm, accept_change=accept))
            tare.save(path, name, readings, gaps)
        except (SourceError, tare.TareRefusedError) as error:
            code = _complain(f"{name}: not tared: {error}", FAILED)
        except OSError as error:
            code = _complain(f"{name}: cannot write {path}: {error.strerror}", FAILED)
        else:
            text = ", ".join(f"{channel} {gap:.4f} mm" for channel, gap in gaps.items())
            print(f"{name}: rest gaps {text}, mean of {readings} readings, in {path}")
    return code


def _record(arguments: argparse.Namespace) -> int:
    from beamtouch_daemon.commands import record, record_table  # noqa: PLC0415
    from beamtouch_daemon.commands.record_dialogue import HELP, Dialogue, load_of  # noqa: PLC0415
    from beamtouch_daemon.config import file as config_file  # noqa: PLC0415
    from beamtouch_daemon.processing import tare  # noqa: PLC0415
    from beamtouch_daemon.sources.reading import SourceError  # noqa: PLC0415

    settings = config_file.load(arguments.config)
    names = ", ".join(settings.surfaces)
    name: str | None = arguments.surface or (names if len(settings.surfaces) == 1 else None)
    if name not in settings.surfaces:
        return _complain(f"--surface: name one of {names}", WRONG_INPUT)
    if not 0 < arguments.seconds <= LONGEST_RECORDING_S:
        return _complain(f"--seconds: give more than 0 and at most {LONGEST_RECORDING_S:g}", WRONG_INPUT)
    surface = settings.surfaces[name]
    try:
        at: list[list[str]] | None = arguments.at
        given = None if at is None else [load_of([*words, *(["accept"] * arguments.accept)]) for words in at]
        for load in given or []:
            record.require_stated(load, surface.loads)
    except (ValueError, record.LoadRefusedError) as error:
        return _complain(f"--at: {error}", WRONG_INPUT)
    config_file.require_ports(settings)
    rest_gap_mm = tare.load(settings.tare_file(name), surface.channel_names)

    async def recorded(to: record_table.Table) -> list[record_table.Load]:
        recorder = record.Recorder(surface, rest_gap_mm)
        person = Dialogue(given, surface.loads)
        await record.record_loads(recorder, to, person, arguments.seconds)
        return sorted(person.missing, key=str)

    with record_table.table(arguments.output, surface.channel_names, append=arguments.append) as to:
        if surface.loads is None:
            print(f"without [surfaces.{name}.loads], positions and forces are not checked", file=sys.stderr)
        if sys.stdin.isatty():
            print(HELP, file=sys.stderr)
        try:
            missing = asyncio.run(recorded(to))
        except SourceError as error:
            return _complain(f"{name}: {error}; {to.loads} loads are in {arguments.output}", FAILED)
    print(f"{to.loads} loads in {arguments.output}; next: design-sensors calibrate MODEL {arguments.output} -o MODEL")
    if missing:
        return _complain(f"{name}: not recorded: {', '.join(map(str, missing))}; put them on again", FAILED)
    return DONE if to.loads else FAILED


def _complain(text: str, code: int) -> int:
    """Print one line to standard error and return `code`."""
    print(f"beamtouch-daemon: {' '.join(text.split())}", file=sys.stderr)
    return code
