"""The state of a surface as server-sent events.

Nothing is queued for anyone: each stream looks at the present at its own pace, so a slow client sees less and costs no
more. A client that does not read is dropped, and all streams end as soon as the service is told to stop.
"""

import json
from asyncio import FIRST_COMPLETED, Event, Future, create_task, ensure_future, gather, sleep, wait
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

from starlette.responses import Response
from starlette.types import Message, Receive, Scope, Send

from beamtouch_service.api.context import Clock
from beamtouch_service.api.errors import NO_STORE
from beamtouch_service.defaults import MAX_STREAMS
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.surfaces.state import changing, state_of
from beamtouch_service.surfaces.surface import Surface

MEDIA_TYPE = "text/event-stream"
SEND_S = 5.0
"""A client that takes nothing for this long is dropped; what the system buffers counts as taken."""
_END_S = 0.1
_ALIVE_S = 1.0
"""Without a change the state is sent this often, so that a client can tell a quiet surface from a dead line."""


@dataclass
class Streams:
    """The open streams of one service."""

    most: int = MAX_STREAMS
    stop: Event = field(default_factory=Event)
    """Set when the service stops."""
    drop: Callable[[Scope], None] = lambda _scope: None
    """Ends the connection of a request without waiting for its client; given by whoever owns the connections."""
    open: int = 0

    def admit(self) -> None:
        """Count one stream more; raises ProblemError if there are too many, or the service stops."""
        if self.stop.is_set():
            raise ProblemError(Problem(Kind.STOPPING, "Open the stream again once the service is back."))
        if self.open >= self.most:
            detail = f"{self.most} streams are open, the most there may be; close one, or raise server.max_streams."
            raise ProblemError(Problem(Kind.TOO_MANY_CLIENTS, detail), {"Retry-After": "5"})
        self.open += 1


class Pace:
    """Decides what a stream sends, and when. Pure: instants come in."""

    def __init__(self) -> None:
        self._sent: dict[str, Any] | None = None
        self._sent_s = 0.0

    def next(self, surface: Surface, now_s: float) -> bytes | None:
        """Return the event to send at `now_s` [s, monotonic], None if nothing changed lately."""
        state = state_of(surface, now_s).model_dump(mode="json", exclude_unset=True)
        essence = changing(state)
        if essence == self._sent and now_s - self._sent_s < _ALIVE_S:
            return None
        self._sent, self._sent_s = essence, now_s
        return f"event: state\ndata: {json.dumps(state, allow_nan=False)}\n\n".encode()


class StateStream(Response):
    """Sends the state of a surface until the client leaves, stops reading, or the service stops."""

    def __init__(self, streams: Streams, surface: Surface, clock: Clock, interval_s: float) -> None:
        streams.admit()
        super().__init__(headers={**NO_STORE, "X-Accel-Buffering": "no"}, media_type=MEDIA_TYPE)
        del self.headers["content-length"]
        self._streams = streams
        self._surface = surface
        self._clock = clock
        self._interval_s = interval_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one client."""
        over: set[Future[Any]] = {create_task(self._streams.stop.wait()), create_task(_disconnected(receive))}
        try:
            await self._serve(scope, send, over)
        finally:
            self._streams.open -= 1
            await _cancel(over)

    async def _serve(self, scope: Scope, send: Send, over: set[Future[Any]]) -> None:
        start: Message = {"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers}
        going, pace = await _sent(send(start), over), Pace()
        while going and not any(task.done() for task in over):
            event = pace.next(self._surface, self._clock())
            if event:
                going = await _sent(send({"type": "http.response.body", "body": event, "more_body": True}), over)
            await wait(over, timeout=self._interval_s, return_when=FIRST_COMPLETED)
        if going and self._streams.stop.is_set():
            await _sent(send({"type": "http.response.body", "body": b""}), set(), _END_S)
            await sleep(_END_S)
        # Who has not taken the end by now would hold up the service.
        self._streams.drop(scope)


async def _disconnected(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


async def _sent(sending: Awaitable[None], over: set[Future[Any]], patience_s: float = SEND_S) -> bool:
    """Wait for a send, but no longer than `patience_s` [s] and not beyond the end; return whether it went out."""
    task = ensure_future(sending)
    await wait({task, *over}, timeout=patience_s, return_when=FIRST_COMPLETED)
    if not task.done():
        await _cancel({task})
        return False
    return task.exception() is None


async def _cancel(tasks: set[Future[Any]]) -> None:
    for task in tasks:
        task.cancel()
    await gather(*tasks, return_exceptions=True)
