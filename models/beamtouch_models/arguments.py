"""The arguments of `design-sensors`, by command."""

import argparse
from pathlib import Path

from beamtouch_common.commands import whole_number
from beamtouch_models.shared_arguments import MAX_WORKERS, add_contacts, add_json, add_seed, add_workers

ESTIMATORS = ("posterior", "small-network", "paper-network")
"""The names in `estimators.estimator`, which takes too long to import for --help."""
MAX_PLAYS = 10_000
"""Bounds memory: each course takes about 100 kB."""


def add_build(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors build`."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MODEL", help="model file to write (.onnx)")
    parser.add_argument(
        "--sensors", type=whole_number(1, 64), metavar="N", help="number of sensors, instead of the scene's"
    )
    _add_criterion(parser)
    parser.add_argument(
        "--estimator",
        choices=ESTIMATORS,
        default=ESTIMATORS[0],
        help=f"estimator of the position (default: {ESTIMATORS[0]})",
    )
    parser.add_argument(
        "--daemon-config", type=Path, metavar="FILE", help="also write a configuration for beamtouch-daemon (TOML)"
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="also write a report of the build (.html)")
    add_seed(parser)
    add_json(parser)


def _add_criterion(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--criterion",
        choices=("position-error", "eigenvalue-product"),
        help="what the layout makes best: the mean position error (least, of the layouts that notice two contacts and "
        "spread loads as often as the other one), or the paper's product of eigenvalues (largest) (default: "
        "position-error)",
    )
    parser.add_argument(
        "--spare",
        type=whole_number(0, 1),
        metavar="N",
        help="number of sensors that may fail, 0 or 1; with 1, the layout is the one with the least mean position "
        "error when the worst single sensor has failed (default: 0)",
    )


def add_calibrate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors calibrate`."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "readings", type=Path, nargs="?", metavar="READINGS.csv", help="loads recorded by `beamtouch-daemon record`"
    )
    source.add_argument(
        "--events",
        type=Path,
        metavar="FILE",
        help="instead: contacts of unknown place and force, from the service's /surfaces/NAME/calibration-data (CSV)",
    )
    parser.add_argument(
        "--leave-out",
        type=whole_number(0, 2**31 - 1),
        action="append",
        default=[],
        metavar="LOAD",
        help="number of a recorded load to ignore; may be given several times",
    )
    for name, metavar, text in (
        ("--placing-mm", "MM", "standard deviation of a load's true position from the stated one, in mm (default: 1)"),
        (
            "--force-percent",
            "P",
            "standard deviation of a load's true force from the stated one, in percent (default: 1)",
        ),
    ):
        parser.add_argument(name, type=float, default=1.0, metavar=metavar, help=text)
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="MODEL", help="model file to write (.onnx)")
    add_json(parser)


def add_challenge(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors challenge`."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    parser.add_argument(
        "--draws",
        type=whole_number(10, MAX_PLAYS),
        default=400,
        metavar="N",
        help="number of simulated courses per case (default: 400)",
    )
    add_workers(parser)
    add_seed(parser)
    add_json(parser)


def add_evaluate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors evaluate`."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    parser.add_argument(
        "--noise",
        type=float,
        action="append",
        default=[],
        metavar="MM",
        help="noise of a sample (standard deviation), instead of the model's; may be given several times",
    )
    add_contacts(parser, "number of simulated contacts", 16_384)
    add_workers(parser)
    add_seed(parser)
    add_json(parser)


def add_explain(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors explain`."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    add_json(parser)


def add_inspect(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors inspect`."""
    parser.add_argument("model", type=Path, metavar="MODEL", help="model file (.onnx)")
    add_json(parser)


def add_place(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors place`."""
    parser.add_argument("scene", type=Path, metavar="SCENE", help="scene file (TOML)")
    parser.add_argument(
        "--sensors", type=whole_number(1, 64), metavar="N", help="number of sensors, instead of the scene's"
    )
    parser.add_argument(
        "--components",
        type=whole_number(1, 64),
        metavar="K",
        help="number of leading eigenvalues in the product (default: all)",
    )
    _add_criterion(parser)
    parser.add_argument("--search", choices=("exact", "paper"), default="exact", help="search method (default: exact)")
    parser.add_argument(
        "--prove",
        action="store_true",
        help="prove that no layout on the grid is better, or state how much better one could be",
    )
    parser.add_argument(
        "--workers",
        type=whole_number(1, MAX_WORKERS),
        metavar="N",
        help="accepted as by the other commands; a proof runs in one process, which is as fast",
    )
    add_seed(parser)
    add_json(parser)


def add_reproduce(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors reproduce`."""
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder for the plots and numbers"
    )
    add_seed(parser)
    add_json(parser)


def add_trade(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design-sensors trade`."""
    parser.add_argument(
        "scene", type=Path, metavar="SCENE", help="scene file (TOML), or a folder: all scenes in it, one after another"
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the table, plot and JSON; for a folder of scenes, each gets its own folder in it",
    )
    wish = parser.add_mutually_exclusive_group()
    wish.add_argument(
        "--latency-ms", type=float, metavar="L", help="build the most accurate model that answers within L ms"
    )
    wish.add_argument(
        "--error-mm", type=float, metavar="E", help="build the quickest model with a mean error of at most E mm"
    )
    parser.add_argument("--estimators", nargs="+", choices=ESTIMATORS, help="estimators to measure (default: all)")
    add_contacts(parser, "simulated contacts per point", 4096)
    add_workers(parser)
    add_seed(parser)
    parser.add_argument(
        "--json",
        action="store_true",
        help="print one JSON object per scene, each on a line of standard output; measured times (times, latency_ms, "
        "influence_ms and influence_with_ms) differ from run to run, and on_front and picked may differ with them",
    )
