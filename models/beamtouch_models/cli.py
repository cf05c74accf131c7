"""The command `design-sensors`: from a scene to a model file, and what a model file says of itself."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `design-sensors`; returns the exit code: 0 done, 1 failed, 2 wrong input."""
    options = _parser().parse_args(arguments)
    try:
        # Imported here so that a missing extra is one clear line.
        from beamtouch_models import commands  # noqa: PLC0415
    except ModuleNotFoundError as error:
        print(f"design-sensors needs {error.name}: pip install 'beamtouch[design]'", file=sys.stderr)
        return 2
    return commands.run(options)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="design-sensors", description="Design a touch-sensing beam, offline.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    build = commands.add_parser("build", help="place the sensors, train the estimator, write the model file")
    build.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    build.add_argument("-o", "--output", type=Path, required=True, metavar="MODEL", help="model file to write (.onnx)")
    build.add_argument("--sensors", type=_sensor_count, metavar="N", help="number of sensors, instead of the scene's")
    build.add_argument("--seed", type=_seed, default=0, metavar="S", help="of everything random (default 0)")
    build.add_argument("--daemon-config", type=Path, metavar="FILE", help="also write a config for beamtouch-daemon")
    build.add_argument("--json", action="store_true", help="print one JSON object on stdout")

    inspect = commands.add_parser("inspect", help="print what a model file says of itself")
    inspect.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    inspect.add_argument("--json", action="store_true", help="print one JSON object on stdout")
    return parser


def _sensor_count(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 64:
        raise argparse.ArgumentTypeError(f"{value} is not between 1 and 64")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(f"{value} is not between 0 and {2**32 - 1}")
    return value


if __name__ == "__main__":
    sys.exit(main())
