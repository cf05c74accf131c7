"""`design-sensors new`: writes a commented scene."""

import argparse
import shlex
from dataclasses import fields
from pathlib import Path

from pydantic import ValidationError

from beamtouch_common.complaints import reason_of
from beamtouch_common.files import write_atomically
from beamtouch_models.commands.scenes import refuse_existing
from beamtouch_models.commands.shared import surface_name
from beamtouch_models.design.building.new_scene import Answers, scene_text
from beamtouch_models.design.printing import Result
from beamtouch_models.design.scene import parse_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.errors import SceneError


def run(options: argparse.Namespace) -> Result:
    """Write the scene, after it has been loaded and checked as `build` checks it."""
    target: Path = options.scene
    if target.suffix != ".toml":
        raise SceneError(f"{target}: give the scene a name that ends in .toml")
    refuse_existing(target, force=options.force)
    given = {field.name: getattr(options, field.name) for field in fields(Answers)}
    lists = {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
    text = _check(Answers(**{name: value for name, value in given.items() if value is not None} | lists), target)
    write_atomically(target, text.encode())
    typed = shlex.quote(str(target))
    build = f"design-sensors build {typed} -o MODEL.onnx --daemon-config daemon.toml"
    return Result({}, [f"{target}; next:\ndesign-sensors explain {typed}\n{build}"])


def _check(answers: Answers, target: Path) -> str:
    """Return the text of a scene that loads and can be built; SceneError or InputError if there is none."""
    for name in ("length", "width", "thickness"):  # before anything is computed with them
        given_mm = getattr(answers, f"{name}_mm")
        if not 0 < given_mm < float("inf"):
            raise SceneError(f"--{name}-mm {given_mm:g}: give millimetres, more than 0")
    if answers.position_mm is not None:
        low, high = answers.position_mm
        if not 0 <= low < high <= answers.length_mm:
            places = f"two places on the beam, 0..{answers.length_mm:g} mm, in order"
            raise SceneError(f"--position-mm {low:g} {high:g}: give {places}")
    low, high = answers.range_mm
    if not 0 < low < high < float("inf"):
        raise SceneError(f"--range-mm {low:g} {high:g}: give two gaps in mm, the smaller one first")
    try:
        text = scene_text(answers, surface_name(target))
    except ValidationError as error:
        rollers = "".join(f" --roller-mm {position_mm:g}" for position_mm in answers.roller_mm)
        reason = reason_of(error.errors()[0])
        raise SceneError(f"--left {answers.left} --right {answers.right}{rollers}: {reason}") from None
    resolve(parse_scene(text, str(target))).check()
    return text
