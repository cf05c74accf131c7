"""The arguments of the commands `backup` and `restore`, which service and daemon share, and how a signal ends them."""

import argparse
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType


@contextmanager
def end_in_order() -> Iterator[None]:
    """Let SIGTERM end the block as an exception does, so that it removes what it has begun to write.

    The exit code is then 143, as shells report that signal. Ctrl-C is an exception already.
    """
    before = signal.signal(signal.SIGTERM, _exit)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _exit(number: int, _frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def add_backup(command: argparse.ArgumentParser) -> None:
    """Add the arguments that all commands `backup` take."""
    command.add_argument("-o", "--output", metavar="ARCHIVE", type=Path, required=True, help="archive to write")
    words = "also write tokens, passwords and private keys, which open the service to whoever has the archive"
    command.add_argument("--with-secrets", action="store_true", help=words)


def add_restore(command: argparse.ArgumentParser) -> None:
    """Add description and arguments of `restore`."""
    command.description = (
        "Restore an archive of `backup`: all of it or nothing. It is checked first, and overwrites no file."
    )
    command.add_argument("archive", metavar="ARCHIVE", type=Path, help="archive of `backup`")
    words = "folder for the configuration and the files beside it"
    command.add_argument("folder", metavar="FOLDER", type=Path, help=words)
    words = "folder below which files go that the configuration names elsewhere; / is where they were"
    command.add_argument("--root", metavar="DIR", type=Path, help=words)
