"""What several commands of `design-sensors` share: options, and their progress. `--help` waits for this import."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from beamtouch_common.commands import whole_number
from beamtouch_common.errors import InputError
from beamtouch_models.names import CRITERIA

if TYPE_CHECKING:
    from beamtouch_models.placement.placing import Aim
    from beamtouch_models.progress import Progress

MAX_DRAWS = 1_000_000
"""Bounds memory: each contact takes about 2 kB."""
MAX_WORKERS = 1024
"""Bounds memory: each worker process takes about 300 MB."""


def _address(text: str) -> str:
    """Check an address here: for some that are not one, Dask waits until its patience ends."""
    try:
        parts = urlsplit(text)
        is_one = parts.scheme in ("tcp", "tls") and bool(parts.hostname) and bool(parts.port) and not parts.path
    except ValueError:  # of the port
        is_one = False
    if not is_one:
        raise argparse.ArgumentTypeError(f"{text!r} is not tcp://HOST:PORT")
    return text


_OPTIONS: dict[str, dict[str, Any]] = {
    "scene": {"type": Path, "metavar": "SCENE", "help": "scene file (TOML)"},
    "model": {"type": Path, "metavar": "MODEL", "help": "model file (.onnx)"},
    "--sensors": {
        "type": whole_number(1, 64),
        "metavar": "N",
        "help": "number of sensors, instead of the scene's",
    },
    "--criterion": {
        "choices": CRITERIA,
        "help": "what the layout makes best: the mean position error (least, of the layouts that notice two contacts "
        "and spread loads as often as the other one), or the paper's product of eigenvalues (largest) (default: "
        "position-error)",
    },
    "--spare": {
        "type": whole_number(0, 1),
        "metavar": "N",
        "help": "number of sensors that may fail, 0 or 1; with 1, the layout is the one with the least mean position "
        "error when the worst single sensor has failed (default: 0)",
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
    "--json": {"action": "store_true", "help": "print one JSON object on standard output"},
}


def add_shared(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add arguments that several commands have."""
    for name in names:
        parser.add_argument(name, **_OPTIONS[name])


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Add where the tasks of a sweep run."""
    workers = parser.add_mutually_exclusive_group()
    for name in ("--workers", "--cluster"):
        workers.add_argument(name, **_OPTIONS[name])


def add_output(parser: argparse.ArgumentParser, what: str, metavar: str = "MODEL") -> None:
    """Add the file or folder to write, which must be given."""
    parser.add_argument("-o", "--output", type=Path, required=True, metavar=metavar, help=what)


def add_draws(parser: argparse.ArgumentParser, what: str, default: int) -> None:
    """Add the number of simulated contacts."""
    words = "rounded up to a power of two; below about 2000, a stated standard error is a lower bound"
    number = whole_number(100, MAX_DRAWS)
    parser.add_argument(
        "--draws", type=number, default=default, metavar="N", help=f"{what}, {words} (default: {default})"
    )


def aim_of(options: argparse.Namespace) -> Aim:
    """Return the aim of a layout; leading components, which only `place` has, are those of the eigenvalue product.

    Raises SceneError if the options contradict each other.
    """
    from beamtouch_models.placement.placing import DEFAULT_AIM, Aim

    leading = getattr(options, "components", None)
    usual = DEFAULT_AIM.criterion if leading is None else "eigenvalue-product"
    search = getattr(options, "search", DEFAULT_AIM.search)
    return Aim(options.criterion or usual, options.spare or 0, leading, search)


def folder_of(path: Path) -> Path:
    """Create the output folder if it is missing; raises InputError if the path is a file."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file; give a folder")
    path.mkdir(parents=True, exist_ok=True)
    return path


def surface_name(scene: Path) -> str:
    """Name the surface after the scene file."""
    return re.sub(r"[^A-Za-z0-9_.-]", "-", scene.stem)[:64] or "surface"


@contextmanager
def shown_progress() -> Iterator[Progress]:
    """Show progress on standard error if that is a terminal; yields the function to report it with."""
    from rich import progress
    from rich.console import Console

    console = Console(stderr=True)
    columns = (progress.TextColumn("{task.description}"), progress.BarColumn(), progress.TimeElapsedColumn())
    shown = progress.Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    with shown as display:
        task = display.add_task("", total=1.0)
        yield lambda doing, done: display.update(task, description=doing, completed=done)
