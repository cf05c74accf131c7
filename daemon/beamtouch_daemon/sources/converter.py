"""A serial line behind a converter, which passes its bytes on over TCP as they are."""

import asyncio
import socket

from beamtouch_daemon.sources.host_address import HostAddress, UnknownHostError, no_connection
from beamtouch_daemon.sources.reading import SourceError

CONNECT_S = 2.0
"""Timeout of the look-up of its name, and of the connection."""


class Converter:
    """A connection to a serial converter, with the calls of a serial port of pyserial. None of them waits."""

    def __init__(self, connected: socket.socket) -> None:
        self.is_open = True
        self._socket = connected

    def fileno(self) -> int:
        """Return the descriptor that can be waited for."""
        return self._socket.fileno()

    def read(self, most: int) -> bytes:
        """Return bytes that have arrived; OSError if the converter has ended the connection."""
        try:
            data = self._socket.recv(most)
        except BlockingIOError:
            return b""
        if not data:
            raise ConnectionError("it has closed the connection")
        return data

    def write(self, data: bytes) -> int:
        """Send bytes, and return how many of them went."""
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0

    def close(self) -> None:
        """End the connection."""
        self.is_open = False
        self._socket.close()


async def connect(address: HostAddress) -> Converter:
    """Connect to a converter; SourceError if that is impossible."""
    try:
        resolved = await address.resolve(CONNECT_S)
        connection = socket.socket(socket.AF_INET6 if ":" in resolved else socket.AF_INET)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            async with asyncio.timeout(CONNECT_S):
                await asyncio.get_running_loop().sock_connect(connection, (resolved, address.port))
        except BaseException:
            connection.close()
            raise
    except UnknownHostError as error:
        raise SourceError(str(error)) from error
    except OSError as error:  # also a timeout
        raise SourceError(no_connection(address)) from error
    return Converter(connection)
