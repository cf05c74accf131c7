"""One HTTP connection: bounds on what a client may leave unfinished, and contacts answered without a detour.

A contact that is asked for as most programs ask (`GET`, no body, nothing before it still to be answered) is written
where the request was read, without a task, a scope and the routes: docs/decisions/008-contact-at-once.md. Everything
else takes uvicorn's way to the application.
"""

import asyncio
from typing import TYPE_CHECKING, cast

from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.flow_control import service_unavailable
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

from beamtouch_service import handlers
from beamtouch_service.front import CONTACT_HEADERS, Front, client
from beamtouch_service.problems import Kind, Problem

if TYPE_CHECKING:
    from uvicorn._types import ASGI3Application

HEAD_S = 10.0
"""For a client to send a request line and headers."""
MAX_HEAD_BYTES = 16 * 1024

_HEAD = b"HTTP/1.1 200 OK\r\n" + b"".join(b"%b: %b\r\n" % header for header in CONTACT_HEADERS)
_MORE_TO_COME = frozenset({b"content-length", b"transfer-encoding", b"expect", b"upgrade"})
"""A request with one of these has, or may have, more to it than its head."""


class BoundedProtocol(HttpToolsProtocol):
    """Ends a connection on which a request has begun and does not get on, or whose head is too long."""

    _deadline: asyncio.TimerHandle | None = None
    _head_bytes = 0
    """Of a head that has begun, but for those that came together with the end of the last request."""
    _in_head = True
    _answered = False
    """Whether the request that is being read has its answer already."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Expect a request."""
        super().connection_made(transport)
        self._deadline = self.loop.call_later(HEAD_S, self._give_up)

    def data_received(self, data: bytes) -> None:
        """Take what came; unless it is being answered, expect more of it."""
        self._head_bytes += len(data)
        super().data_received(data)
        if not self._head_bytes or not self._is_owed():
            self._forget()
        elif self._in_head and self._head_bytes > MAX_HEAD_BYTES and not self.transport.is_closing():
            self.send_400_response("The request line and headers are too long.")
        elif self._deadline is None:
            self._deadline = self.loop.call_later(HEAD_S, self._give_up)

    def connection_lost(self, exc: Exception | None) -> None:
        """Expect nothing any more."""
        self._forget()
        super().connection_lost(exc)

    def on_headers_complete(self) -> None:
        """Answer at once where that is possible; else have the application do so."""
        self._in_head = False
        self._answered = self._answer_at_once()
        if not self._answered:
            super().on_headers_complete()

    def on_message_complete(self) -> None:
        """Expect the next request."""
        self._in_head, self._head_bytes = True, 0
        if not self._answered:
            super().on_message_complete()

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: "ASGI3Application") -> None:
        ours = cast("ASGI3Application", self._too_many_clients)
        super()._start_asgi_task(cycle, ours if app is service_unavailable else app)

    async def _too_many_clients(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Say so as every other problem is said, where uvicorn would in plain text (ASGI)."""
        detail = "As many connections are open as there may be; close some, or raise server.max_clients."
        problem = Problem(Kind.TOO_MANY_CLIENTS, detail)
        if isinstance(self.app, Front):
            self.app.context.counts.problem(problem.kind, client(scope))
        await handlers.answer(problem, {"Connection": "close", "Retry-After": "5"})(scope, receive, send)

    def _answer_at_once(self) -> bool:
        if self.transport.is_closing():
            # What follows a request that was the last by its own word.
            return True
        if not isinstance(self.app, Front) or self.parser.get_method() != b"GET" or self._is_busy():
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
            self.on_response_complete()
        else:
            self.transport.close()
        return True

    def _is_busy(self) -> bool:
        """Say whether something else comes first: an earlier request, a client that does not read, too many clients."""
        if not self._is_owed() or self.pipeline or self.flow.write_paused:
            return True
        limit = self.limit_concurrency
        return limit is not None and (len(self.connections) >= limit or len(self.tasks) >= limit)

    def _is_owed(self) -> bool:
        cycle: RequestResponseCycle | None = self.cycle  # it is None before the first request, whatever its type says
        return cycle is None or cycle.response_complete

    def _forget(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _give_up(self) -> None:
        self._deadline = None
        if self._is_owed():
            self.transport.close()
