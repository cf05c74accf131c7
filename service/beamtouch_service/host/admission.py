"""The right of one connection to be served: its place, and whether it has shown a token."""

import select
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from beamtouch_service.api import errors
from beamtouch_service.api.gate import HEADERS
from beamtouch_service.host.handshakes import Handshakes
from beamtouch_service.host.places import Places, State
from beamtouch_service.problems import Kind, Problem

_TOO_MANY = Problem(
    Kind.TOO_MANY_CLIENTS,
    "All connections are in use and none is idle. Close some, send a token, or raise "
    "server.max_clients (server.max_clients_per_address).",
)


@dataclass(frozen=True)
class Clients:
    """State that all connections of one service share."""

    places: Places[HttpToolsProtocol]
    knows: Callable[[bytes], bool]
    """Says whether an `Authorization` header holds a valid token."""
    refused: Callable[[Kind, str], None]
    """Counts a problem that was answered to an address."""
    evicted: Callable[[str], None]
    """Counts a connection from an address that was closed to make room."""
    handshakes: Handshakes
    """The TLS handshakes under way, if the service speaks HTTPS."""
    arrived_s: Callable[[], float]
    """Returns the earliest time at which what is read now may have arrived [s]."""

    async def refuse(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request of a connection without a place (ASGI)."""
        self.refused(_TOO_MANY.kind, errors.client(scope))
        headers = {**HEADERS, "Connection": "close", "Retry-After": "5"}
        await errors.answer(_TOO_MANY, headers)(scope, receive, send)


class _Standing(Enum):
    WAITING = auto()
    """It has no place, so every request except the health check is refused."""
    PLACED = auto()
    TRUSTED = auto()
    """It has a place, and one of its requests had a valid token."""


class Admission:
    """The standing of one connection among all of them."""

    def __init__(self, clients: Clients, connection: HttpToolsProtocol) -> None:
        """Take a place if there is one; otherwise wait, and close the first of those that wait if they are many."""
        self._clients = clients
        self._connection = connection
        self._standing = _Standing.WAITING
        self._take(has_token=False)
        surplus = clients.places.wait(connection) if self.is_waiting else None
        if surplus is not None:
            surplus.transport.abort()

    @property
    def is_waiting(self) -> bool:
        """Whether the connection has no place."""
        return self._standing is _Standing.WAITING

    def show(self, authorization: bytes | None) -> None:
        """Take note of the first valid token of the connection. Without a place, ask for one again."""
        if self._standing is _Standing.TRUSTED:
            return
        has_token = bool(authorization) and self._clients.knows(authorization or b"")
        if self.is_waiting:
            self._take(has_token=has_token)
        elif has_token:
            self._standing = _Standing.TRUSTED
            self._clients.places.move(self._connection, State.IDLE, has_token=True)

    def move(self, state: State) -> None:
        """Note what the connection waits for from now on."""
        self._clients.places.move(self._connection, state)

    def leave(self) -> None:
        """Give the place back."""
        self._clients.places.leave(self._connection)

    def _take(self, *, has_token: bool) -> None:
        address = address_of(self._connection)
        is_placed, evicted = self._clients.places.take(self._connection, address, has_token=has_token)
        if is_placed:
            self._standing = _Standing.TRUSTED if has_token else _Standing.PLACED
        if evicted is not None:
            evicted.transport.abort()
            self._clients.evicted(address_of(evicted))


def address_of(connection: HttpToolsProtocol) -> str:
    """Return the address of the client."""
    return connection.client[0] if connection.client else "unknown"


def is_answering(connection: HttpToolsProtocol) -> bool:
    """Return whether a request that was read still has no answer. If not, it is the client's turn."""
    # None before the first request, although its type does not say so.
    cycle: RequestResponseCycle | None = connection.cycle
    return cycle is not None and not cycle.response_complete


def is_busy(connection: HttpToolsProtocol) -> bool:
    """Return whether a request is being answered, or the client has sent bytes that were not read yet."""
    if is_answering(connection):
        return True
    descriptor = connection.transport.get_extra_info("socket").fileno()
    if descriptor < 0:
        return False
    waiting = select.poll()
    waiting.register(descriptor, select.POLLIN)
    return bool(waiting.poll(0))
