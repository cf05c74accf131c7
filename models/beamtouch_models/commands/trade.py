"""`design-sensors trade`: measures what sensors, time, noise and estimators are worth in accuracy."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_common.errors import InputError
from beamtouch_common.files import write_atomically
from beamtouch_models.commands.options import (
    ESTIMATORS,
    add_contacts,
    add_seed,
    add_workers,
    folder_of,
    shown_progress,
    surface_name,
)
from beamtouch_models.commands.printing import Block, Result, Table, show

if TYPE_CHECKING:
    from beamtouch_models.progress import Progress
    from beamtouch_models.scene import Scene
    from beamtouch_models.sweeps import Spread
    from beamtouch_models.trade.trade import Point, Trade


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "scene", type=Path, metavar="SCENE", help="scene file (TOML), or a folder: all scenes in it, one after another"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the tables, picture and JSON; for a folder of scenes, each gets its own folder in it",
    )
    wish = parser.add_mutually_exclusive_group()
    wish.add_argument(
        "--latency-ms", type=float, metavar="L", help="build the most accurate model that answers within L ms"
    )
    wish.add_argument(
        "--error-mm", type=float, metavar="E", help="build the quickest model with a mean error of at most E mm"
    )
    parser.add_argument(
        "--estimators",
        nargs="+",
        choices=ESTIMATORS,
        help="estimators to measure beside the default one (default: all)",
    )
    add_contacts(parser, "simulated contacts per model", 4096)
    add_workers(parser)
    add_seed(parser)
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object per scene, each on a line of standard output; measured times (times, latency_ms) "
        "differ from run to run, and on_front, picked and sentences may differ with them",
    )


def run(options: argparse.Namespace) -> None:
    """Trade each scene: write its folder, print what changes are worth and the front, and build what is asked for."""
    from beamtouch_models.building.remarks import remarks
    from beamtouch_models.errors import SceneError
    from beamtouch_models.scene import load_scene
    from beamtouch_models.trade.trade import NotToBeHadError
    from beamtouch_models.workers import spread_over

    for option, value in (("--latency-ms", options.latency_ms), ("--error-mm", options.error_mm)):
        if value is not None and not 0 < value < math.inf:
            message = f"{option} {value:g}: give a positive number"
            raise InputError(message)
    # All are loaded first: a mistake in the last scene should not cost the time of the others.
    scenes = [(path, folder, *load_scene(path)) for path, folder in _folders(options.scene, options.output)]
    for path, _, scene, _ in scenes:
        for remark in remarks(scene):
            print(f"note:    {path}: {remark}", file=sys.stderr)
    refused: list[str] = []
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        for path, folder, scene, text in scenes:
            try:
                _trade(path, folder, scene, text, options, spread, progress)
            except (SceneError, NotToBeHadError) as error:
                if len(scenes) == 1:
                    raise
                refused.append(f"{path}: {error}")
    if refused:
        message = f"{len(refused)} of {len(scenes)} scenes are not complete: {'; '.join(refused)}"
        raise InputError(message)


def _trade(
    path: Path,
    folder: Path,
    scene: Scene,
    text: str,
    options: argparse.Namespace,
    spread: Spread,
    progress: Progress,
) -> None:
    from beamtouch_models.building.build import Choices, build_model
    from beamtouch_models.estimators.estimator import NAMES
    from beamtouch_models.trade.results import json_of, markdown, picture
    from beamtouch_models.trade.trade import trade

    name = surface_name(path)
    folder_of(folder)
    found = trade(
        scene,
        options.estimators or NAMES,
        draws=options.draws,
        seed=options.seed,
        spread=spread,
        progress=lambda doing, done: progress(f"{name}: {doing}", done),
    )
    for failure in found.failures:
        print(f"note: {failure}", file=sys.stderr)
    write_atomically(folder / "trade.json", (json.dumps(json_of(found), indent=1) + "\n").encode())
    write_atomically(folder / "trade.md", markdown(name, found, str(path), options.seed).encode())
    write_atomically(folder / "trade.svg", picture(name, found).encode())
    picked = _pick(found, options)
    model = folder / f"{name}.onnx"
    if picked is not None:
        choices = Choices(picked.model.estimator)
        built = build_model(
            scene, text, name, count=picked.model.sensors, seed=options.seed, progress=progress, choices=choices
        )
        write_atomically(model, built.content)
    show(_result(path, folder, found, options.seed, picked), as_json=options.json)
    if not options.json:
        print(f"all {len(found.points)} points are in {folder}: trade.md, trade.svg, trade.json", file=sys.stderr)


def _pick(found: Trade, options: argparse.Namespace) -> Point | None:
    from beamtouch_models.trade.trade import most_accurate, quickest

    if options.latency_ms is not None:
        return most_accurate(found.points, options.latency_ms)
    return None if options.error_mm is None else quickest(found.points, options.error_mm)


def _result(scene: Path, folder: Path, found: Trade, seed: int, picked: Point | None) -> Result:
    """Return what each change is worth, the front, the command that builds the model, and what was built."""
    from beamtouch_models.trade.results import POINT_HEADINGS, command_of, json_of, point_row, sentences

    name = surface_name(scene)
    model = folder / f"{name}.onnx"
    title = f"{name}: the front, {len(found.front)} of {len(found.points)} points"
    front = [point_row(point, on_front=True)[1:] for point in found.front]
    rows: list[Block] = [
        *sentences(found),
        Table(POINT_HEADINGS[1:], front, title, text=("estimator",)),
        f"Build one: {command_of(found.own, str(scene), seed, str(model))}",
    ]
    built = None
    if picked is not None:
        built = {"index": found.points.index(picked), "model": str(model)}
        _, *cells = point_row(picked, on_front=True)
        rows.append(f"built {model}: {picked}; {cells[-1]} mm, {cells[-2]} ms")
    return Result({"scene": str(scene), "output": str(folder), "picked": built, **json_of(found)}, rows)


def _folders(stated: Path, output: Path) -> list[tuple[Path, Path]]:
    """Return the scenes to measure, each with the folder for its results."""
    if not stated.is_dir():
        return [(stated, output)]
    scenes = sorted(stated.glob("*.toml"))
    if not scenes:
        message = f"{stated}: there are no scenes (*.toml) in this folder"
        raise InputError(message)
    names = [surface_name(path) for path in scenes]
    for path, name in zip(scenes, names, strict=True):
        if names.count(name) > 1:
            message = f"{path}: another scene in this folder would also be called {name}; rename one of them"
            raise InputError(message)
    return [(path, output / name) for path, name in zip(scenes, names, strict=True)]
