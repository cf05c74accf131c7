"""A serial port on the event loop, for all kinds of lines."""

import asyncio
import errno
import os
import termios
from contextlib import suppress
from typing import Literal

import serial

from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.uptime import uptime_s

Parity = Literal["none", "even", "odd"]

READ_BYTES = 4096
"""Largest number of bytes that one call reads."""
MAX_READS = 64
"""Limit of reads at a time: several times the buffers of serial drivers."""
FAILURES = (OSError, termios.error)
"""Exceptions of reading and writing once the device is gone."""

_PARITIES = {"none": serial.PARITY_NONE, "even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD}
_IN_USE = "another program uses it: stop that one"
_ADVICE = {
    errno.EAGAIN: _IN_USE,  # of the lock
    errno.EBUSY: _IN_USE,
    errno.ENOTTY: "correct the path",
    errno.ENOENT: "plug the device in or correct the path",
    errno.EACCES: "this user needs the right to use it, usually as a member of the group dialout",
}
"""What to do, by the number of the error."""


class SerialPort:
    """An open port that no other program can open. Bytes stay in the driver's buffer until somebody asks for them.

    Raises
    ------
    SourceError
        The port cannot be opened with these settings.
    """

    def __init__(self, path: str, baud: int, parity: Parity = "none", stop_bits: int = 1) -> None:
        self.path = path
        self.failure = ""
        """Why the port can no longer be used; empty while it can."""
        self.taken_s = uptime_s()
        """When bytes were last taken, by the clock of `uptime_s` [s]: those had arrived by then."""
        self._changed = asyncio.Event()
        self._serial = _open(path, baud, _PARITIES[parity], stop_bits)

    def close(self, failure: str = "") -> None:
        """Close the port, because of a failure or not."""
        self.failure = self.failure or failure or f"{self.path} is closed"
        if self._serial.is_open:
            asyncio.get_running_loop().remove_reader(self._serial.fileno())
            with suppress(OSError):  # an unplugged device may complain
                self._serial.close()
        self._changed.set()

    def send(self, data: bytes) -> None:
        """Send bytes without waiting, as they fit into the driver's buffer; SourceError if they do not."""
        try:
            sent = self._serial.write(data)
        except FAILURES as error:
            self.close(f"{self.path} is gone or accepts no data: {error}")
            raise SourceError(self.failure) from error
        if sent != len(data):
            failure = f"{self.path} accepts no data: its buffer is full"
            raise SourceError(failure)

    async def receive(self, within_s: float) -> bytes:
        """Wait for bytes and return all that have arrived; none if none come in time, SourceError without a port."""
        received = self.take()
        if not received and not self.failure:
            await self._wait(within_s)
            received = self.take()
        if not received and self.failure:
            raise SourceError(self.failure)
        return received

    def take(self) -> bytes:
        """Return everything that has arrived, because the newest frame determines the age of the others."""
        self.taken_s = uptime_s()
        data = b""
        try:
            for _ in range(MAX_READS if not self.failure else 0):
                data += (chunk := self._serial.read(READ_BYTES))
                if len(chunk) < READ_BYTES // 2:
                    break
        except FAILURES as error:
            self.close(f"{self.path} is gone: {error}")
        return data

    async def _wait(self, within_s: float) -> None:
        """Wait until bytes arrive or the port is closed, at most for this time."""
        loop, line = asyncio.get_running_loop(), self._serial.fileno()
        self._changed.clear()
        loop.add_reader(line, self._changed.set)
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(within_s):
                    await self._changed.wait()
        finally:
            if self._serial.is_open:
                loop.remove_reader(line)


def _open(path: str, baud: int, parity: str, stop_bits: int) -> serial.Serial:
    """Open a port whose calls never wait; SourceError if it cannot be opened."""
    try:
        return serial.Serial(path, baud, parity=parity, stopbits=stop_bits, timeout=0, write_timeout=0, exclusive=True)
    except (*FAILURES, ValueError) as error:
        code = error.errno if isinstance(error, OSError) else None
        advice = _ADVICE.get(code or 0, "does it exist, and is no other program using it?")
        reason = os.strerror(code) if code in _ADVICE else error
        raise SourceError(f"{path} cannot be opened ({reason}); {advice}") from error
