"""A serial port on the event loop that sends messages and receives them with their arrival times."""

import asyncio
import contextlib
import termios
from time import monotonic
from typing import NamedTuple

import serial

from beamtouch_daemon.sources.reading import SourceError
from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Message

_READ_BYTES = 4096
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
        try:
            self._serial = serial.Serial(path, baud, timeout=0, write_timeout=0, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            message = f"{path} cannot be opened: {error}"
            raise SourceError(message) from error
        self._fd = self._serial.fileno()
        asyncio.get_running_loop().add_reader(self._fd, self._read)

    @property
    def rejected(self) -> int:
        """Number of damaged frames since the port was opened."""
        return self._decoder.counts.rejected

    def close(self) -> None:
        """Close the port."""
        asyncio.get_running_loop().remove_reader(self._fd)
        with contextlib.suppress(OSError):  # an unplugged device may complain
            self._serial.close()

    def send(self, message: Message) -> None:
        """Send a message without waiting: a command always fits into the driver's buffer."""
        data = encode(message)
        try:
            sent = self._serial.write(data)
        except (OSError, termios.error) as error:
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
        now_s = monotonic()
        data = b""
        try:
            # Read everything: the newest frame determines the age of the others.
            for _ in range(_MAX_READS):
                data += (chunk := self._serial.read(_READ_BYTES))
                if len(chunk) < _READ_BYTES // 2:
                    break
        except (OSError, termios.error) as error:
            self._failure = f"{self._path} is gone: {error}"
            # A hung-up port stays readable, so the loop would spin.
            asyncio.get_running_loop().remove_reader(self._fd)
            self._changed.set()
            return
        self._arrived += [Arrival(now_s, message) for message in self._decoder.feed(data)]
        if self._arrived:
            self._changed.set()
