"""A thin line between a daemon and its service: a relay that carries so many bytes a second, with a bounded buffer."""

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field

PIECE_BYTES = 1400
"""As much as one packet carries."""
BUFFER_BYTES = 32_000
"""What waits before the narrow place, of all connections together. The kernels of both ends keep what is beyond it."""
_RECEIVE_BYTES = 8192
"""Of the kernel's buffer before the relay, for each connection."""


@dataclass(frozen=True)
class Width:
    """What a line carries."""

    up_bytes_s: float
    down_bytes_s: float
    one_way_s: float = 0.0
    """Time that a piece travels beside."""


@dataclass(eq=False)
class _Connection:
    """One end that takes what the line carries."""

    writer: asyncio.StreamWriter
    is_gone: bool = False
    """Whether the sender reset it: what still waits is of no use to anybody."""


class _Way:
    """One direction, for all connections: first in, first out."""

    def __init__(self, bytes_s: float, one_way_s: float) -> None:
        self.carried = 0
        """Bytes so far."""
        self.bytes_s = bytes_s
        """What it carries from now on."""
        self._one_way_s = one_way_s
        self._waiting = asyncio.Queue[tuple[_Connection, bytes]](BUFFER_BYTES // PIECE_BYTES)
        self.passes = asyncio.Event()
        self.passes.set()

    async def put(self, connection: _Connection, piece: bytes) -> None:
        """Take a piece, as soon as there is room; an empty one ends the connection."""
        await self._waiting.put((connection, piece))

    def clear(self) -> None:
        """Lose what waits."""
        while not self._waiting.empty():
            self._waiting.get_nowait()

    async def run(self) -> None:
        """Carry pieces until cancelled."""
        loop = asyncio.get_running_loop()
        free_s = 0.0
        while True:
            connection, piece = await self._waiting.get()
            await self.passes.wait()
            if connection.is_gone:
                continue
            free_s = max(free_s, loop.time()) + len(piece) / self.bytes_s
            await asyncio.sleep(free_s - loop.time())
            self.carried += len(piece)
            loop.call_later(self._one_way_s, _deliver, connection, piece)


def _deliver(connection: _Connection, piece: bytes) -> None:
    if connection.is_gone or connection.writer.transport.is_closing():
        return
    if piece:
        connection.writer.write(piece)
    else:
        connection.writer.close()


@dataclass
class ThinLine:
    """A relay to a port of loopback, on the running event loop. Use `thin_line`."""

    target_port: int
    width: Width
    port: int = 0
    _server: asyncio.Server | None = None
    _tasks: set[asyncio.Task[None]] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.up = _Way(self.width.up_bytes_s, self.width.one_way_s)
        self.down = _Way(self.width.down_bytes_s, self.width.one_way_s)

    @property
    def url(self) -> str:
        """Address for the daemon."""
        return f"http://127.0.0.1:{self.port}"

    async def open(self) -> None:
        """Take connections, again at the same port."""
        # Connections inherit the buffer: little waits in the relay itself.
        listener = socket.socket()
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        listener.bind(("127.0.0.1", self.port))
        self.port = listener.getsockname()[1]
        self._server = await asyncio.start_server(self._accept, sock=listener, limit=PIECE_BYTES)

    async def cut(self) -> None:
        """End all connections, lose what they carried, and refuse new ones."""
        assert self._server is not None
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self.up.clear()
        self.down.clear()

    def freeze(self) -> None:
        """Carry nothing, and say nothing of it."""
        self.up.passes.clear()
        self.down.passes.clear()

    def thaw(self) -> None:
        """Carry again."""
        self.up.passes.set()
        self.down.passes.set()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            await self._join(reader, writer)
        except (asyncio.CancelledError, OSError):
            pass
        finally:
            self._tasks.discard(task)

    async def _join(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self.target_port, limit=PIECE_BYTES)
        ends = _Connection(far_writer), _Connection(writer)
        try:
            await asyncio.gather(
                _pass_on(reader, self.up, ends[0], ends), _pass_on(far_reader, self.down, ends[1], ends)
            )
        finally:
            for end in ends:
                end.is_gone = True
                end.writer.transport.abort()


async def _pass_on(
    reader: asyncio.StreamReader, way: _Way, end: _Connection, ends: tuple[_Connection, _Connection]
) -> None:
    try:
        while piece := await reader.read(PIECE_BYTES):
            await way.put(end, piece)
        await way.put(end, b"")
        await end.writer.wait_closed()
    except OSError:
        for one in ends:
            one.is_gone = True
        raise


@asynccontextmanager
async def thin_line(
    target_port: int, up_bytes_s: float, down_bytes_s: float | None = None, one_way_s: float = 0.0
) -> AsyncIterator[ThinLine]:
    """Join a port of its own with another one by a line that carries so many bytes a second in each direction."""
    line = ThinLine(target_port, Width(up_bytes_s, down_bytes_s or up_bytes_s, one_way_s))
    await line.open()
    ways = [asyncio.ensure_future(way.run()) for way in (line.up, line.down)]
    try:
        yield line
    finally:
        await line.cut()
        for way in ways:
            way.cancel()
        with suppress(asyncio.CancelledError):
            await asyncio.gather(*ways)
