"""Opening and closing a serial port, for all kinds of lines."""

import contextlib
import errno
import os
import termios

import serial

from beamtouch_daemon.sources.reading import SourceError

READ_BYTES = 4096
"""Largest number of bytes that one call reads."""
FAILURES = (OSError, termios.error)
"""Exceptions of reading and writing once the device is gone."""

_IN_USE = "another program uses it: stop that one"
_ADVICE = {
    errno.EAGAIN: _IN_USE,  # of the lock
    errno.EBUSY: _IN_USE,
    errno.ENOTTY: "correct the path",
    errno.ENOENT: "plug the device in or correct the path",
    errno.EACCES: "this user needs the right to use it, usually as a member of the group dialout",
}
"""What to do, by the number of the error."""


def opened(path: str, baud: int, parity: str = serial.PARITY_NONE, stop_bits: float = 1) -> serial.Serial:
    """Open a port that no other program can open, and whose calls never wait; SourceError if it cannot be opened."""
    try:
        return serial.Serial(path, baud, parity=parity, stopbits=stop_bits, timeout=0, write_timeout=0, exclusive=True)
    except (*FAILURES, ValueError) as error:
        code = error.errno if isinstance(error, OSError) else None
        advice = _ADVICE.get(code or 0, "does it exist, and is no other program using it?")
        reason = os.strerror(code) if code in _ADVICE else error
        message = f"{path} cannot be opened ({reason}); {advice}"
        raise SourceError(message) from error


def close(port: serial.Serial) -> None:
    """Close a port."""
    with contextlib.suppress(OSError):  # an unplugged device may complain
        port.close()
