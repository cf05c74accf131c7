"""The command `design-sensors`: arguments here, what each command does in `commands`."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from beamtouch_models.errors import InputError, NotGoodEnoughError

DONE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
ESTIMATORS = ("posterior", "small-network", "paper-network")
"""The names of `estimators.estimator`, which takes too long to import for --help."""
MOST_DRAWS = 1_000_000
"""Bounds memory: each contact takes some 2 kB."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `design-sensors`; returns the exit code: 0 done, 1 failed, 2 wrong input, 130 interrupted."""
    try:
        options = _parser().parse_args(arguments)
        # Imported only now, so that --help is quick and a missing extra is one clear line.
        import_module(f"beamtouch_models.commands.{options.command}").run(options)
    except ModuleNotFoundError as error:
        return _fail(f"needs {error.name}: pip install 'beamtouch[design]'", WRONG_INPUT)
    except InputError as error:
        return _fail(error, WRONG_INPUT)
    except NotGoodEnoughError as error:
        return _fail(error, FAILED)
    except OSError as error:
        return _fail(f"{error.filename}: {error.strerror}", WRONG_INPUT)
    except KeyboardInterrupt as stop:
        return _fail(stop.args[0] if stop.args else "interrupted; nothing was written", INTERRUPTED)
    return DONE


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="design-sensors", description="Design a touch-sensing beam, offline.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _add_build(commands.add_parser("build", help="place the sensors, make the estimator, write the model file"))
    _add_calibrate(commands.add_parser("calibrate", help="fit a model to a real beam, from recorded loads"))
    _add_evaluate(commands.add_parser("evaluate", help="measure a model beside the accuracy limit"))
    _add_explain(commands.add_parser("explain", help="print what each physical effect is worth to a scene"))
    _add_inspect(commands.add_parser("inspect", help="print what a model file says of itself"))
    _add_place(commands.add_parser("place", help="choose sensor positions, and prove them the best on the grid"))
    _add_reproduce(commands.add_parser("reproduce", help="compute the paper's figures and compare them with the paper"))
    _add_trade(commands.add_parser("trade", help="measure what speed, sensors and samples buy in accuracy"))
    return parser


def _add_build(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MODEL", help="model file to write (.onnx)")
    parser.add_argument("--sensors", type=_sensor_count, metavar="N", help="number of sensors, instead of the scene's")
    parser.add_argument(
        "--estimator", choices=ESTIMATORS, default=ESTIMATORS[0], help=f"how a position is found ({ESTIMATORS[0]})"
    )
    parser.add_argument("--daemon-config", type=Path, metavar="FILE", help="also write a config for beamtouch-daemon")
    parser.add_argument("--report", type=Path, metavar="FILE", help="also write a report of the build (.html)")
    _add_seed(parser)
    _add_json(parser)


def _add_calibrate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    parser.add_argument("readings", type=Path, metavar="READINGS.csv", help="what `beamtouch-daemon record` wrote")
    parser.add_argument(
        "--leave-out",
        type=_load_number,
        action="append",
        default=[],
        metavar="LOAD",
        help="ignore a recorded load, by its number; may be given several times",
    )
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MODEL", help="model file to write (.onnx)")
    _add_json(parser)


def _add_evaluate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    parser.add_argument(
        "--noise",
        type=float,
        action="append",
        default=[],
        metavar="MM",
        help="standard deviation of a sample, instead of the model's; may be given several times",
    )
    parser.add_argument(
        "--draws",
        type=_draws,
        default=16_384,
        metavar="N",
        help="simulated contacts, rounded up to a power of two (16384); below about 2000 a stated standard error is a "
        "lower bound",
    )
    _add_seed(parser)
    _add_json(parser)


def _add_explain(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    _add_json(parser)


def _add_inspect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    _add_json(parser)


def _add_place(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    parser.add_argument("--sensors", type=_sensor_count, metavar="N", help="number of sensors, instead of the scene's")
    parser.add_argument("--components", type=_sensor_count, metavar="K", help="leading eigenvalues that count (all)")
    criteria = ("eigenvalue-product", "position-error")
    parser.add_argument("--criterion", choices=criteria, default=criteria[0], help="what is best (eigenvalue-product)")
    parser.add_argument("--search", choices=("exact", "paper"), default="exact", help="how it is looked for (exact)")
    parser.add_argument("--prove", action="store_true", help="prove the layout the best on the grid, or bound the gap")
    _add_seed(parser)
    _add_json(parser)


def _add_reproduce(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="folder for plots and numbers")
    _add_seed(parser)
    _add_json(parser)


def _add_trade(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder for table, plot and JSON"
    )
    wish = parser.add_mutually_exclusive_group()
    wish.add_argument("--latency-ms", type=float, metavar="L", help="build the most accurate that answers within L")
    wish.add_argument("--error-mm", type=float, metavar="E", help="build the quickest with a mean error of at most E")
    parser.add_argument("--estimators", nargs="+", choices=ESTIMATORS, help="some only, of all")
    parser.add_argument(
        "--draws",
        type=_draws,
        default=4096,
        metavar="N",
        help="simulated contacts a point, rounded up to a power of two (4096); below about 2000 a stated "
        "standard error is a lower bound",
    )
    _add_seed(parser)
    _add_json(parser)


def _add_seed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=_seed, default=0, metavar="S", help="of everything random (default 0)")


def _add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")


def _sensor_count(text: str) -> int:
    return _whole_number(text, 1, 64)


def _load_number(text: str) -> int:
    return _whole_number(text, 0, 2**31 - 1)


def _draws(text: str) -> int:
    return _whole_number(text, 100, MOST_DRAWS)


def _seed(text: str) -> int:
    return _whole_number(text, 0, 2**32 - 1)


def _whole_number(text: str, low: int, high: int) -> int:
    if not text.isdecimal() or not low <= int(text) <= high:
        message = f"{text!r} is not a whole number from {low} to {high}"
        raise argparse.ArgumentTypeError(message)
    return int(text)


def _fail(reason: object, code: int) -> int:
    print(f"design-sensors: {reason}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
