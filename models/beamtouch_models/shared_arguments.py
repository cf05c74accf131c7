"""Arguments that several commands of `design-sensors` share."""

import argparse
from urllib.parse import urlsplit

from beamtouch_common.commands import whole_number

MAX_DRAWS = 1_000_000
"""Bounds memory: each contact takes about 2 kB."""
MAX_WORKERS = 1024
"""Bounds memory: each worker process takes about 200 MB."""


def add_contacts(parser: argparse.ArgumentParser, what: str, default: int) -> None:
    """Add the number of simulated contacts."""
    parser.add_argument(
        "--draws",
        type=whole_number(100, MAX_DRAWS),
        default=default,
        metavar="N",
        help=f"{what}, rounded up to a power of two; below about 2000, a stated standard error is a lower bound "
        f"(default: {default})",
    )


def add_workers(parser: argparse.ArgumentParser, what: str = "the work") -> None:
    """Add where the tasks of a sweep run."""
    workers = parser.add_mutually_exclusive_group()
    workers.add_argument(
        "--workers",
        type=whole_number(1, MAX_WORKERS),
        metavar="N",
        help=f"number of processes that {what} is spread over (default: one per core); the results are the same",
    )
    workers.add_argument(
        "--cluster",
        type=_address,
        metavar="tcp://HOST:PORT",
        help=f"spread {what} over the workers of this Dask scheduler instead",
    )


def _address(text: str) -> str:
    """Check an address here: for some that are not one, Dask waits until its patience ends."""
    try:
        parts = urlsplit(text)
        is_one = parts.scheme in ("tcp", "tls") and bool(parts.hostname) and bool(parts.port) and not parts.path
    except ValueError:  # of the port
        is_one = False
    if not is_one:
        message = f"{text!r} is not tcp://HOST:PORT"
        raise argparse.ArgumentTypeError(message)
    return text


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add the seed."""
    parser.add_argument(
        "--seed",
        type=whole_number(0, 2**32 - 1),
        default=0,
        metavar="S",
        help="seed of all random numbers (default: 0)",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add the output as JSON."""
    parser.add_argument("--json", action="store_true", help="print one JSON object on standard output")
