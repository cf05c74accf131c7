"""One HTTP connection: bounds on what a client may leave unfinished, and contacts answered without a detour.

A contact that is asked for as most programs ask (`GET`, no body, nothing before it still to be answered) is written
where the request was read, without a task, a scope and the routes: docs/decisions/008-contact-at-once.md. Everything
else takes uvicorn's way to the application.
"""

import asyncio
from typing import TYPE_CHECKING, Any, cast

from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from beamtouch_service import handlers
from beamtouch_service.front import CONTACT_HEADERS, HEADERS, LIVE_PATH, Front, client
from beamtouch_service.problems import Kind, Problem

if TYPE_CHECKING:
    from uvicorn._types import ASGI3Application

HEAD_S = 10.0
"""For a client to send a request line and headers."""
REFUSED_S = 2.0
"""The same for one that is too many."""
UNREAD_S = 60.0
"""For a client to read enough of what was sent to it that more can be sent."""
MAX_HEAD_BYTES, MAX_HEADERS = 16 * 1024, 100
MAX_AHEAD = 64
"""Requests that may come before the answer to the first of them has been written."""
MAX_REFUSED = 32
"""Clients beyond those that are allowed who are told so; more are cut off without a word."""

_HEAD = b"HTTP/1.1 200 OK\r\n" + b"".join(b"%b: %b\r\n" % header for header in CONTACT_HEADERS)
_MORE_TO_COME = frozenset({b"content-length", b"transfer-encoding", b"expect", b"upgrade"})
"""A request with one of these has, or may have, more to it than its head."""


class BoundedProtocol(HttpToolsProtocol):
    """Bounds heads, requests ahead of their answers, answers that nobody reads, and clients."""

    _deadline: asyncio.TimerHandle | None = None
    """For the request that has begun, or is to begin first."""
    _unread_deadline: asyncio.TimerHandle | None = None
    _head_bytes = 0
    """Received since the last request was complete."""
    _in_head = True
    _is_refused = False
    """There are too many clients without this one."""
    _is_settled = False
    """The request that is being read has its answer, or gets none."""

    def __init__(self, *arguments: Any, **options: Any) -> None:  # noqa: ANN401  # uvicorn's
        super().__init__(*arguments, **options)
        # uvicorn would refuse the next request of whoever it is; here the newest client is refused.
        self._max_clients, self.limit_concurrency = self.limit_concurrency, None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Expect a request."""
        super().connection_made(transport)
        surplus = len(self.connections) - (self._max_clients or len(self.connections))
        self._is_refused = surplus > 0
        if surplus > MAX_REFUSED:
            transport.abort()
        else:
            self._deadline = self.loop.call_later(REFUSED_S if self._is_refused else HEAD_S, self._give_up)

    def data_received(self, data: bytes) -> None:
        """Take what came; if that is not all of a request, expect the rest soon."""
        self._head_bytes += len(data)
        super().data_received(data)
        if not self._head_bytes or self._is_answering():
            self._forget()
        elif self._in_head and self._head_bytes > MAX_HEAD_BYTES:
            self.send_400_response("The request line and headers are too long.")
        elif self._deadline is None:
            self._deadline = self.loop.call_later(HEAD_S, self._give_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Expect nothing any more."""
        self._forget()
        self._forget_unread()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Wait for the client to read."""
        super().pause_writing()
        self._unread_deadline = self.loop.call_later(UNREAD_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Go on answering."""
        self._forget_unread()
        super().resume_writing()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header; what comes after a chunked body looks like some, and nobody wants it."""
        if self._in_head:
            if len(self.headers) >= MAX_HEADERS:
                message = f"more than {MAX_HEADERS} headers"
                raise ValueError(message)  # the parser stops, and it is a bad request
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Answer at once where that is possible; else have the application do so."""
        self._in_head = False
        if len(self.pipeline) >= MAX_AHEAD:
            self.transport.abort()
        # What follows the last request of a connection, by its own word or ours, is not looked at.
        self._is_settled = self.transport.is_closing() or self._answer_at_once()
        if not self._is_settled:
            super().on_headers_complete()
            if self._is_refused or self.parser.should_upgrade():
                self.cycle.keep_alive = False

    def on_message_complete(self) -> None:
        """Expect the next request."""
        self._in_head, self._head_bytes = True, 0
        if not self._is_settled:
            super().on_message_complete()

    def on_response_complete(self) -> None:
        """Answer the next request; read on only when all that were read are answered."""
        super().on_response_complete()
        if self.pipeline:
            self.flow.pause_reading()
        elif (self._head_bytes or not self._in_head) and self._deadline is None:
            # Answered before all of it was there, or another has begun.
            self._deadline = self.loop.call_later(HEAD_S, self._give_up)

    def send_400_response(self, msg: str) -> None:
        """Say that this is no request, once those before it are answered: a client would take it for their answer."""
        if self._is_answering():
            self.cycle.keep_alive = False
            self.flow.pause_reading()
        elif not self.transport.is_closing():
            problem = Problem(Kind.BAD_REQUEST, msg)
            self._count(problem, self.client[0] if self.client else "unknown")
            answer = handlers.answer(problem, {**HEADERS, "Connection": "close"})
            head = b"".join(b"%b: %b\r\n" % header for header in answer.raw_headers)
            self.transport.write(b"HTTP/1.1 400 Bad Request\r\n" + head + b"\r\n" + answer.body)
            self.transport.close()

    def _unsupported_upgrade_warning(self) -> None:
        """Say nothing, where uvicorn would advise to install something: there is nothing to upgrade to."""

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: "ASGI3Application") -> None:
        # Whether the process lives is nobody's privilege to know.
        refused = self._is_refused and cycle.scope["path"] != LIVE_PATH
        super()._start_asgi_task(cycle, cast("ASGI3Application", self._too_many_clients) if refused else app)

    async def _too_many_clients(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Say so (ASGI)."""
        detail = "As many connections are open as there may be; close some, or raise server.max_clients."
        problem = Problem(Kind.TOO_MANY_CLIENTS, detail)
        self._count(problem, client(scope))
        await handlers.answer(problem, {**HEADERS, "Connection": "close", "Retry-After": "5"})(scope, receive, send)

    def _count(self, problem: Problem, address: str) -> None:
        if isinstance(self.app, Front):
            self.app.context.counts.problem(problem.kind, address)

    def _answer_at_once(self) -> bool:
        if not isinstance(self.app, Front) or self.parser.get_method() != b"GET":
            return False
        if self._is_refused or self._is_answering() or self.flow.write_paused:
            return False
        authorization = None
        for name, value in self.headers:
            if name in _MORE_TO_COME:
                return False
            if name == b"authorization" and authorization is None:
                authorization = value
        body = self.app.contact_at_once(self.url, authorization)
        if body is None:
            return False
        keep_alive = self.parser.should_keep_alive() and self.parser.get_http_version() != "1.0"
        headers = [(b"content-length", b"%d" % len(body)), *self.server_state.default_headers]
        if not keep_alive:
            headers.append((b"connection", b"close"))
        self.transport.write(_HEAD + b"".join(b"%b: %b\r\n" % header for header in headers) + b"\r\n" + body)
        if keep_alive:
            super().on_response_complete()
        else:
            self.transport.close()
        return True

    def _is_answering(self) -> bool:
        """Say whether a request that was read still has no answer; if not, it is for the client to go on."""
        cycle: RequestResponseCycle | None = self.cycle  # it is None before the first request, whatever its type says
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
