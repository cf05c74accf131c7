"""Refusals and deadlines of an HTTP connection."""

import asyncio
from typing import Any

from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol

from beamtouch_service.api import errors
from beamtouch_service.api.gate import HEADERS
from beamtouch_service.host.admission import Clients, address_of, is_answering
from beamtouch_service.problems import Problem

REFUSED_S = 2.0
"""A refused client gets this long to read the answer before the connection ends."""
UNREAD_S = 60.0
"""A client that reads too little of its answers for more to be sent is disconnected after this time."""


class EndingProtocol(HttpToolsProtocol):
    """uvicorn's protocol with deadlines. Bytes that are not a request are answered with a problem.

    uvicorn would answer such bytes at once, in the place of an earlier request's answer.
    """

    deadline: asyncio.TimerHandle | None = None
    """Deadline for the request that has begun, or for the first one to begin."""
    refusal: Problem | None = None
    """The problem because of which nothing more is read."""
    is_over = False
    """Nothing more is read."""
    _unread_deadline: asyncio.TimerHandle | None = None

    def __init__(self, *arguments: Any, clients: Clients, **options: Any) -> None:  # noqa: ANN401  # uvicorn's
        super().__init__(*arguments, **options)
        self.clients = clients

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel all deadlines."""
        self.forget()
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

    def expect(self, within_s: float) -> None:
        """Close the connection unless the client sends a complete request within this time [s]."""
        self.deadline = self.loop.call_later(within_s, self._give_up)

    def forget(self) -> None:
        """Cancel the deadline for a request."""
        if self.deadline is not None:
            self.deadline.cancel()
            self.deadline = None

    def refuse(self, problem: Problem, *, in_body: bool = False) -> None:
        """Read nothing more, and say why once the earlier requests are answered.

        A problem `in_body` takes the place of the answer to the request that it belongs to.
        """
        if self.refusal is not None or self.transport.is_closing():
            return
        self.refusal, self.is_over = problem, True
        has_earlier = is_answering(self)
        if in_body:
            # The rest of this request's body will not be read.
            if self.pipeline and self.pipeline[0][0] is self.cycle:
                self.pipeline.popleft()
                self.cycle.response_complete = True
                self.cycle = self.pipeline[0][0] if self.pipeline else self.cycle
            elif self.cycle.response_started:
                self.transport.close()
                return
            else:
                self.cycle.disconnected, has_earlier = True, False
                self.cycle.message_event.set()
        if not has_earlier:
            self.tell(problem)

    def tell(self, problem: Problem) -> None:
        """Answer with a problem, and end."""
        if self.transport.is_closing():
            return
        self.clients.refused(problem.kind, address_of(self))
        answer = errors.answer(problem, {**HEADERS, "Connection": "close"})
        head = b"".join(b"%b: %b\r\n" % header for header in answer.raw_headers)
        self.transport.write(STATUS_LINE[problem.kind.status] + head + b"\r\n" + answer.body)
        self.finish()

    def finish(self) -> None:
        """Read nothing more, and close once the client has had the time to read its answer."""
        self.is_over = True
        if self.transport.is_closing():
            return
        self.forget()
        self._unset_keepalive_if_required()
        if not self.transport.can_write_eof():
            self.transport.close()
            return
        # Drain what is still on its way: closing now would reset the connection, and the answer would be lost.
        self.transport.write_eof()
        self.flow.resume_reading()
        self.deadline = self.loop.call_later(REFUSED_S, self.transport.close)

    def _forget_unread(self) -> None:
        if self._unread_deadline is not None:
            self._unread_deadline.cancel()
            self._unread_deadline = None

    def _give_up(self) -> None:
        self.deadline = None
        if not is_answering(self):
            self.transport.close()
