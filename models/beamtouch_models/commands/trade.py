"""`design-sensors trade`: measures what sensors, time, noise and estimators are worth in accuracy."""

import argparse
import json
import math
from dataclasses import replace

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.files import write_atomically
from beamtouch_models.commands.shared import folder_of, shown_progress, surface_name
from beamtouch_models.commands.workers import spread_over
from beamtouch_models.design.building.build import build_model
from beamtouch_models.design.building.remarks import remarks
from beamtouch_models.design.building.replaced import require_replaceable
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.layout import place_sensors
from beamtouch_models.design.placement.placing import DEFAULT_AIM
from beamtouch_models.design.printing import Result, markdown, note
from beamtouch_models.design.scene import load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.lab.trade.results import blocks, json_of, picture
from beamtouch_models.lab.trade.trade import Point, Trade, most_accurate, quickest, trade
from beamtouch_models.names import ESTIMATORS


def run(options: argparse.Namespace) -> Result:
    """Trade the scene and write the folder; the result is what changes are worth, the front, and how to build it."""
    for option, value in (("--latency-ms", options.latency_ms), ("--error-mm", options.error_mm)):
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"{option} {value:g}: give a positive number")
    effort, (scene, text) = Effort(options.effort), load_scene(options.scene)
    note(*remarks(scene))
    folder, name = folder_of(options.output), surface_name(options.scene)
    if (options.latency_ms, options.error_mm) != (None, None):
        require_replaceable(folder / f"{name}.onnx", instead="name another folder")
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        measured_trade = trade(
            scene,
            options.estimators or (ESTIMATORS[:1] if scene.has_two_axes else ESTIMATORS),  # networks know one axis
            draws=options.draws,
            seed=options.seed,
            spread=spread,
            progress=progress,
            effort=effort,
        )
    note(*map(str, measured_trade.failures))
    rows, fields = blocks(measured_trade, str(options.scene), options.seed, f"{name}.onnx"), json_of(measured_trade)
    title = f"Accuracy against speed: {name}"
    page = markdown(title, ["![error over sensors, time, noise and inference](trade.svg)", *rows])
    for file, content in (
        ("trade.json", json.dumps(fields, indent=1) + "\n"),
        ("trade.md", page),
        ("trade.svg", picture(name, measured_trade)),
    ):
        write_atomically(folder / file, content.encode())
    picked, built = _pick(measured_trade, options), None
    if picked is not None:
        path, model, estimator = folder / f"{name}.onnx", picked.model, picked.model.task.estimator
        aim, seed = replace(DEFAULT_AIM, effort=effort), options.seed
        with shown_progress() as progress:
            layout = place_sensors(resolve(scene), count=model.sensors, seed=seed, aim=aim, progress=progress)
            made = build_model(layout, name, text=text, estimator=estimator, seed=seed, progress=progress)
        write_atomically(path, made.content)
        built = {"index": measured_trade.points.index(picked), "model": str(path)}
        error, latency = digits(picked.error_mm.value, 3), digits(picked.latency_ms, 3)
        rows.append(f"built {path}: {estimator}, {model.sensors} sensors, {error} mm, {latency} ms")
    fields = {"scene": str(options.scene), "output": str(folder), "picked": built, **fields}
    return Result(
        fields, rows, f"the picture and all {len(measured_trade.points)} points are in {folder}: trade.svg, trade.json"
    )


def _pick(found: Trade, options: argparse.Namespace) -> Point | None:
    """Return the point that the options ask for; None if they ask for none."""
    if options.latency_ms is not None:
        return most_accurate(found.points, options.latency_ms)
    return None if options.error_mm is None else quickest(found.points, options.error_mm)
