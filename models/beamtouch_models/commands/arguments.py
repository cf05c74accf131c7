"""The arguments of the commands of `design-sensors`, a function each. `COMMAND --help` waits for this import alone."""

import argparse
from pathlib import Path
from typing import Any

from beamtouch_common.commands import whole_number
from beamtouch_models.names import CRITERIA, ESTIMATORS, SEARCHES

MAX_DRAWS = 1_000_000
"""Bounds memory: each contact takes about 2 kB."""
MAX_PLAYS = 10_000
"""Bounds memory: each play takes about 100 kB."""
MAX_WORKERS = 1024
"""Bounds memory: each worker process takes about 300 MB."""
ENDS = ("clamped", "pinned", "roller", "free")
"""The kinds of `building.new_scene.End`, which takes too long to import for --help."""


def _address(text: str) -> str:
    """Check an address here: for some that are not one, Dask waits until its patience ends."""
    from urllib.parse import urlsplit  # noqa: PLC0415  # --help waits for all that is imported above

    try:
        parts = urlsplit(text)
        is_one = parts.scheme in ("tcp", "tls") and bool(parts.hostname) and bool(parts.port) and not parts.path
    except ValueError:  # of the port
        is_one = False
    if not is_one:
        raise argparse.ArgumentTypeError(f"{text!r} is not tcp://HOST:PORT")
    return text


def _spare(text: str) -> float:
    """Return the share of the time in percent that a number of sensors, 0 or 1, counts as failed."""
    if text not in ("0", "1"):
        raise argparse.ArgumentTypeError(f"{text!r} is neither 0 nor 1")
    return 100.0 * int(text)


_SHARED: dict[str, dict[str, Any]] = {
    "scene": {"type": Path, "metavar": "SCENE", "help": "scene file (TOML)"},
    "model": {"type": Path, "metavar": "MODEL", "help": "model file (.onnx)"},
    "--sensors": {"type": whole_number(1, 64), "metavar": "N", "help": "number of sensors, instead of the scene's"},
    "--criterion": {
        "choices": CRITERIA,
        "help": "`position-error` minimises the mean position error among the layouts that detect two contacts and "
        "distributed loads as well as the paper's; `eigenvalue-product` is the paper's criterion (default: "
        "position-error)",
    },
    "--failed-percent": {
        "type": float,
        "metavar": "P",
        "help": "share of the time, 0 to 100, in which the worst single sensor has failed: 0 makes the mean position "
        "error of all sensors least, 100 that with the worst one failed (default: as the scene requires)",
    },
    "--spare": {
        "type": _spare,
        "dest": "failed_percent",
        "metavar": "{0,1}",
        "help": "sensors that may fail: 0 is short for --failed-percent 0, and 1 for --failed-percent 100",
    },
    "--workers": {
        "type": whole_number(1, MAX_WORKERS),
        "metavar": "N",
        "help": "number of processes that the work is spread over (default: one per core); the results are the same",
    },
    "--cluster": {
        "type": _address,
        "metavar": "tcp://HOST:PORT",
        "help": "spread the work over the workers of this Dask scheduler instead",
    },
    "--seed": {
        "type": whole_number(0, 2**32 - 1),
        "default": 0,
        "metavar": "S",
        "help": "seed of all random numbers (default: 0)",
    },
    "--effort": {
        "type": float,
        "default": 1.0,
        "metavar": "SHARE",
        "help": "share of the usual layouts and simulated contacts, from 0.01 to 100: less is quicker, and figures "
        "have larger standard errors (default: 1)",
    },
    "--json": {"action": "store_true", "help": "print one JSON object on standard output"},
}


_EITHER = {"--workers": "--cluster", "--failed-percent": "--spare"}
"""Arguments of which one may be given, not both."""


