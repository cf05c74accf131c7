"""Serial lines without hardware: pseudo-terminals with a fixed name."""

import asyncio
import os
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from beamtouch_models.errors import SceneError
from beamtouch_models.rig.relay import Pass, Relay

_CHUNK = 4096


@contextmanager
def _raw_pty() -> Iterator[tuple[int, str]]:
    """Open a raw pseudo-terminal; yields the master and the path of the other end."""
    # Keep the slave open, or the master reports a hang-up between two clients.
    master, slave = os.openpty()
    try:
        tty.setraw(slave, termios.TCSANOW)
        os.set_blocking(master, False)
        yield master, os.ttyname(slave)
    finally:
        os.close(master)
        os.close(slave)


@contextmanager
def named_line(path: Path) -> Iterator[int]:
    """Create a serial line that others open at `path`; yields a non-blocking descriptor of this end.

    Raises
    ------
    SceneError
        `path` exists already or cannot be created.
    """
    with _raw_pty() as (master, name):
        _link(path, name)
        try:
            yield master
        finally:
            path.unlink(missing_ok=True)


@contextmanager
def joined_line(path: Path, relay: Relay) -> Iterator[str]:
    """Join two pseudo-terminals to one line: others open `path`, this process opens the yielded path.

    For libraries that open a path themselves. Needs a running event loop. What others send are requests to the relay.
    """
    with _raw_pty() as (near, near_name), named_line(path) as far:
        loop = asyncio.get_running_loop()
        loop.add_reader(near, _copy, near, far, relay.reply)
        loop.add_reader(far, _copy, far, near, relay.request)
        try:
            yield near_name
        finally:
            loop.remove_reader(near)
            loop.remove_reader(far)


def remove_left_behind(path: Path) -> None:
    """Remove a dangling link that a killed rig left at `path`."""
    if path.is_symlink() and not path.exists():
        path.unlink()


def _link(path: Path, target: str) -> None:
    remove_left_behind(path)
    try:
        path.symlink_to(target)
    except FileExistsError:
        message = f"{path}: exists already; choose another path or remove the file"
        raise SceneError(message) from None
    except OSError as error:
        message = f"{path}: {error.strerror}"
        raise SceneError(message) from None


def _copy(source: int, target: int, pass_on: Pass) -> None:
    try:
        data = os.read(source, _CHUNK)
    except BlockingIOError:
        return
    pass_on(lambda: write(target, data))


def write(line: int, data: bytes) -> None:
    """Write to a line; bytes that it cannot take because nobody reads it are lost, as on a real line."""
    with suppress(BlockingIOError):
        os.write(line, data)
