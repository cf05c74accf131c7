"""Real lines in place of cables: pseudo-terminals, alone and joined in pairs, on the running event loop."""

import asyncio
import ctypes
import os
import struct
import termios
import tty
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, closing, contextmanager, suppress


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

    @property
    def lowers_dtr(self) -> bool:
        """Return whether a serial port would lower DTR when it is closed."""
        return bool(termios.tcgetattr(self._slave)[2] & termios.HUPCL)

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


class SerialConverter:
    """A converter that passes the bytes of a serial line on over TCP, to the newest of its clients."""

    def __init__(self) -> None:
        self.connections = 0
        self.path = ""
        """Its address, tcp://HOST:PORT."""
        self._receive: Callable[[bytes], object] = lambda _: None
        self._client: asyncio.StreamWriter | None = None

    def on_data(self, receive: Callable[[bytes], object]) -> None:
        """Call `receive` with whatever the daemon sends."""
        self._receive = receive

    def write(self, data: bytes) -> bool:
        """Send to the daemon; return whether it is there."""
        if self._client is None or self._client.is_closing():
            return False
        self._client.write(data)
        return True

    def close(self) -> None:
        """End the connection, as a converter does after a while without traffic."""
        if self._client is not None:
            self._client.close()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve a client."""
        self.connections += 1
        self._client = writer
        with closing(writer), suppress(ConnectionError):
            while data := await reader.read(4096):
                self._receive(data)


@asynccontextmanager
async def serial_converter() -> AsyncIterator[SerialConverter]:
    """A converter that listens on this machine."""
    one = SerialConverter()
    server = await asyncio.start_server(one.serve, "127.0.0.1", 0)
    one.path = f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    try:
        yield one
    finally:
        server.close()
        one.close()


class Watch:
    """Tells who opens and closes a file."""

    _OPENED, _CLOSED = 0x20, 0x18
    _EVENT = struct.Struct("iIII")
    """Of inotify, for a watch of a single file."""

    def __init__(self, path: str) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self.descriptor: int = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        assert libc.inotify_add_watch(self.descriptor, os.fsencode(path), self._OPENED | self._CLOSED) > 0

    def openings(self) -> list[bool]:
        """Return what has happened since the last call: True for each opening, False for each closing."""
        with suppress(BlockingIOError):
            events = os.read(self.descriptor, 1 << 16)
            return [bool(kind & self._OPENED) for _, kind, _, _ in self._EVENT.iter_unpack(events)]
        return []


LOADER_S = 0.1
"""Time after which a boot loader prints something."""


class RebootingTerminal(Terminal):
    """A port that resets its device whenever it is opened, as the DTR line of a serial port does.

    The device is deaf and dumb while it boots, except for what its boot loader prints.

    Parameters
    ----------
    boots_s : How long the device boots.
    prints : What its boot loader prints at once.
    spares : Whether an opening resets nothing if the port was closed without HUPCL, because DTR then stays up.
    """

    def __init__(self, boots_s: float, prints: bytes = b"", *, spares: bool = False) -> None:
        super().__init__()
        self.opened = 0
        """Times that somebody opened the port."""
        self.reset: Callable[[], object] = lambda: None
        """Called once the device has booted."""
        self._boots_s, self._prints, self._spares = boots_s, prints, spares
        self.is_booting = False
        self._timers: tuple[asyncio.TimerHandle, ...] = ()
        self._is_line_up = self._hangs = False
        self._set_hang_up_on_close()
        self._watch = Watch(self.path)
        self._loop.add_reader(self._watch.descriptor, self._notice)

    def on_data(self, receive: Callable[[bytes], object]) -> None:
        def hear(data: bytes) -> None:
            self._notice()
            if not (self.is_booting or self._hangs):
                receive(data)

        super().on_data(hear)

    def write(self, data: bytes) -> bool:
        self._notice()
        return not (self.is_booting or self._hangs) and super().write(data)

    def hang(self) -> None:
        """Carry nothing until somebody opens the port."""
        self._hangs = True

    def boot(self) -> None:
        """Reset the device, as an opening or its own watchdog does."""
        for timer in self._timers:
            timer.cancel()
        self.is_booting = True
        write = super().write
        self._timers = (
            self._loop.call_later(LOADER_S, lambda: write(self._prints)),
            self._loop.call_later(self._boots_s, self._run),
        )

    def unplug(self) -> None:
        if self._is_open:
            self._loop.remove_reader(self._watch.descriptor)
            os.close(self._watch.descriptor)
            for timer in self._timers:
                timer.cancel()
        super().unplug()

    def _run(self) -> None:
        self.is_booting = False
        self.reset()

    def _notice(self) -> None:
        """Look who has opened and closed the port."""
        for is_opening in self._watch.openings():
            if not is_opening:
                self._is_line_up = self._spares and not self.lowers_dtr
                continue
            self.opened += 1
            self._hangs = False
            if not self._is_line_up:
                self.boot()

    def _set_hang_up_on_close(self) -> None:
        """Serial ports have this setting by default, pseudo-terminals do not."""
        settings = termios.tcgetattr(self._slave)
        settings[2] |= termios.HUPCL
        termios.tcsetattr(self._slave, termios.TCSANOW, settings)


@contextmanager
def rebooting_terminal(boots_s: float, prints: bytes = b"", *, spares: bool = False) -> Iterator[RebootingTerminal]:
    """A port that resets its device, hung up at the end."""
    one = RebootingTerminal(boots_s, prints, spares=spares)
    try:
        yield one
    finally:
        one.unplug()
