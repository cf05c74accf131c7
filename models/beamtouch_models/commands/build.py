"""`design-sensors build`: builds the model file of a scene, and optionally a daemon configuration and a report."""

import argparse
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

from beamtouch_common.digits import digits
from beamtouch_common.files import require_writable
from beamtouch_models.commands.inspect import describe
from beamtouch_models.commands.place import aim_of
from beamtouch_models.commands.shared import shown_progress, surface_name
from beamtouch_models.design.building.build import Choices, build_model
from beamtouch_models.design.building.daemon_config import write_token_if_absent
from beamtouch_models.design.building.mounted import Mounted, find_mounted
from beamtouch_models.design.building.products import write_products
from beamtouch_models.design.building.remarks import missed_requirement, remarks, short_tare, weak_spot
from beamtouch_models.design.building.replaced import require_replaceable
from beamtouch_models.design.building.stored import positions_in, scene_in, stored_in
from beamtouch_models.design.placement.placing import Aim
from beamtouch_models.design.pricing.walk import walk_of
from beamtouch_models.design.printing import Result, note
from beamtouch_models.design.scene import Scene, load_scene, parse_scene
from beamtouch_models.design.surface import Surface
from beamtouch_models.errors import ModelFileError, SceneError
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.description import unseen
from beamtouch_models.runtime.metadata import LayoutErrors


def run(options: argparse.Namespace) -> Result:
    """Build, write the requested files, and return the metadata of the model."""
    scene, text, name, choices, mounted = _scene_of(options)
    config: Path | None = options.daemon_config
    is_rebuilt = options.scene.suffix == ".onnx"  # a rebuilt model may replace the old one
    require_writable((options.output, config, options.report), () if is_rebuilt else (options.scene,))
    if not options.force:
        require_replaceable(options.output, config, options.report)
    note(*remarks(scene), _kept(choices, mounted))
    with shown_progress() as progress:
        built = build_model(
            scene, text, name, count=options.sensors, seed=options.seed, progress=progress, choices=choices
        )
        write_products(scene, built, model=options.output, config=config, report=options.report, progress=progress)
    if config is not None:
        files = options.scene, options.output, write_token_if_absent(config.parent), config
        read, model, token, told = (shlex.quote(str(path)) for path in files)
        print(
            f"try it:  beamtouch-rig {read} --model {model} --modbus-tcp 127.0.0.1:5020\n"
            f"         beamtouch-service run --model {model} --write-token-file {token}\n"
            f"         beamtouch-daemon run {told}",
            file=sys.stderr,
        )
    note(_assumed_errors(built.surface), missed_requirement(built.metadata, scene), unseen(built.metadata))
    moved = mounted.moves_to(built.placement.positions_mm) if mounted else ""
    tare = short_tare(walk_of(built.metadata, built.surface.readings))
    note(moved, weak_spot(built.metadata), tare, kind="warning")
    note(*_not_modelled(built.surface))
    return describe(loading.load_bytes(built.content, str(options.output)))


def _assumed_errors(surface: Surface) -> str:
    """Return which errors the model takes the sensors to have where the scene does not state them."""
    sensors, readings = surface.stated.sensors, surface.readings
    um_per_min = digits(1e3 * readings.drift_mm_per_min, 3)
    taken = [] if sensors.gain_error_percent is not None else [f"sensors.gain_error_percent = {100 * readings.gain:g}"]
    taken += [] if sensors.zero_drift_mm is not None else [f"sensors.zero_drift_mm = {digits(readings.zero_mm, 2)}"]
    is_stated = surface.stated.environment.drift_um_per_min is not None
    taken += [] if is_stated else [f"environment.drift_um_per_min = {um_per_min}"]
    return f"not stated in the scene, so assumed: {', '.join(taken)}" if taken else ""


def _not_modelled(surface: Surface) -> Iterator[str]:
    """Yield each effect that the scene has and the model has not."""
    for effect in surface.effects:
        if effect.verdict == "not modelled" and effect.having is not None and effect.price is not None:
            yield f"{effect.name} is {digits(effect.price, 2)} times the noise but not modelled: {effect.reason}"


def _kept(choices: Choices, mounted: Mounted | None) -> str:
    """Say that the sensors stay where an earlier build placed them; empty if they do not."""
    if mounted is None or not choices.kept_mm:
        return ""
    return f"the sensors stay where {mounted.file} has them, as they may be mounted; --move-sensors places them anew"


def _scene_of(options: argparse.Namespace) -> tuple[Scene, str, str, Choices, Mounted | None]:
    """Return the scene of a scene file, or of a model file of any version, with its text, name and choices.

    The sensors of a model file, and those of the files that this build replaces, are mounted already: they stay, unless
    the options or the scene ask for other places. Returned last are the sensors of the files that are replaced.
    """
    path: Path = options.scene
    aim, kept_mm = aim_of(options), tuple[float, ...]()
    asks_anew = options.move_sensors or (options.sensors, options.criterion, options.spare) != (None, None, None)
    if path.suffix != ".onnx":
        scene, text = load_scene(path)
        mounted = find_mounted(surface_name(path), options.output, options.daemon_config)
        if mounted and not asks_anew and not mounted.conflict_with(scene):
            kept_mm = mounted.positions_mm
        choices = Choices(estimator=options.estimator, aim=aim, kept_mm=kept_mm)
        return scene, text, surface_name(path), choices, mounted
    content = loading.read(path)
    try:
        stored = stored_in(content)
        text, name = scene_in(stored)
        # Models from before it was stated have the layout of the product.
        placed = stored.get("placed")
        before = LayoutErrors.model_validate(placed) if placed else Aim("eigenvalue-product")
        if not asks_anew:
            kept_mm = positions_in(stored)
            aim = Aim(before.criterion, before.spare, effort=aim.effort)
    except (ModelFileError, ValueError):
        raise SceneError(f"{path}: it is not a model file that holds its scene; give a scene (TOML)") from None
    choices = Choices(estimator=options.estimator, aim=aim, kept_mm=kept_mm)
    return parse_scene(text, f"the scene in {path}"), text, name, choices, None
