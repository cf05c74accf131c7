"""One HTTP connection: uvicorn's protocol with limits on what a client may send and leave unfinished.

uvicorn has no such bounds: docs/decisions/008-contact-at-once.md. pyproject.toml states the versions whose inner state
(`cycle`, `pipeline`, `flow`) and private methods (`_start_asgi_task`, `_unsupported_upgrade_warning`,
`_unset_keepalive_if_required`) this class and its base were tested with.
"""

import asyncio
from typing import TYPE_CHECKING, cast

import httptools
from uvicorn.protocols.http.httptools_impl import RequestResponseCycle

from beamtouch_service.api.probes import LIVE_PATH
from beamtouch_service.api.samples import ARRIVED_S
from beamtouch_service.host import heads
from beamtouch_service.host.admission import Admission, is_answering
from beamtouch_service.host.ending import REFUSED_S, EndingProtocol
from beamtouch_service.host.places import State
from beamtouch_service.problems import Kind, Problem

if TYPE_CHECKING:
    from uvicorn._types import ASGI3Application

HEAD_S = 10.0
"""Time for a client to send a request line and headers. Without a place, it has only `REFUSED_S`."""
MAX_AHEAD = 64
"""Requests that may wait behind the one that is being answered."""


class BoundedProtocol(EndingProtocol):
    """Bounds heads, requests ahead of their answers, unread answers, and the number of clients."""

    _answering: RequestResponseCycle | None = None
    """The request that the application answers, or the last one that it has answered."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as uvicorn's
        """Expect a request."""
        super().connection_made(transport)
        self.clients.handshakes.end(transport.get_extra_info("peername"))
        self._framing = heads.Framing()
        self._admission = Admission(self.clients, self)
        self.expect(REFUSED_S if self._admission.is_waiting else HEAD_S)

    def data_received(self, data: bytes) -> None:
        """Feed the parser. If a request is incomplete, expect the rest soon."""
        start = 0
        while start < len(data) and not self.is_over and not self.transport.is_closing():
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
        if self.is_over:
            return
        if self._framing.is_between or is_answering(self):
            self.forget()
        elif self.deadline is None:
            self.expect(HEAD_S)

    def connection_lost(self, exc: Exception | None) -> None:
        """Give the place back."""
        self._admission.leave()
        if self._answering is not None:
            # uvicorn tells only the newest request, which may be another one that waits behind this.
            self._answering.disconnected = True
            self._answering.message_event.set()
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """Wait for the client to read."""
        super().pause_writing()
        self._admission.move(State.UNREAD)

    def resume_writing(self) -> None:
        """Go on answering."""
        super().resume_writing()
        self._admission.move(State.IDLE)

    def on_header(self, name: bytes, value: bytes) -> None:
        """Keep a header of the head, within the limits. Trailers of a chunked body arrive here too, and are dropped."""
        if self._framing.in_head and len(self.headers) < heads.MAX_HEADERS:
            super().on_header(name, value)
        elif self._framing.in_head:
            self._refuse(heads.too_long())

    def on_headers_complete(self) -> None:
        """Check the head, and let the application answer."""
        if self._asks_for_upgrade():
            # The parser takes what follows for another protocol. `_unsupported_upgrade_warning` reads the head again.
            return
        if len(self.pipeline) >= MAX_AHEAD:
            self.transport.abort()
        head = heads.fields(self.headers)
        problem = heads.refusal(self.parser.get_http_version(), head)
        if problem is not None:
            self._refuse(problem)
        # What follows the last request of a connection is not looked at.
        if self.transport.is_closing() or self.refusal is not None:
            return
        self._admission.show(head.get(b"authorization", (None,))[0])
        if self.cycle is None:
            # The first request. A connection with a request is not silent, however long the answer takes.
            self._admission.move(State.IDLE)
        super().on_headers_complete()
        self.cycle.scope["state"][ARRIVED_S] = self.clients.arrived_s()
        # Only now: uvicorn raises for some targets, and such a request has no body to read.
        self._framing.begin_body(head.get(b"content-length", (None,))[0])
        if self._admission.is_waiting:
            self.cycle.keep_alive = False

    def on_body(self, body: bytes) -> None:
        """Pass a part of the body to the application, unless the request was refused."""
        self._framing.content(len(body))
        if self.refusal is None and not self.transport.is_closing():
            super().on_body(body)

    def on_message_complete(self) -> None:
        """Expect the next request."""
        if self._asks_for_upgrade():
            return
        self._framing.end()
        if self.refusal is None and not self.transport.is_closing():
            super().on_message_complete()

    def on_response_complete(self) -> None:
        """Answer the next request. Read on only once all requests that were read are answered."""
        super().on_response_complete()
        if self.pipeline:
            self.flow.pause_reading()
        if self.pipeline or is_answering(self):
            return
        if not self.flow.write_paused:
            self._admission.move(State.IDLE)
        if self.refusal is not None:
            self.tell(self.refusal)
        elif self._framing.is_in_chunks:
            # Answered before all of it was there, and it may have no end.
            self.finish()
        elif not self._framing.is_between and self.deadline is None:
            # The request was answered before it was complete, or another one has begun.
            self.expect(HEAD_S)

    def send_400_response(self, msg: str) -> None:
        """Answer bytes that are not a request."""
        self._refuse(Problem(Kind.BAD_REQUEST, msg))

    def _refuse(self, problem: Problem) -> None:
        self.refuse(problem, in_body=not self._framing.in_head)

    def _asks_for_upgrade(self) -> bool:
        return self.parser.should_upgrade() and self.parser.get_method() != b"CONNECT"

    def _unsupported_upgrade_warning(self) -> None:
        """Read a head again without its wish for an upgrade, which a server may ignore (RFC 9110, 7.8)."""
        if not self._asks_for_upgrade():
            return
        method, version = self.parser.get_method(), self.parser.get_http_version().encode()
        kept = b"".join(b"%b: %b\r\n" % header for header in self.headers if header[0] != b"upgrade")
        # A new parser: the last one may read nothing after a request that asks to close the connection.
        self.parser = httptools.HttpRequestParser(self)
        # As uvicorn's own: what follows such a request is dropped.
        self.parser.set_dangerous_leniencies(lenient_data_after_close=True)
        super().data_received(b"%b %b HTTP/%b\r\n%b\r\n" % (method, self.url, version, kept))

    def _start_asgi_task(self, cycle: RequestResponseCycle, app: "ASGI3Application") -> None:
        self._answering = cycle
        # The health check needs no place.
        is_refused = self._admission.is_waiting and cycle.scope["path"] != LIVE_PATH
        super()._start_asgi_task(cycle, cast("ASGI3Application", self.clients.refuse) if is_refused else app)
