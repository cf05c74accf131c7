"""`design-sensors build`: builds the model file of a scene, and optionally a daemon configuration and a report."""

import argparse
import shlex
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from beamtouch_common.digits import digits
from beamtouch_common.files import require_writable
from beamtouch_models.commands.inspect import describe
from beamtouch_models.commands.place import aim_of
from beamtouch_models.commands.shared import shown_progress, surface_name
from beamtouch_models.design.building.build import build_model
from beamtouch_models.design.building.daemon_config import write_token_if_absent
from beamtouch_models.design.building.mounted import Mounted, find_mounted
from beamtouch_models.design.building.products import write_products
from beamtouch_models.design.building.remarks import missed_requirement, remarks, short_tare, weak_spot
from beamtouch_models.design.building.replaced import require_replaceable
from beamtouch_models.design.building.scene_of_loads import assumed_of, scene_of_loads
from beamtouch_models.design.building.stored import positions_in, scene_in, stored_in
from beamtouch_models.design.building.table_cost import describe_table_cost
from beamtouch_models.design.layout import Layout, keep_sensors, place_sensors
from beamtouch_models.design.placement.placing import Aim
from beamtouch_models.design.pricing.walk import walk_of
from beamtouch_models.design.printing import Result, note
from beamtouch_models.design.scene import Scene, format_scene, load_scene, parse_scene
from beamtouch_models.design.surface import Surface, resolve
from beamtouch_models.design.sweeps import Progress
from beamtouch_models.errors import ModelFileError, SceneError
from beamtouch_models.places import Place
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.description import unseen
from beamtouch_models.runtime.metadata_parts import LayoutErrors


@dataclass(frozen=True)
class _Asked:
    """The model to be built."""

    scene: Scene
    text: str
    name: str
    aim: Aim
    kept_mm: tuple[Place, ...]
    """Positions of sensors that are mounted already; none: the sensors are placed."""
    mounted: Mounted | None
    """The sensors of the files that are replaced."""


def run(options: argparse.Namespace) -> Result:
    """Build, write the requested files, and return the metadata of the model."""
    asked = _read(options)
    config: Path | None = options.daemon_config
    # A rebuilt model may replace the old one.
    source: Path = options.loads or options.scene
    is_replaced = source.suffix == ".onnx" and options.output.resolve() == source.resolve()
    require_writable((options.output, config, options.report), () if is_replaced else (source,))
    if not options.force:
        require_replaceable(options.output, config, options.report)
    note(*remarks(asked.scene), assumed_of(asked.scene) if options.loads else "", _kept(asked))
    with shown_progress() as progress:
        layout = _layout_of(asked, options, progress)
        built = build_model(
            layout,
            asked.name,
            text=asked.text,
            estimator=options.estimator,
            seed=options.seed,
            progress=progress,
        )
        write_products(built, model=options.output, config=config, report=options.report, progress=progress)
    if config is not None:
        files = source, options.output, write_token_if_absent(config.parent), config
        told = how_to_try(*(shlex.quote(str(path)) for path in files), is_recorded=bool(options.loads))
        print(told, file=sys.stderr)
    surface, metadata = layout.surface, built.metadata
    note(
        describe_table_cost(layout, options.seed),
        _assumed_errors(surface),
        missed_requirement(metadata, asked.scene),
        unseen(metadata),
    )
    moved = asked.mounted.moves_to(tuple(layout.placement.places)) if asked.mounted else ""
    short = short_tare(walk_of(metadata, surface.readings), metadata.unit)
    note(moved, weak_spot(metadata, asked.scene), short, kind="warning")
    note(*_not_modelled(surface))
    return describe(loading.load_bytes(built.content, str(options.output)))


def how_to_try(source: str, model: str, token: str, config: str, *, is_recorded: bool) -> str:
    """Return the commands that run a model; loads were recorded with a configuration that knows the real channels."""
    rig = f"beamtouch-rig {source} --model {model} --modbus-tcp 127.0.0.1:5020"
    service = f"beamtouch-service run --model {model} --write-token-file {token}"
    lines = [rig, service, f"beamtouch-daemon run {config}"]
    if is_recorded:
        lines = [
            service,
            f"copy beam, noise_mm, zero_drift_mm, filter, zero_tracking and loads of {config} into the",
            f"configuration that recorded {source}, then beamtouch-daemon run with it",
        ]
    return "try it:  " + "\n         ".join(lines)