def _share(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add arguments that several commands have, each with the one that may be given in its place."""
    for name in names:
        if name in _EITHER:
            either = parser.add_mutually_exclusive_group()
            for option in (name, _EITHER[name]):
                either.add_argument(option, **_SHARED[option])
        else:
            parser.add_argument(name, **_SHARED[name])


def _add_output(parser: argparse.ArgumentParser, what: str, metavar: str = "MODEL") -> None:
    """Add the file or folder to write, which must be given."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=what)


def _add_draws(parser: argparse.ArgumentParser, what: str, default: int) -> None:
    """Add the number of simulated contacts."""
    words = "rounded up to a power of two; below about 2000, a stated standard error is a lower bound"
    number = whole_number(100, MAX_DRAWS)
    parser.add_argument(
        "--draws", type=number, default=default, metavar="N", help=f"{what}, {words} (default: {default})"
    )


def build(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `build`."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("scene", type=Path, nargs="?", metavar="SCENE", help="scene file (TOML), or a model file")
    words = "instead: loads recorded by `beamtouch-daemon record`, of a structure of which nothing else is known"
    source.add_argument("--loads", type=Path, metavar="LOADS.csv", help=words)
    _add_output(parser, "model file to write (.onnx)")
    _share(parser, "--sensors", "--criterion", "--failed-percent")
    words = (
        "place the sensors anew; without this option, or one of those above, they stay where the model or the daemon "
        "configuration that is replaced has them, because they may be mounted"
    )
    parser.add_argument("--move-sensors", action="store_true", help=words)
    words = f"estimator of the position (default: {ESTIMATORS[0]})"
    parser.add_argument("--estimator", choices=ESTIMATORS, default=ESTIMATORS[0], help=words)
    words = "also write a configuration for beamtouch-daemon (TOML)"
    parser.add_argument("--daemon-config", type=Path, metavar="FILE", help=words)
    parser.add_argument("--report", type=Path, metavar="FILE", help="also write a report of the build (.html)")
    words = (
        "replace also a model that is calibrated, a configuration that was edited after build wrote it, and files that "
        "build did not write"
    )
    parser.add_argument("--force", action="store_true", help=words)
    _share(parser, "--seed", "--effort", "--json")


def calibrate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `calibrate`."""
    _share(parser, "model")
    source = parser.add_mutually_exclusive_group(required=True)
    words = "loads recorded by `beamtouch-daemon record`"
    source.add_argument("readings", type=Path, nargs="?", metavar="READINGS.csv", help=words)
    words = "instead: contacts of unknown place and force, from the service's /surfaces/NAME/calibration-data (CSV)"
    source.add_argument("--events", type=Path, metavar="FILE", help=words)
    number, words = whole_number(0, 2**31 - 1), "number of a recorded load to ignore; may be given several times"
    parser.add_argument("--leave-out", type=number, action="append", default=[], metavar="LOAD", help=words)
    words = "standard deviation of a load's true position from the stated one, in mm (default: 1)"
    parser.add_argument("--placing-mm", type=float, default=1.0, metavar="MM", help=words)
    words = "standard deviation of a sensor's true position from that of the layout, in mm (default: 1.5)"
    parser.add_argument("--mounting-mm", type=float, default=1.5, metavar="MM", help=words)
    words = "standard deviation of a load's true force from the stated one, in percent (default: 1)"
    parser.add_argument("--force-percent", type=float, default=1.0, metavar="P", help=words)
    _add_output(parser, "model file to write (.onnx)")
    _share(parser, "--effort", "--json")


def challenge(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `challenge`."""
    _share(parser, "model")
    words = "number of simulations of each case (default: 400)"
    parser.add_argument("--draws", type=whole_number(10, MAX_PLAYS), default=400, metavar="N", help=words)
    _share(parser, "--workers", "--seed", "--json")


def evaluate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `evaluate`."""
    _share(parser, "model")
    words = "noise of a sample (standard deviation), instead of the model's; may be given several times"
    parser.add_argument("--noise", type=float, action="append", default=[], metavar="MM", help=words)
    _add_draws(parser, "number of simulated contacts", 16_384)
    _share(parser, "--workers", "--seed", "--json")


def explain(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `explain`."""
    _share(parser, "scene")
    words = "also forecast the answers for zones: a TOML file with tables [zones.NAME], with the keys of the service"
    parser.add_argument("--zones", type=Path, metavar="FILE", help=words)
    _share(parser, "--effort", "--json")


def inspect(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `inspect`."""
    _share(parser, "model", "--json")


def new(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `new`."""
    from beamtouch_models.design.scene.materials import MATERIALS  # noqa: PLC0415  # no other command waits for it

    def add(name: str, words: str, metavar: str | tuple[str, ...] = "MM") -> None:
        nargs = len(metavar) if isinstance(metavar, tuple) else None
        parser.add_argument(name, type=float, nargs=nargs, metavar=metavar, help=words)

    pair = "LOW", "HIGH"
    parser.add_argument("scene", type=Path, metavar="NAME.toml", help="scene file to write")
    for name, words in (
        ("--length-mm", "length of the beam"),
        ("--width-mm", "its width"),
        ("--thickness-mm", "its thickness"),
    ):
        parser.add_argument(name, type=float, required=True, metavar="MM", help=words)
    parser.add_argument("--material", choices=tuple(MATERIALS), help="its material (default: steel)")
    parser.add_argument("--left", choices=ENDS, help="how its left end is held (default: pinned)")
    parser.add_argument("--right", choices=ENDS, help="how its right end is held (default: roller)")
    words = "place of a roller between the ends; may be repeated"
    parser.add_argument("--roller-mm", type=float, action="append", metavar="MM", help=words)
    add("--force-n", "smallest and largest force of a contact (default: what uses a third of --range-mm)", pair)
    add("--position-mm", "where contacts may be (default: from end to end, save next to one that is held)", pair)
    parser.add_argument("--sensors", type=whole_number(1, 64), metavar="N", help="number of sensors (default: 4)")
    add("--noise-mm", "standard deviation of a reading (default: 0.005)")
    add("--rate-hz", "readings per second (default: 200)", "HZ")
    add("--range-mm", "gaps over which the sensors are linear (default: 1 4)", pair)
    add("--size-mm", "width of a sensor's housing along the beam (default: 8)")
    add("--latency-ms", "time of filtering (default: 20)", "MS")
    add("--position-error-mm", "largest mean error (default: any)")
    parser.add_argument("--force", action="store_true", help="replace a file that exists")


def place(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `place`."""
    _share(parser, "scene", "--sensors", "--criterion", "--failed-percent")
    words = "number of leading eigenvalues in the product (default: all)"
    parser.add_argument("--components", type=whole_number(1, 64), metavar="K", help=words)
    parser.add_argument("--search", choices=SEARCHES, default=SEARCHES[0], help="search method (default: exchange)")
    _share(parser, "--seed", "--effort", "--json")


def reproduce(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `reproduce`."""
    _add_output(parser, "folder for the plots and numbers", "DIR")
    _share(parser, "--seed", "--json")


def scenes(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `scenes`."""
    words = "copy this scene into a folder (default: the current one)"
    parser.add_argument("--copy", nargs="+", metavar=("NAME", "FOLDER"), help=words)
    parser.add_argument("--force", action="store_true", help="replace a file that exists")
    _share(parser, "--json")


def schema(_parser: argparse.ArgumentParser) -> None:
    """Add no arguments: there is one schema, and it is JSON."""


def trade(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `trade`."""
    _share(parser, "scene")
    _add_output(parser, "folder for the tables, picture and JSON", "DIR")
    wish = parser.add_mutually_exclusive_group()
    words = "build the most accurate model that answers within L ms"
    wish.add_argument("--latency-ms", type=float, metavar="L", help=words)
    words = "build the quickest model with a mean error of at most E mm"
    wish.add_argument("--error-mm", type=float, metavar="E", help=words)
    words = "estimators to measure beside the default one (default: all)"
    parser.add_argument("--estimators", nargs="+", choices=ESTIMATORS, help=words)
    _add_draws(parser, "simulated contacts per model", 4096)
    _share(parser, "--workers", "--seed", "--effort")
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object on standard output; measured times (inference_us, latency_ms) differ from run to "
        "run, and on_front, picked and sentences may differ with them",
    )
