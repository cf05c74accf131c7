"""Real lines in place of cables: pseudo-terminals, alone and joined in pairs, on the running event loop."""

import asyncio
import os
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress


class Terminal:
    """A pseudo-terminal: the daemon opens `path`, the test is the device at the other end."""

    def __init__(self) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path = os.ttyname(self._slave)
        self._loop = asyncio.get_running_loop()
        self._is_open = True

    def on_data(self, receive: Callable[[bytes], object]) -> None:
        """Call `receive` with whatever the daemon sends."""

        def read() -> None:
            with suppress(BlockingIOError):
                receive(os.read(self._master, 4096))

        self._loop.add_reader(self._master, read)

    def write(self, data: bytes) -> bool:
        """Send to the daemon; return whether all of it went.

        What does not fit into a buffer that nobody reads is lost, as on a cable.
        """
        with suppress(BlockingIOError):
            return self._is_open and os.write(self._master, data) == len(data)
        return False

    def unplug(self) -> None:
        """Hang up for good."""
        if self._is_open:
            self._is_open = False
            self._loop.remove_reader(self._master)
            os.close(self._master)
            os.close(self._slave)


@contextmanager
def terminal() -> Iterator[Terminal]:
    """A pseudo-terminal that is hung up at the end."""
    one = Terminal()
    try:
        yield one
    finally:
        one.unplug()
