"""One HTTP connection: uvicorn's, with bounds on what a client may leave unfinished.

uvicorn has no such bounds: docs/decisions/008-contact-at-once.md. pyproject.toml states the versions whose inner state
(`cycle`, `pipeline`, `flow`) this class was tested with.
"""

import asyncio
import select
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING, Any, cast

from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol, RequestResponseCycle

from beamtouch_service.api import errors
from beamtouch_service.api.gate import HEADERS
from beamtouch_service.api.health import LIVE_PATH
from beamtouch_service.host import heads
from beamtouch_service.host.handshakes import Handshakes
from beamtouch_service.host.places import Places, State
from beamtouch_service.problems import Kind, Problem

if TYPE_CHECKING:
    from uvicorn._types import ASGI3Application

HEAD_S = 10.0
"""For a client to send a request line and headers."""
REFUSED_S = 2.0
"""The same without a place. A refused client also gets this long to read the answer before the connection ends."""
UNREAD_S = 60.0
"""For a client to read enough of its answers that more can be sent."""
MAX_AHEAD = 64
"""Requests that may wait behind the one that is being answered."""


class Standing(Enum):
    """The right of a connection to be served."""

    WAITING = auto()
    """It has no place, so every request except the health check is refused."""
    PLACED = auto()
    """It has a place."""
    TRUSTED = auto()
    """It has a place, and one of its requests had a valid token."""


@dataclass(frozen=True)
class Clients:
    """What the connections of one service share."""

    places: "Places[BoundedProtocol]"
    knows: Callable[[bytes], bool]
    """Says whether an `Authorization` header holds a valid token."""
    refused: Callable[[Kind, str], None]
    """Counts a problem that was answered to an address."""
    evicted: Callable[[str], None]
    """Counts a connection from an address that was closed to make room."""
    handshakes: Handshakes
    """Those under way, if the service speaks HTTPS."""


