"""TLS handshakes in progress: limited where connections are accepted, before they cost anything."""

import gc
import socket
from contextlib import suppress
from typing import Any

from beamtouch_service.host.places import Places

HANDSHAKE_S = 5.0
"""Time for a client to complete its TLS handshake. A slow controller needs a second or two."""
MAX_HANDSHAKES = 128
"""Handshakes at a time. Each takes half a megabyte."""
MAX_HANDSHAKES_PER_ADDRESS = 64

Peer = tuple[Any, ...]


class Handshakes:
    """The running handshakes of one service. Above the limit, the oldest of the address with the most ends."""

    def __init__(self) -> None:
        self._places: Places[Peer] = Places(MAX_HANDSHAKES, MAX_HANDSHAKES_PER_ADDRESS, lambda _: False)
        self._sockets: dict[Peer, socket.socket] = {}
        self._ended = 0
        """Handshakes that were ended to make room."""

    def begin(self, connection: socket.socket, peer: Peer) -> None:
        """Note a connection that was accepted from this address."""
        for other in [other for other, held in self._sockets.items() if held.fileno() < 0]:
            self.end(other)
        _, oldest = self._places.take(peer, peer[0])
        if oldest is not None:
            # The event loop owns this socket. It reads the end of the stream, and closes it.
            with suppress(OSError):
                self._sockets.pop(oldest).shutdown(socket.SHUT_RDWR)
            self._ended += 1
            if self._ended % MAX_HANDSHAKES == 0:
                # asyncio leaves each in a reference cycle, and nothing else collects these soon enough.
                gc.collect()
        self._sockets[peer] = connection

    def end(self, peer: Peer) -> None:
        """Note that the handshake of this address is over, if there was one."""
        if self._sockets.pop(peer, None) is not None:
            self._places.leave(peer)


class TlsListener(socket.socket):
    """A listening socket that reports accepted connections to `handshakes`."""

    def __init__(self, listener: socket.socket, handshakes: Handshakes) -> None:
        """Replace `listener`, which cannot be used afterwards."""
        super().__init__(listener.family, listener.type, listener.proto, fileno=listener.detach())
        self._handshakes = handshakes

    def accept(self) -> tuple[socket.socket, Peer]:
        """Accept a connection as every socket does."""
        connection, peer = super().accept()
        self._handshakes.begin(connection, peer)
        return connection, peer
