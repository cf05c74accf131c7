"""`design-sensors trade`: what speed, sensors and samples buy in accuracy."""

import argparse
import json
import math
import sys

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from beamtouch_models.build import Choices, build
from beamtouch_models.commands.build import surface_name
from beamtouch_models.commands.progress import shown_progress
from beamtouch_models.commands.reproduce import folder_of
from beamtouch_models.errors import InputError
from beamtouch_models.estimators.estimator import NAMES
from beamtouch_models.export import write_whole
from beamtouch_models.scene import load_scene
from beamtouch_models.trade.front import most_accurate, named, pareto_front, quickest
from beamtouch_models.trade.physics import physics_trade
from beamtouch_models.trade.points import Point, measured_points
from beamtouch_models.trade.quantised import quantised
from beamtouch_models.trade.results import HEADINGS, json_of, markdown, plot, row

WIDTH_WITHOUT_TERMINAL = 180


def run(options: argparse.Namespace) -> None:
    """Measure every point, write the folder, print the front, and build the point that was asked for."""
    for option, value in (("--latency-ms", options.latency_ms), ("--error-mm", options.error_mm)):
        if value is not None and not 0 < value < math.inf:
            message = f"{option} {value:g}: give a positive number"
            raise InputError(message)
    scene, text = load_scene(options.scene)
    folder, name = folder_of(options.output), surface_name(options.scene)
    estimators = tuple(options.estimators or NAMES)
    with shown_progress() as progress:
        points = measured_points(scene, estimators, draws=options.draws, seed=options.seed, progress=progress)
        progress("leaving out physics", 1.0)
        physics = physics_trade(scene, draws=options.draws, seed=options.seed)
    front = pareto_front(points)
    results = json_of(points, front, physics)
    write_whole(folder / "trade.json", (json.dumps(results, indent=1) + "\n").encode())
    write_whole(folder / "trade.md", markdown(name, points, front, physics).encode())
    write_whole(folder / "trade.svg", plot(points, front).encode())
    picked = None
    if options.latency_ms is not None:
        picked = most_accurate(points, options.latency_ms)
    elif options.error_mm is not None:
        picked = quickest(points, options.error_mm)
    if picked is not None:
        choices = Choices(picked.estimator, picked.filter, quantised if picked.quantised else lambda graph: graph)
        with shown_progress() as progress:
            built = build(
                scene, text, name, count=picked.sensors, seed=options.seed, progress=progress, choices=choices
            )
        write_whole(folder / f"{name}.onnx", built.content)
    if options.json:
        chosen = None if picked is None else {"index": points.index(picked), "model": str(folder / f"{name}.onnx")}
        print(json.dumps({"output": str(folder), "picked": chosen, **results}))
        return
    _show(front, len(points))
    print(f"all of {len(points)} points in {folder}: trade.md, trade.svg, trade.json", file=sys.stderr)
    if picked is not None:
        print(f"built {folder / f'{name}.onnx'}: {named(picked)}; {picked.error_mm:.3g} mm, {picked.latency_ms:.3g} ms")


def _show(front: list[Point], points: int) -> None:
    console = Console(width=None if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL)
    table = Table(title=f"the front, {len(front)} of {points} points", box=SIMPLE_HEAD, title_justify="left")
    for heading in HEADINGS[1:]:
        table.add_column(heading, justify="left" if heading in ("estimator", "filter") else "right")
    for point in front:
        table.add_row(*row(point, on_front=True)[1:])
    console.print(table)
