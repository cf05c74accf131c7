"""A serial port on the event loop, for all kinds of lines; also one behind a converter."""

import asyncio
import errno
import os
import termios
from contextlib import suppress
from typing import Literal, NamedTuple

import serial

from beamtouch_common.hosts import tcp_address
from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.converter import Converter, connect
from beamtouch_daemon.sources.host_address import HostAddress
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.traffic import Traffic

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
"""Advice, by the number of the error."""


class LineSettings(NamedTuple):
    """Settings of a serial line with 8 data bits."""

    baud: int
    parity: Parity = "none"
    stop_bits: int = 1


class SerialPort:
    """An open port that no other program can open. Bytes stay in the driver's buffer until somebody asks for them."""

    def __init__(self, path: str, device: serial.Serial | Converter) -> None:
        self.path = path
        self.failure = ""
        """Reason why the port can no longer be used; empty while it can."""
        self.taken_s = uptime_s()
        """Time when bytes were last taken, by the clock of `uptime_s` [s]: those had arrived by then."""
        self.traffic = Traffic(self.taken_s)
        """The bytes that came through it, as noted by the decoders of the line."""
        self._changed = asyncio.Event()
        self._device = device

    def change(self, settings: LineSettings) -> None:
        """Change the settings of the line, without closing the port; SourceError if it does not have them.

        A converter has settings of its own.
        """
        self.traffic.forget()
        if isinstance(self._device, serial.Serial):
            before = self._device.get_settings()
            changes = {
                "baudrate": settings.baud,
                "parity": _PARITIES[settings.parity],
                "stopbits": settings.stop_bits,
            }
            try:
                self._device.apply_settings(changes)
            except (*FAILURES, ValueError) as error:
                with suppress(*FAILURES):
                    self._device.apply_settings(before)  # else the next change would contain what was refused
                raise SourceError(f"{self.path} refuses these settings: {error.args[-1]}") from error

    def close(self, failure: str = "") -> None:
        """Close the port, because of a failure or not.

        After a failure, what is still to be sent is dropped, because a driver may wait half a minute for it to go; and
        a device that DTR resets is reset with the next opening.
        """
        self.failure = self.failure or failure or f"{self.path} is closed"
        if self._device.is_open:
            asyncio.get_running_loop().remove_reader(self._device.fileno())
            with suppress(*FAILURES):  # an unplugged device may complain
                if failure and isinstance(self._device, serial.Serial):
                    _hang_up_on_close(self._device.fileno(), is_on=True)
                    self._device.reset_output_buffer()
            with suppress(OSError):
                self._device.close()
        self._changed.set()

    def send(self, data: bytes) -> None:
        """Send bytes without waiting, as they fit into the driver's buffer; SourceError if they do not."""
        try:
            sent = self._device.write(data)
        except FAILURES as error:
            self.close(f"{self.path} is gone or accepts no data: {error}")
            raise SourceError(self.failure) from error
        if sent != len(data):
            self.close(f"{self.path} accepts no data: its buffer is full")
            raise SourceError(self.failure)

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
                data += (chunk := self._device.read(READ_BYTES))
                if len(chunk) < READ_BYTES // 2:
                    break
        except FAILURES as error:
            self.close(f"{self.path} is gone: {error}")
        return data

    async def _wait(self, within_s: float) -> None:
        """Wait until bytes arrive or the port is closed, at most for this time."""
        loop, line = asyncio.get_running_loop(), self._device.fileno()
        self._changed.clear()
        loop.add_reader(line, self._changed.set)
        try:
            with suppress(TimeoutError):
                async with asyncio.timeout(within_s):
                    await self._changed.wait()
        finally:
            if self._device.is_open:
                loop.remove_reader(line)


class Opener:
    """Opens a port with the same settings each time.

    Parameters
    ----------
    path : Of a serial device, or tcp://HOST:PORT of a converter.
    settings : Of the line.
    """

    def __init__(self, path: str, settings: LineSettings) -> None:
        self._path, self._settings = path, settings
        self._address: HostAddress | None = None
        if "://" in path:
            host, port = tcp_address(path)
            self._address = HostAddress(host, port or 0)

    async def open(self) -> SerialPort:
        """Open the port; SourceError if it cannot be opened with these settings."""
        if self._address is not None:
            return SerialPort(self._path, await connect(self._address))
        return SerialPort(self._path, _open(self._path, self._settings))


def _open(path: str, settings: LineSettings) -> serial.Serial:
    """Open a serial device whose calls never wait; SourceError if it cannot be opened.

    The driver raises DTR with it, which resets many devices. DTR then stays up when the port is closed, so the next
    opening resets nothing.
    """
    baud, parity, stop_bits = settings
    try:
        device = serial.Serial(
            path, baud, parity=_PARITIES[parity], stopbits=stop_bits, timeout=0, write_timeout=0, exclusive=True
        )
        _hang_up_on_close(device.fileno(), is_on=False)
    except (*FAILURES, ValueError) as error:
        code = _number_of(error)
        advice = _ADVICE.get(code, "does it exist, and is no other program using it?")
        reason = os.strerror(code) if code in _ADVICE else error
        raise SourceError(f"{path} cannot be opened ({reason}); {advice}") from error
    return device


def _number_of(error: BaseException | None) -> int:
    """Return the number of an error; 0 without one. For some, pyserial raises another error that has none."""
    if isinstance(error, termios.error):
        return int(error.args[0])
    number = error.errno if isinstance(error, OSError) else None
    return number or (_number_of(error.__context__) if error is not None else 0)


def _hang_up_on_close(line: int, *, is_on: bool) -> None:
    """Say whether the driver lowers DTR and RTS when the port is closed."""
    settings = termios.tcgetattr(line)
    settings[2] = settings[2] | termios.HUPCL if is_on else settings[2] & ~termios.HUPCL
    termios.tcsetattr(line, termios.TCSANOW, settings)
