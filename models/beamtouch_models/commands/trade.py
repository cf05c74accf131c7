"""`design-sensors trade`: measures what sensors, time, noise and estimators are worth in accuracy."""

import argparse
import json
import sys
from pathlib import Path

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
from beamtouch_models.printing import Result, markdown, note, show


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder for the tables, picture and JSON"
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
        help="print one JSON object on standard output; measured times (inference_us, latency_ms) differ from run to "
        "run, and on_front and sentences may differ with them",
    )


def run(options: argparse.Namespace) -> None:
    """Trade the scene, write the folder, and print what changes are worth, the front, and how to build its models."""
    from beamtouch_models.building.remarks import remarks
    from beamtouch_models.estimators.estimator import NAMES
    from beamtouch_models.scene import load_scene
    from beamtouch_models.trade.results import blocks, json_of, picture
    from beamtouch_models.trade.trade import trade
    from beamtouch_models.workers import spread_over

    scene, _ = load_scene(options.scene)
    note(*remarks(scene))
    folder, name = folder_of(options.output), surface_name(options.scene)
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        found = trade(
            scene,
            options.estimators or NAMES,
            draws=options.draws,
            seed=options.seed,
            spread=spread,
            progress=progress,
        )
    note(*map(str, found.failures))
    rows, fields = blocks(found, str(options.scene), options.seed, f"{name}.onnx"), json_of(found)
    title = f"Accuracy against speed: {name}"
    page = markdown(title, ["![error over sensors, time, noise and inference](trade.svg)", *rows])
    for file, text in (
        ("trade.json", json.dumps(fields, indent=1) + "\n"),
        ("trade.md", page),
        ("trade.svg", picture(name, found)),
    ):
        write_atomically(folder / file, text.encode())
    show(Result({"scene": str(options.scene), "output": str(folder), **fields}, rows), as_json=options.json)
    if not options.json:
        print(f"the picture and all {len(found.points)} points are in {folder}: trade.svg, trade.json", file=sys.stderr)
