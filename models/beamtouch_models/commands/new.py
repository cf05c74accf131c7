"""`design-sensors new`: writes a commented scene."""

from __future__ import annotations

import argparse
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from beamtouch_common.commands import whole_number
from beamtouch_common.files import require_writable, write_atomically
from beamtouch_models.commands.options import surface_name
from beamtouch_models.errors import SceneError
from beamtouch_models.printing import Result
from beamtouch_models.scene.materials import MATERIALS

if TYPE_CHECKING:
    from beamtouch_models.building.new_scene import Answers

ENDS = ("clamped", "pinned", "roller", "free")
"""The kinds of `building.new_scene.End`, which takes too long to import for --help."""
NEEDED = ("length_mm", "width_mm", "thickness_mm")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("scene", type=Path, metavar="NAME.toml", help="scene file to write")
    for name, text in zip(NEEDED, ("length of the beam", "its width", "its thickness"), strict=True):
        parser.add_argument(_option(name), type=float, required=True, metavar="MM", help=text)
    parser.add_argument("--material", choices=tuple(MATERIALS), help="its material (default: steel)")
    parser.add_argument("--left", choices=ENDS, help="how its left end is held (default: pinned)")
    parser.add_argument("--right", choices=ENDS, help="how its right end is held (default: roller)")
    words = "place of a roller between the ends; may be repeated"
    parser.add_argument("--roller-mm", type=float, action="append", metavar="MM", help=words)
    _add_range(
        parser, "--force-n", "smallest and largest force of a contact (default: what uses a third of --range-mm)"
    )
    _add_range(
        parser, "--position-mm", "where contacts may be (default: from end to end, save next to one that is held)"
    )
    parser.add_argument("--sensors", type=whole_number(1, 64), metavar="N", help="number of sensors (default: 4)")
    words = "standard deviation of a reading (default: 0.005)"
    parser.add_argument("--noise-mm", type=float, metavar="MM", help=words)
    parser.add_argument("--rate-hz", type=float, metavar="HZ", help="readings per second (default: 200)")
    _add_range(parser, "--range-mm", "gaps over which the sensors are linear (default: 1 4)")
    words = "width of a sensor's housing along the beam (default: 8)"
    parser.add_argument("--size-mm", type=float, metavar="MM", help=words)
    parser.add_argument("--latency-ms", type=float, metavar="MS", help="time of filtering (default: 20)")
    parser.add_argument("--position-error-mm", type=float, metavar="MM", help="largest mean error (default: any)")
    parser.add_argument("--force", action="store_true", help="replace a file that exists")


def _add_range(parser: argparse.ArgumentParser, name: str, words: str) -> None:
    parser.add_argument(name, type=float, nargs=2, metavar=("LOW", "HIGH"), help=words)


def _option(name: str) -> str:
    """Return the option of an answer."""
    return f"--{name.replace('_', '-')}"


def run(options: argparse.Namespace) -> Result:
    """Write the scene, after it has been loaded and checked as `build` checks it."""
    from beamtouch_models.building.new_scene import Answers

    target: Path = options.scene
    if target.suffix != ".toml":
        raise SceneError(f"{target}: give the scene a name that ends in .toml")
    refuse_existing(target, force=options.force)
    given = {field.name: getattr(options, field.name) for field in fields(Answers)}
    lists = {name: tuple(value) for name, value in given.items() if isinstance(value, list)}
    text = _check(Answers(**{name: value for name, value in given.items() if value is not None} | lists), target)
    write_atomically(target, text.encode())
    then = f"then design-sensors build {target} -o MODEL.onnx --daemon-config daemon.toml"
    return Result({}, [f"{target}: next, design-sensors explain {target}, {then}"])


def refuse_existing(target: Path, *, force: bool) -> None:
    """Raise SceneError if a file is there and may not be replaced, InputError if it cannot be written."""
    if target.is_file() and not force:
        raise SceneError(f"{target} exists already; give --force to replace it")
    require_writable([target])


def _check(answers: Answers, target: Path) -> str:
    """Return the text of a scene that loads and can be built; SceneError or InputError if there is none."""
    from pydantic import ValidationError

    from beamtouch_common.complaints import reason_of
    from beamtouch_models.building.new_scene import scene_text
    from beamtouch_models.scene import parse_scene
    from beamtouch_models.surface import Surface

    for name in NEEDED:  # before anything is computed with them
        if not 0 < getattr(answers, name) < float("inf"):
            raise SceneError(f"{_option(name)} {getattr(answers, name):g}: give millimetres, more than 0")
    if answers.position_mm is not None:
        low, high = answers.position_mm
        if not 0 <= low < high <= answers.length_mm:
            places = f"two places on the beam, 0..{answers.length_mm:g} mm, in order"
            raise SceneError(f"--position-mm {low:g} {high:g}: give {places}")
    try:
        text = scene_text(answers, surface_name(target))
    except ValidationError as error:
        rollers = "".join(f" --roller-mm {at:g}" for at in answers.roller_mm)
        reason = reason_of(error.errors()[0])
        raise SceneError(f"--left {answers.left} --right {answers.right}{rollers}: {reason}") from None
    Surface.of(parse_scene(text, str(target))).check()
    return text
