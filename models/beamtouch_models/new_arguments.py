"""The arguments of `design-sensors new` and `scenes`."""

import argparse
from pathlib import Path

from beamtouch_common.commands import whole_number
from beamtouch_models.scene.materials import MATERIALS

ENDS = ("clamped", "pinned", "roller", "free")
"""The kinds of `building.new_scene.End`, which takes too long to import for --help."""


def add_new(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors new`."""
    parser.add_argument("scene", type=Path, metavar="NAME.toml", help="scene file to write")
    for name, text in (
        ("--length-mm", "length of the beam"),
        ("--width-mm", "its width"),
        ("--thickness-mm", "its thickness"),
    ):
        parser.add_argument(name, type=float, metavar="MM", help=text)
    parser.add_argument("--material", choices=tuple(MATERIALS), help="its material (default: steel)")
    parser.add_argument("--left", choices=ENDS, help="how its left end is held (default: pinned)")
    parser.add_argument("--right", choices=ENDS, help="how its right end is held (default: roller)")
    words = "place of a roller between the ends; may be repeated"
    parser.add_argument("--roller-mm", type=float, action="append", metavar="MM", help=words)
    words = "smallest and largest force of a contact (default: what uses a third of --range-mm)"
    parser.add_argument("--force-n", type=float, nargs=2, metavar=("LOW", "HIGH"), help=words)
    parser.add_argument("--sensors", type=whole_number(1, 64), metavar="N", help="number of sensors (default: 4)")
    words = "standard deviation of a reading (default: 0.005)"
    parser.add_argument("--noise-mm", type=float, metavar="MM", help=words)
    parser.add_argument("--rate-hz", type=float, metavar="HZ", help="readings per second (default: 200)")
    words = "gaps over which the sensors are linear (default: 1 4)"
    parser.add_argument("--range-mm", type=float, nargs=2, metavar=("LOW", "HIGH"), help=words)
    parser.add_argument("--latency-ms", type=float, metavar="MS", help="time of filtering (default: 20)")
    parser.add_argument("--position-error-mm", type=float, metavar="MM", help="largest mean error (default: any)")
    parser.add_argument("--force", action="store_true", help="replace a file that exists")


def add_scenes(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors scenes`."""
    words = "copy this scene into a folder (default: the current one)"
    parser.add_argument("--copy", nargs="+", metavar=("NAME", "FOLDER"), help=words)
    parser.add_argument("--force", action="store_true", help="replace a file that exists")
    parser.add_argument("--json", action="store_true", help="print one JSON object on standard output")