class BoundedProtocol(HttpToolsProtocol):
    """Bounds heads, requests ahead of their answers, unread answers, and the number of clients."""

    _deadline: asyncio.TimerHandle | None = None
    """For the request that has begun, or for the first one to begin."""
    _unread_deadline: asyncio.TimerHandle | None = None
    _standing = Standing.WAITING
    _refusal: Problem | None = None
    """Why nothing more is read."""
    _is_over = False
    """Nothing more is read."""

    def __init__(self, *arguments: Any, clients: Clients, **options: Any) -> None:  # noqa: ANN401  # uvicorn's
        super().__init__(*arguments, **options)
        self._clients = clients
        self._places = clients.places
        self._framing = heads.Framing()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Expect a request."""
        super().connection_made(transport)
        self._clients.handshakes.end(transport.get_extra_info("peername"))
        self._take_place(has_token=False)
        is_waiting = self._standing is Standing.WAITING
        surplus = self._places.wait(self) if is_waiting else None
        if surplus is not None:
            surplus.transport.abort()
        self._deadline = self.loop.call_later(REFUSED_S if is_waiting else HEAD_S, self._give_up)

    def data_received(self, data: bytes) -> None:
        """Feed the parser. If a request is incomplete, expect the rest soon."""
        start = 0
        while start < len(data) and not self._is_over and not self.transport.is_closing():
            end = self._framing.cut(data, start)
            if self._framing.is_too_long(end - start):
                self._refuse(heads.too_long())
                break
            piece = data[start:end]
            super().data_received(piece)
            self._framing.fed(piece)
            if self._framing.is_too_long():
                self._refuse(heads.too_long())
            start = end
        if self._is_over:
            return
        if self._framing.is_between or self._is_answering():
            self._forget()
        elif self._deadline is None:
            self._deadline = self.loop.call_later(HEAD_S, self._give_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Expect nothing any more."""
        self._places.leave(self)
        self._forget()
        self._forget_unread()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Wait for the client to read."""
        super().pause_writing()
        self._note_state()
        self._unread_deadline = self.loop.call_later(UNREAD_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on answering."""
        self._forget_unread()
        super().resume_writing()
        self._note_state()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header. Trailers of a chunked body also come here, and are dropped."""
        if self._framing.in_head and len(self.headers) < heads.MAX_HEADERS:
            super().on_header(name, value)
        elif self._framing.in_head:
            self._refuse(heads.too_long())

    def on_headers_complete(self) -> None:
        """Check the head, and let the application answer."""
        if len(self.pipeline) >= MAX_AHEAD:
            self.transport.abort()
        problem = heads.refusal(self.parser.get_http_version(), self.headers)
        if problem is not None:
            self._refuse(problem)
        # What follows the last request of a connection is not looked at.
        if self.transport.is_closing() or self._refusal is not None:
            return
        self._take_note_of_token()
        super().on_headers_complete()
        # Only now: uvicorn raises for some targets, and such a request has no body to read.
        self._framing.begin_body(self.headers)
        self._note_state()
        if self._standing is Standing.WAITING or self.parser.should_upgrade():
            self.cycle.keep_alive = False

    def on_body(self, body: bytes) -> None:
        """Take content."""
        self._framing.content(len(body))
        if self._refusal is None and not self.transport.is_closing():
            super().on_body(body)

    def on_message_complete(self) -> None:
        """Expect the next request."""
        self._framing.end()
        if self._refusal is None and not self.transport.is_closing():
            super().on_message_complete()

    def on_response_complete(self) -> None:
        """Answer the next request. Read on only once all requests that were read are answered."""
        super().on_response_complete()
        if self.pipeline:
            self.flow.pause_reading()
        if self.pipeline or self._is_answering():
            return
        self._note_state()
        if self._refusal is not None:
            self._tell(self._refusal)
        elif self._framing.is_in_chunks:
            # Answered before all of it was there, and it may have no end.
            self._finish()
        elif not self._framing.is_between and self._deadline is None:
            # The request was answered before it was complete, or another one has begun.
            self._deadline = self.loop.call_later(HEAD_S, self._give_up)

    def send_400_response(self, msg: str) -> None:
        """Answer bytes that are not a request."""
        self._refuse(Problem(Kind.BAD_REQUEST, msg))

    def _refuse(self, problem: Problem) -> None:
        """Read nothing more. Say why once the earlier requests are answered."""
        if self._refusal is not None or self.transport.is_closing():
            return
        self._refusal, self._is_over = problem, True
        is_answering = self._is_answering()
        if not self._framing.in_head:
            # The rest of this request's body will not be read.
            if self.pipeline and self.pipeline[0][0] is self.cycle:
                self.pipeline.popleft()
                self.cycle.response_complete = True
                self.cycle = self.pipeline[0][0] if self.pipeline else self.cycle
            elif self.cycle.response_started:
                self.transport.close()
                return
            else:
                self.cycle.disconnected, is_answering = True, False
                self.cycle.message_event.set()
        if not is_answering:
            self._tell(problem)

    def _tell(self, problem: Problem) -> None:
        if self.transport.is_closing():
            return
        self._clients.refused(problem.kind, self.client[0] if self.client else "unknown")
        answer = errors.answer(problem, {**HEADERS, "Connection": "close"})
        head = b"".join(b"%b: %b\r\n" % header for header in answer.raw_headers)
        self.transport.write(STATUS_LINE[problem.kind.status] + head + b"\r\n" + answer.body)
        self._finish()

    def _finish(self) -> None:
        """Read nothing more, and close once the client has had the time to read its answer."""
        self._is_over = True
        if self.transport.is_closing():
            return
        self._forget()
        self._unset_keepalive_if_required()
        if not self.transport.can_write_eof():
            self.transport.close()
            return
        # Drain what is still on its way: closing now would reset the connection, and the answer would be lost.
        self.transport.write_eof()
        self.flow.resume_reading()
        self._deadline = self.loop.call_later(REFUSED_S, self.transport.close)

    def _unsupported_upgrade_warning(self) -> None:
        """Write no log line. uvicorn's advises to install a package, but there is nothing to upgrade to."""

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: "ASGI3Application") -> None:
        # The health check needs no place.
        refused = self._standing is Standing.WAITING and cycle.scope["path"] != LIVE_PATH
        super()._start_asgi_task(cycle, cast("ASGI3Application", self._too_many_clients) if refused else app)

    async def _too_many_clients(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request of a connection without a place (ASGI)."""
        detail = (
            "All connections are in use and none is idle. Close some, send a token, or raise "
            "server.max_clients (server.max_clients_per_address)."
        )
        problem = Problem(Kind.TOO_MANY_CLIENTS, detail)
        self._clients.refused(problem.kind, errors.client(scope))
        await errors.answer(problem, {**HEADERS, "Connection": "close", "Retry-After": "5"})(scope, receive, send)

    def _take_note_of_token(self) -> None:
        """Take note of the first valid token of the connection. Without a place, ask for one again."""
        if self._standing is Standing.TRUSTED:
            return
        given = next((value for name, value in self.headers if name == b"authorization"), b"")
        has_token = bool(given) and self._clients.knows(given)
        if self._standing is Standing.WAITING:
            self._take_place(has_token=has_token)
        elif has_token:
            self._standing = Standing.TRUSTED
            self._places.move(self, State.IDLE, has_token=True)

    def _take_place(self, *, has_token: bool) -> None:
        address = self.client[0] if self.client else "unknown"
        is_placed, evicted = self._places.take(self, address, has_token=has_token)
        if is_placed:
            self._standing = Standing.TRUSTED if has_token else Standing.PLACED
        if evicted is not None:
            evicted.transport.abort()
            self._clients.evicted(evicted.client[0] if evicted.client else "unknown")

    def _note_state(self) -> None:
        if self.flow.write_paused:
            self._places.move(self, State.UNREAD)
        else:
            self._places.move(self, State.BUSY if self._is_answering() else State.IDLE)

    def has_unread(self) -> bool:
        """Return whether the client has sent bytes that were not read yet."""
        descriptor = self.transport.get_extra_info("socket").fileno()
        if descriptor < 0:
            return False
        waiting = select.poll()
        waiting.register(descriptor, select.POLLIN)
        return bool(waiting.poll(0))

    def _is_answering(self) -> bool:
        """Return whether a request that was read still has no answer. If not, it is the client's turn."""
        cycle: RequestResponseCycle | None = (
            self.cycle
        )  # None before the first request, although its type does not say so
        return cycle is not None and not cycle.response_complete

    def _forget(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _forget_unread(self) -> None:
        if self._unread_deadline is not None:
            self._unread_deadline.cancel()
            self._unread_deadline = None

    def _give_up(self) -> None:
        self._deadline = None
        if not self._is_answering():
            self.transport.close()
