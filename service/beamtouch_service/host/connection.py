"""One HTTP connection: bounds on what a client may leave unfinished, and contacts answered without a detour.

A contact that is asked for as most programs ask (`GET`, no body, nothing before it still to be answered) is written
where the request was read, without a task, a scope and the routes: docs/decisions/008-contact-at-once.md. Everything
else takes uvicorn's way to the application.
"""

import asyncio
import select
from typing import TYPE_CHECKING, Any, cast

from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol, RequestResponseCycle

from beamtouch_service.api import errors as handlers
from beamtouch_service.api.gate import CONTACT_HEADERS, HEADERS, LIVE_PATH, Front, client
from beamtouch_service.host import heads
from beamtouch_service.host.places import Places, State
from beamtouch_service.problems import Kind, Problem

if TYPE_CHECKING:
    from uvicorn._types import ASGI3Application

HEAD_S = 10.0
"""For a client to send a request line and headers."""
REFUSED_S = 2.0
"""The same without a place; also for a client to read why it was refused before the connection ends."""
UNREAD_S = 60.0
"""For a client to read enough of what was sent to it that more can be sent."""
MAX_AHEAD = 64
"""Requests that may come before the answer to the first of them has been written."""

_HEAD = b"HTTP/1.1 200 OK\r\n" + b"".join(b"%b: %b\r\n" % header for header in CONTACT_HEADERS)
_MORE_TO_COME = frozenset({b"content-length", b"transfer-encoding", b"expect", b"upgrade"})
"""A request with one of these has, or may have, more to it than its head."""