def _assumed_errors(surface: Surface) -> str:
    """Return which errors the model takes forces and sensors to have where the scene does not state them."""
    sensors, readings = surface.scene.sensors, surface.readings
    um_per_min = digits(1e3 * readings.drift_mm_per_min, 3)
    tolerance = surface.scene.contact.assumed_tolerance_percent
    taken = [] if tolerance is None else [f"contact.force_tolerance_percent = {tolerance:g}"]
    taken += [] if sensors.gain_error_percent is not None else [f"sensors.gain_error_percent = {100 * readings.gain:g}"]
    taken += [] if sensors.zero_drift_mm is not None else [f"sensors.zero_drift_mm = {digits(readings.zero_mm, 2)}"]
    is_stated = surface.scene.environment.drift_um_per_min is not None
    taken += [] if is_stated else [f"environment.drift_um_per_min = {um_per_min}"]
    return f"not stated in the scene, so assumed: {', '.join(taken)}" if taken else ""


def _not_modelled(surface: Surface) -> Iterator[str]:
    """Yield each effect that the scene has and the model has not."""
    for effect in surface.effects:
        if effect.verdict == "not modelled" and effect.having is not None and effect.price is not None:
            yield f"{effect.name} is {digits(effect.price, 2)} times the noise but not modelled: {effect.reason}"


def _kept(asked: _Asked) -> str:
    """Say that the sensors stay where an earlier build placed them; empty if they do not."""
    if asked.mounted is None or not asked.kept_mm:
        return ""
    return (
        f"the sensors stay where {asked.mounted.file} has them, as they may be mounted; --move-sensors places them anew"
    )


def _layout_of(asked: _Asked, options: argparse.Namespace, progress: Progress) -> Layout:
    """Return the sensors where they are mounted, or placed."""
    surface = resolve(asked.scene)
    if asked.kept_mm:
        return keep_sensors(surface, asked.kept_mm, asked.aim)
    return place_sensors(
        surface,
        count=options.sensors,
        seed=options.seed,
        aim=asked.aim,
        progress=lambda _, done: progress("placing the sensors", 0.3 * done),
    )


def _read(options: argparse.Namespace) -> _Asked:
    """Read a scene file, or the scene in a model file of any version.

    The sensors of a model file, and those of the files that this build replaces, are mounted already: they stay, unless
    the options or the scene ask for other places.
    """
    path: Path = options.loads or options.scene
    aim = aim_of(options)
    placing = options.sensors, options.criterion, options.failed_percent
    asks_anew = options.move_sensors or placing != (None, None, None)
    if path.suffix != ".onnx" or options.loads:
        scene, text = _scene_of_loads(path) if options.loads else load_scene(path)
        mounted = find_mounted(surface_name(path), options.output, options.daemon_config)
        stays = mounted is not None and not asks_anew and mounted.fits(scene)
        return _Asked(scene, text, surface_name(path), aim, mounted.positions_mm if mounted and stays else (), mounted)
    content = loading.read(path)
    try:
        stored = stored_in(content)
        text, name = scene_in(stored)
        before = _aim_before(stored)
        kept_mm = () if asks_anew else positions_in(stored)
    except (ModelFileError, ValueError, TypeError, KeyError):
        raise SceneError(f"{path}: it is not a model file that holds its scene; give a scene (TOML)") from None
    if kept_mm:
        aim = replace(before, effort=aim.effort)
    return _Asked(parse_scene(text, f"the scene in {path}"), text, name, aim, kept_mm, None)


def _scene_of_loads(path: Path) -> tuple[Scene, str]:
    scene = scene_of_loads(path)
    return scene, format_scene(scene)


def _aim_before(stored: Mapping[str, Any]) -> Aim:
    """Return the aim of the layout in what a model file states; raises ValueError if it is none."""
    placed = stored.get("placed")
    if not placed:  # from before it was stated
        return Aim("eigenvalue-product")
    if "spare" in placed:  # of version 4, which knew all of the time and none
        share = 100.0 * placed["spare"] if placed["criterion"] == "position-error" else None
        placed = {key: value for key, value in placed.items() if key != "spare"} | {"failed_percent": share}
    before = LayoutErrors.model_validate(placed)
    return Aim(before.criterion, before.failed_percent)
