"""`design-sensors trade`: measures accuracy against speed, number of sensors and filter."""

import argparse
import json
import math
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from beamtouch_common.errors import InputError
from beamtouch_common.files import write_atomically
from beamtouch_models import loading
from beamtouch_models.building.build import Choices, build
from beamtouch_models.commands.build import surface_name
from beamtouch_models.commands.progress import shown_progress
from beamtouch_models.commands.reproduce import folder_of
from beamtouch_models.errors import ModelFileError
from beamtouch_models.estimators.estimator import NAMES
from beamtouch_models.pricing.noise import growing
from beamtouch_models.scene import Scene, load_scene
from beamtouch_models.trade.front import most_accurate, named, pareto_front, quickest
from beamtouch_models.trade.physics import EffectLeftOut, physics_trade
from beamtouch_models.trade.plots import plot, since_touch_plot
from beamtouch_models.trade.point import Point, Trade
from beamtouch_models.trade.points import measured_points
from beamtouch_models.trade.quantised import quantised
from beamtouch_models.trade.results import HEADINGS, json_of, markdown, row, said
from beamtouch_models.trade.since_touch import Curve, curves

WIDTH_WITHOUT_TERMINAL = 180

Kept = tuple[Trade, list[EffectLeftOut], list[Curve]]
"""The results that the folder has."""


def run(options: argparse.Namespace) -> None:
    """Measure every point, write the folder, print the front, and build the requested point."""
    for option, value in (("--latency-ms", options.latency_ms), ("--error-mm", options.error_mm)):
        if value is not None and not 0 < value < math.inf:
            message = f"{option} {value:g}: give a positive number"
            raise InputError(message)
    kept: list[Kept] = []
    try:
        with _termination_interrupts():
            _run(options, kept)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(_interrupted(kept, options)) from None


def _run(options: argparse.Namespace, kept: list[Kept]) -> None:
    """Do the work of `run`; `kept` always holds the newest results."""
    scene, text = load_scene(options.scene)
    folder, name = folder_of(options.output), surface_name(options.scene)
    trade, physics, found = _measured(scene, name, folder, options, kept)
    points, front = trade.points, pareto_front(trade.points)
    results = _keep(folder, name, (trade, physics, found), kept)
    for failure in trade.failures:
        print(f"note: {said(failure)}", file=sys.stderr)
    picked = _build_picked(scene, text, name, folder, options, points)
    if options.json:
        chosen = None if picked is None else {"index": points.index(picked), "model": str(folder / f"{name}.onnx")}
        print(json.dumps({"output": str(folder), "picked": chosen, **results}))
        return
    _show(front, len(points))
    print(
        f"all {len(points)} points are in {folder}: trade.md, trade.svg, since-touch.svg, trade.json", file=sys.stderr
    )
    if picked is not None:
        print(f"built {folder / f'{name}.onnx'}: {named(picked)}; {picked.error_mm:.3g} mm, {picked.latency_ms:.3g} ms")


def _build_picked(
    scene: Scene, text: str, name: str, folder: Path, options: argparse.Namespace, points: Sequence[Point]
) -> Point | None:
    """Write the model of the best point within the bound of the options; return that point, None without one."""
    left = list(points)
    while left:
        picked = None
        if options.latency_ms is not None:
            picked = most_accurate(left, options.latency_ms)
        elif options.error_mm is not None:
            picked = quickest(left, options.error_mm)
        if picked is None:
            return None
        choices = Choices(
            picked.estimator, growing(scene, picked.filter), quantised if picked.quantised else lambda graph: graph
        )
        with shown_progress() as progress:
            built = build(
                scene, text, name, count=picked.sensors, seed=options.seed, progress=progress, choices=choices
            )
        try:
            loading.load_bytes(built.content, named(picked))
        except ModelFileError as error:
            # Answers of 8-bit weights may depend on how a machine rounds.
            print(f"note: not built: {error}", file=sys.stderr)
            left.remove(picked)
            continue
        write_atomically(folder / f"{name}.onnx", built.content)
        return picked
    return None


def _measured(scene: Scene, name: str, folder: Path, options: argparse.Namespace, kept: list[Kept]) -> Kept:
    """Measure all points and effects; the folder always has the results so far."""
    estimators = tuple(options.estimators or NAMES)

    def keep(trade: Trade) -> None:
        _keep(folder, name, (trade, [], []), kept)

    with shown_progress() as progress:
        trade = measured_points(scene, estimators, draws=options.draws, seed=options.seed, progress=progress, keep=keep)
        keep(trade)
        counts = sorted({point.sensors for point in trade.points})

        def following(done: float) -> None:
            progress("following touches", done)

        found = curves(scene, counts, draws=options.draws, seed=options.seed, progress=following)
        _keep(folder, name, (trade, [], found), kept)
        progress("leaving out effects", 1.0)
        return trade, physics_trade(scene, draws=options.draws, seed=options.seed), found


def _keep(folder: Path, name: str, found: Kept, kept: list[Kept]) -> dict[str, Any]:
    """Write the results so far, and keep them for an interruption; returns the content of trade.json."""
    # Kept before they are written: after an interruption between two files, all are written again.
    kept[:] = [found]
    return _write(folder, name, found)


def _write(folder: Path, name: str, kept: Kept) -> dict[str, Any]:
    """Write the results so far, each file as a whole; returns the content of trade.json."""
    trade, physics, found = kept
    front = pareto_front(trade.points)
    results = json_of(trade, front, physics, found)
    write_atomically(folder / "trade.json", (json.dumps(results, indent=1) + "\n").encode())
    write_atomically(folder / "trade.md", markdown(name, trade, front, physics, found).encode())
    write_atomically(folder / "trade.svg", plot(trade.points, front).encode())
    if found:
        write_atomically(folder / "since-touch.svg", since_touch_plot(found, trade.points).encode())
    return results


def _interrupted(kept: list[Kept], options: argparse.Namespace) -> str:
    """Write the kept results, as the interruption may have come between two files; returns the message."""
    if not kept:
        return "interrupted before the first point; nothing was written"
    (found,) = kept
    trade = found[0]
    _write(options.output, surface_name(options.scene), found)
    return f"interrupted; {len(trade.points)} of {trade.planned} points are in {options.output}"


@contextmanager
def _termination_interrupts() -> Iterator[None]:
    """Treat SIGTERM like Ctrl-C, so that both report what was kept."""

    def interrupt(_signal: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _show(front: list[Point], points: int) -> None:
    console = Console(width=None if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL)
    table = Table(title=f"the front, {len(front)} of {points} points", box=SIMPLE_HEAD, title_justify="left")
    for heading in HEADINGS[1:]:
        table.add_column(heading, justify="left" if heading in ("estimator", "filter") else "right")
    for point in front:
        table.add_row(*row(point, on_front=True)[1:])
    console.print(table)