class BoundedProtocol(HttpToolsProtocol):
    """Bounds heads, requests ahead of their answers, answers that nobody reads, and clients."""

    _deadline: asyncio.TimerHandle | None = None
    """For the request that has begun, or is to begin first."""
    _unread_deadline: asyncio.TimerHandle | None = None
    _has_place = False
    """There is one among the connections that may be open; without one every request but a few is refused."""
    _has_token = False
    """One of the requests had a valid token."""
    _is_settled = False
    """The request that is being read has its answer, or gets none."""
    _refusal: Problem | None = None
    """Nothing that follows is read."""

    def __init__(self, *arguments: Any, places: Places["BoundedProtocol"], **options: Any) -> None:  # noqa: ANN401  # uvicorn's
        super().__init__(*arguments, **options)
        self._places = places
        self._framing = heads.Framing()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Expect a request."""
        super().connection_made(transport)
        if not self._take_place():
            surplus = self._places.wait(self)
            if surplus is not None:
                surplus.transport.abort()
        self._deadline = self.loop.call_later(HEAD_S if self._has_place else REFUSED_S, self._give_up)

    def data_received(self, data: bytes) -> None:
        """Take what came; if that is not all of a request, expect the rest soon."""
        start = 0
        while start < len(data) and self._refusal is None:
            end = self._framing.cut(data, start)
            if self._framing.is_too_long(end - start):
                self._refuse(heads.too_long())
                break
            super().data_received(data[start:end])
            self._framing.fed(end - start)
            if self._framing.is_too_long():
                self._refuse(heads.too_long())
            start = end
        if self._refusal is not None:
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
        """Take a header; what comes after a chunked body looks like some, and nobody wants it."""
        if self._framing.in_head and len(self.headers) < heads.MAX_HEADERS:
            super().on_header(name, value)
        elif self._framing.in_head:
            self._refuse(heads.too_long())

    def on_headers_complete(self) -> None:
        """Answer at once where that is possible; else have the application do so."""
        if len(self.pipeline) >= MAX_AHEAD:
            self.transport.abort()
        problem = heads.refusal(self.parser.get_http_version(), self.headers)
        if problem is not None:
            self._refuse(problem)
        self._framing.begin_body(self.headers)
        # What follows the last request of a connection, by its own word or ours, is not looked at.
        self._is_settled = True
        if self.transport.is_closing() or self._refusal is not None:
            return
        self._show_token()
        if not self._answer_at_once():
            super().on_headers_complete()
            self._is_settled = False
            self._note_state()
            if not self._has_place or self.parser.should_upgrade():
                self.cycle.keep_alive = False

    def on_body(self, body: bytes) -> None:
        """Take content."""
        self._framing.content(len(body))
        if not self._is_settled:
            super().on_body(body)

    def on_message_complete(self) -> None:
        """Expect the next request."""
        self._framing.end()
        if not self._is_settled:
            super().on_message_complete()

    def on_response_complete(self) -> None:
        """Answer the next request; read on only when all that were read are answered."""
        super().on_response_complete()
        if self.pipeline:
            self.flow.pause_reading()
        if self.pipeline or self._is_answering():
            return
        self._note_state()
        if self._refusal is not None:
            self._tell(self._refusal)
        elif not self._framing.is_between and self._deadline is None:
            # Answered before all of it was there, or another has begun.
            self._deadline = self.loop.call_later(HEAD_S, self._give_up)

    def send_400_response(self, msg: str) -> None:
        """Say that this is no request."""
        self._refuse(Problem(Kind.BAD_REQUEST, msg))

    def _refuse(self, problem: Problem) -> None:
        """Read nothing more, and say why once the requests before are answered."""
        if self._refusal is not None or self.transport.is_closing():
            return
        self._refusal = problem
        is_answering = self._is_answering()
        if not self._framing.in_head and not self._is_settled:
            # The rest of this request's body will not come.
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
        self._count(problem, self.client[0] if self.client else "unknown")
        answer = handlers.answer(problem, {**HEADERS, "Connection": "close"})
        head = b"".join(b"%b: %b\r\n" % header for header in answer.raw_headers)
        self.transport.write(STATUS_LINE[problem.kind.status] + head + b"\r\n" + answer.body)
        self._forget()
        self._unset_keepalive_if_required()
        if not self.transport.can_write_eof():
            self.transport.close()
            return
        # What is still on its way is read and dropped. To close now would reset the connection, and lose the answer.
        self.transport.write_eof()
        self.flow.resume_reading()
        self._deadline = self.loop.call_later(REFUSED_S, self.transport.close)

    def _unsupported_upgrade_warning(self) -> None:
        """Say nothing, where uvicorn would advise to install something: there is nothing to upgrade to."""

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: "ASGI3Application") -> None:
        # Whether the process lives is nobody's privilege to know.
        refused = not self._has_place and cycle.scope["path"] != LIVE_PATH
        super()._start_asgi_task(cycle, cast("ASGI3Application", self._too_many_clients) if refused else app)

    async def _too_many_clients(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Say so (ASGI)."""
        detail = (
            "As many connections are open as there may be, and none is idle; close some, send a token, or raise "
            "server.max_clients (server.max_clients_per_address)."
        )
        problem = Problem(Kind.TOO_MANY_CLIENTS, detail)
        self._count(problem, client(scope))
        await handlers.answer(problem, {**HEADERS, "Connection": "close", "Retry-After": "5"})(scope, receive, send)

    def _count(self, problem: Problem, address: str) -> None:
        if isinstance(self.app, Front):
            self.app.context.counts.problem(problem.kind, address)

    def _answer_at_once(self) -> bool:
        if not isinstance(self.app, Front) or self.parser.get_method() != b"GET":
            return False
        if not self._has_place or self._is_answering() or self.flow.write_paused:
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
            self._note_state()
        else:
            self.transport.close()
        return True

    def _show_token(self) -> None:
        """Take note of a valid token, the first that the connection bears; without a place, ask for one again."""
        if not self._has_token and isinstance(self.app, Front):
            given = (value for name, value in self.headers if name == b"authorization")
            self._has_token = self.app.knows(next(given, b""))
            if self._has_token:
                self._places.move(self, State.IDLE, has_token=True)
        if not self._has_place:
            self._take_place()

    def _take_place(self) -> bool:
        address = self.client[0] if self.client else "unknown"
        self._has_place, evicted = self._places.take(self, address, has_token=self._has_token)
        if evicted is not None:
            evicted.transport.abort()
            if isinstance(self.app, Front):
                self.app.context.counts.eviction(evicted.client[0] if evicted.client else "unknown")
        return self._has_place

    def _note_state(self) -> None:
        if self.flow.write_paused:
            self._places.move(self, State.UNREAD)
        else:
            self._places.move(self, State.BUSY if self._is_answering() else State.IDLE)

    def has_unread(self) -> bool:
        """Say whether the client has sent something that was not read yet."""
        descriptor = self.transport.get_extra_info("socket").fileno()
        if descriptor < 0:
            return False
        waiting = select.poll()
        waiting.register(descriptor, select.POLLIN)
        return bool(waiting.poll(0))

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
