"""Lines without hardware: pseudo-terminals with a fixed name, and the relay that delays and loses what faults say."""

import asyncio
import os
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from beamtouch_models.errors import SceneError
from beamtouch_models.lab.rig.faults import Faults

_CHUNK = 4096
_MENDED_S = 0.1
"""A long pause is looked at again after this time, as it may have been mended."""
_TICK_S = 1e-6
"""The event loop keeps the order of acts that are this far apart."""

Pass = Callable[[Callable[[], None]], None]
"""Passes something on: calls a function at once, later or never."""


class Relay:
    """Passes requests and replies on, each in their order, as the faults let them through."""

    def __init__(self, faults: Faults, clock: Callable[[], float]) -> None:
        """Take the time since the start [s] from `clock`."""
        self._faults, self._clock = faults, clock
        self._requests: list[Callable[[], None]] = []
        self._last_reply_s = 0.0

    def request(self, act: Callable[[], None]) -> None:
        """Pass a request on, once no pause is on."""
        self._requests.append(act)
        if len(self._requests) == 1:
            self._pass_requests()

    def reply(self, act: Callable[[], None]) -> None:
        """Pass a reply on, unless it is lost."""
        delay_s = self._faults.delay_s(self._clock())
        if delay_s is None:
            return
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        self._last_reply_s = max(self._last_reply_s + _TICK_S, now_s + delay_s)
        if self._last_reply_s > now_s:
            loop.call_at(self._last_reply_s, act)
        else:
            act()

    async def idle(self) -> None:
        """Wait until no pause is on."""
        while True:
            pause_s = self._pause_s()
            if not pause_s:
                return
            await asyncio.sleep(pause_s)

    async def listen(self, host: str, port: int, device_port: int) -> asyncio.Server:
        """Return a server that passes the requests of its clients on to a device on this machine, and its replies back.

        A client may send several requests at once; the device gets each when it has answered the one before, as
        pymodbus answers only the newest of those that come together.
        """
        serving = set[asyncio.Task[None] | None]()  # asyncio itself forgets the task of a client that has gone

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = asyncio.current_task()
            serving.add(task)
            try:
                device_reader, device_writer = await asyncio.open_connection("127.0.0.1", device_port)
                # The rig ends, and asyncio would log the cancelled client.
                with suppress(asyncio.CancelledError, asyncio.IncompleteReadError, ConnectionError):
                    while True:
                        request = await _read_frame(reader)
                        await self.idle()
                        device_writer.write(request)
                        reply = await _read_frame(device_reader)
                        self.reply(partial(_send, writer, reply))
                device_writer.close()
            finally:
                writer.close()
                serving.discard(task)

        return await asyncio.start_server(serve, host, port)

    def _pass_requests(self) -> None:
        pause_s = self._pause_s()
        if pause_s:
            asyncio.get_running_loop().call_later(pause_s, self._pass_requests)
            return
        waiting, self._requests = self._requests, []
        for act in waiting:
            act()

    def _pause_s(self) -> float:
        return min(self._faults.pause_s(self._clock()), _MENDED_S)


def _send(writer: asyncio.StreamWriter, data: bytes) -> None:
    """Write to a client, unless it has gone."""
    if not writer.is_closing():
        writer.write(data)


async def _read_frame(reader: asyncio.StreamReader) -> bytes:
    """Read one Modbus TCP frame: six bytes, of which the last two say how many follow."""
    head = await reader.readexactly(6)
    return head + await reader.readexactly(int.from_bytes(head[4:]))


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
        remove_left_behind(path)
        try:
            path.symlink_to(name)
        except FileExistsError:
            raise SceneError(f"{path}: exists already; choose another path or remove the file") from None
        except OSError as error:
            raise SceneError(f"{path}: {error.strerror}") from None
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


def _copy(source: int, target: int, pass_on: Pass) -> None:
    data = read(source)
    if data:
        pass_on(lambda: write(target, data))


def read(line: int) -> bytes:
    """Return the bytes that have come on a line; none if there are none yet."""
    try:
        return os.read(line, _CHUNK)
    except BlockingIOError:
        return b""


def write(line: int, data: bytes) -> None:
    """Write to a line; bytes that it cannot take because nobody reads it are lost, as on a real line."""
    with suppress(BlockingIOError):
        os.write(line, data)
