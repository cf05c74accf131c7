"""`GET /stream`: the state of a surface as server-sent events.

Nothing is queued: each stream reads the newest state at its own pace, so a slow client gets fewer events.

Written by hand, because a client that stops reading must be cut off after a stated time, and all streams must end as
soon as the service stops.
"""

import json
from asyncio import FIRST_COMPLETED, Future, create_task, ensure_future, gather, sleep, wait
from collections.abc import Awaitable
from typing import Annotated, Any

from fastapi import Query
from starlette.responses import Response, StreamingResponse
from starlette.types import Message, Receive, Scope, Send

from beamtouch_service.access import Role
from beamtouch_service.api import gate, openapi
from beamtouch_service.api.context import Context, ContextParameter, SurfaceInPath, SurfaceInQuery
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.state import changing, state_of
from beamtouch_service.surfaces.surface import Surface

MEDIA_TYPE = "text/event-stream"
SEND_S = 5.0
"""A client that takes nothing for this long is dropped. Data in the system's buffers counts as taken."""
_END_S = 0.1
"""At a stop, clients get this long to take the end of their stream."""
_ALIVE_S = 1.0
"""Without a change the state is sent this often, so that a client can tell a quiet surface from a dead connection."""


_INTERVAL = "Shortest time between two events [ms]. An event is sent after a change, and at least every second."
_Interval = Annotated[int, Query(ge=20, le=5000, description=_INTERVAL)]
_PROBLEMS = (Kind.NO_SURFACE, Kind.UNKNOWN_SURFACE, Kind.INVALID_REQUEST, Kind.TOO_MANY_CLIENTS, Kind.STOPPING)

router = gate.make_router("stream", Role.READ)


class Pace:
    """Decides which event a stream sends, and when. Pure: the caller gives the time."""

    def __init__(self) -> None:
        self._sent: dict[str, Any] | None = None
        self._sent_s = 0.0

    def next(self, surface: Surface, now_s: float) -> bytes | None:
        """Return the event to send at `now_s` [s, monotonic], or None if nothing changed."""
        state = state_of(surface, now_s).model_dump(mode="json", exclude_unset=True)
        essence = changing(state)
        if essence == self._sent and now_s - self._sent_s < _ALIVE_S:
            return None
        self._sent, self._sent_s = essence, now_s
        return f"event: state\ndata: {json.dumps(state, allow_nan=False)}\n\n".encode()


class StateStream(Response):
    """Sends the state of a surface until the client leaves, stops reading, or the service stops."""

    def __init__(self, context: Context, surface: Surface, interval_s: float) -> None:
        context.streams.admit()
        super().__init__(headers={"X-Accel-Buffering": "no"}, media_type=MEDIA_TYPE)
        del self.headers["content-length"]
        self._streams = context.streams
        self._surface = surface
        self._clock = context.clock
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
        # A client that has not taken the end by now would hold up the stop of the service.
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


def _responses(*kinds: Kind) -> dict[int | str, dict[str, Any]]:
    events = {"schema": {"type": "string"}, "examples": {"a clear beam": {"value": openapi.STATE_EVENT}}}
    answer = {"description": "Server-sent events named `state`.", "content": {MEDIA_TYPE: events}}
    return {200: answer, **openapi.problems(*kinds)}


@router.get("/stream", response_class=StreamingResponse, responses=_responses(Kind.SURFACE_REQUIRED, *_PROBLEMS))
async def get_stream(
    context: ContextParameter, surface: SurfaceInQuery = None, interval_ms: _Interval = 50
) -> StateStream:
    """Send the state of the only surface, or of the one that is named, as server-sent events."""
    return StateStream(context, context.registry.chosen(surface), interval_ms / 1e3)


@router.get("/surfaces/{name}/stream", response_class=StreamingResponse, responses=_responses(*_PROBLEMS))
async def get_surface_stream(
    context: ContextParameter, name: SurfaceInPath, interval_ms: _Interval = 50
) -> StateStream:
    """Send the state of this surface as server-sent events."""
    return StateStream(context, context.registry.named(name), interval_ms / 1e3)
