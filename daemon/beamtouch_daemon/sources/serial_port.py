"""A serial port on the event loop that sends messages and receives them with their arrival times."""

import asyncio
import contextlib
from typing import NamedTuple

from beamtouch_daemon.sources import port
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.uptime import uptime_s
from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Message

_MAX_READS = 64
"""Limit of reads at a time: several times the buffers of serial drivers."""


class Arrival(NamedTuple):
    """A message and its arrival time."""

    monotonic_s: float
    message: Message


class SerialPort:
    """An open port that no other program can open; its functions raise SourceError."""

    def __init__(self, path: str, baud: int) -> None:
        self._path = path
        self._decoder = Decoder()
        self._arrived: list[Arrival] = []
        self._changed = asyncio.Event()
        self._failure: str | None = None
        self._serial = port.opened(path, baud)
        self._fd = self._serial.fileno()
        asyncio.get_running_loop().add_reader(self._fd, self._read)

    @property
    def rejected(self) -> int:
        """Number of damaged frames since the port was opened."""
        return self._decoder.counts.rejected

    def close(self) -> None:
        """Close the port."""
        asyncio.get_running_loop().remove_reader(self._fd)
        port.close(self._serial)

    def send(self, message: Message) -> None:
        """Send a message without waiting: a command always fits into the driver's buffer."""
        data = encode(message)
        try:
            sent = self._serial.write(data)
        except port.FAILURES as error:
            failure = f"{self._path} accepts no data: {error}"
            raise SourceError(failure) from error
        if sent != len(data):
            failure = f"{self._path} accepts no data: its buffer is full"
            raise SourceError(failure)

    async def receive(self, timeout_s: float) -> list[Arrival]:
        """Wait for at least one message and return all arrivals; empty if none came within `timeout_s`."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._changed.wait()
        self._changed.clear()
        arrived, self._arrived = self._arrived, []
        if not arrived and self._failure:
            raise SourceError(self._failure)
        return arrived

    def _read(self) -> None:
        now_s = uptime_s()
        data = b""
        try:
            # Read everything: the newest frame determines the age of the others.
            for _ in range(_MAX_READS):
                data += (chunk := self._serial.read(port.READ_BYTES))
                if len(chunk) < port.READ_BYTES // 2:
                    break
        except port.FAILURES as error:
            self._failure = f"{self._path} is gone: {error}"
            # A hung-up port stays readable, so the loop would spin.
            asyncio.get_running_loop().remove_reader(self._fd)
            self._changed.set()
            return
        self._arrived += [Arrival(now_s, message) for message in self._decoder.feed(data)]
        if self._arrived:
            self._changed.set()
