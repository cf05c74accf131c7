"""`GET /stream`: the state of a surface as server-sent events.

Nothing is queued: each stream reads the newest state at its own pace, so a slow client gets fewer events.

A client that takes nothing for some seconds is dropped by the system (`address.py`).
"""

import json
from asyncio import wait_for
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Annotated, Any

from fastapi import Query
from fastapi.sse import format_sse_event
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import Context, ContextParameter, SurfaceInPath, SurfaceInQuery
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.view import View, contact_of

MEDIA_TYPE = "text/event-stream"
_ALIVE_S = 1.0
"""Without a change the state is sent this often, so that a client can tell a quiet surface from a dead connection."""

_INTERVAL = "Shortest time between two events [ms]. An event is sent after a change, and at least every second."
_Interval = Annotated[int, Query(ge=20, le=5000, description=_INTERVAL)]
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"description": "Server-sent events named `state`.", "content": {MEDIA_TYPE: {"schema": {"type": "string"}}}}
}

router = gate.make_router("stream", Role.READ)


def state_of(view: View) -> dict[str, Any]:
    """Return the data of an event `state`: a contact or the problem that prevents it, and the channels."""
    return {
        "surface": view.surface,
        "contact": None if view.problem else contact_of(view).model_dump(mode="json"),
        "problem": view.problem and view.problem.body(),
        "misfit_limit": view.misfit_limit,
        "age_ms": view.age_ms,
        "channels": [channel._asdict() for channel in view.channels],
        "length_mm": view.model.metadata.length_mm if view.model else None,
        "sequence": view.sequence,
    }


def _essence_of(state: dict[str, Any]) -> dict[str, Any]:
    """Return a state without the members that change by time alone."""
    essence = state | {"age_ms": None}
    for name in ("contact", "problem"):
        if essence[name]:
            # The detail of a stale contact contains its age.
            essence[name] = {key: value for key, value in essence[name].items() if key not in ("age_ms", "detail")}
    return essence


class Pace:
    """Chooses the events of a stream and their times. Pure: the caller gives the time."""

    def __init__(self) -> None:
        self._sent: dict[str, Any] | None = None
        self._sent_s = 0.0

    def next(self, surface: Surface, now_s: float) -> str | None:
        """Return the data of the event to send at `now_s` [s, monotonic], or None if nothing changed."""
        state = state_of(surface.view(now_s))
        essence = _essence_of(state)
        if essence == self._sent and now_s - self._sent_s < _ALIVE_S:
            return None
        self._sent, self._sent_s = essence, now_s
        return json.dumps(state, allow_nan=False)


class StateStream(StreamingResponse):
    """Sends the state of a surface until the client leaves or is dropped, or the service stops."""

    def __init__(self, context: Context, surface: Surface, interval_s: float) -> None:
        context.streams.admit()
        self._streams = context.streams
        # nginx would collect the events otherwise.
        headers = {"X-Accel-Buffering": "no"}
        super().__init__(self._events(context, surface, interval_s), headers=headers, media_type=MEDIA_TYPE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one client."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._streams.open -= 1

    async def _events(self, context: Context, surface: Surface, interval_s: float) -> AsyncIterator[bytes]:
        pace, stop = Pace(), self._streams.stop
        while not stop.is_set():
            data = pace.next(surface, context.clock())
            if data:
                yield format_sse_event(event="state", data_str=data)
            with suppress(TimeoutError):
                await wait_for(stop.wait(), interval_s)


@router.get("/stream", response_class=StreamingResponse, responses=_RESPONSES)
async def get_stream(
    context: ContextParameter, surface: SurfaceInQuery = None, interval_ms: _Interval = 50
) -> StateStream:
    """Send the state of the only surface, or of the one that is named, as server-sent events."""
    context.require_all("Ask for /surfaces/NAME/stream.")
    return StateStream(context, context.registry.chosen(surface), interval_ms / 1e3)


@router.get("/surfaces/{name}/stream", response_class=StreamingResponse, responses=_RESPONSES)
async def get_surface_stream(
    context: ContextParameter, name: SurfaceInPath, interval_ms: _Interval = 50
) -> StateStream:
    """Send the state of this surface as server-sent events."""
    return StateStream(context, context.registry.named(name), interval_ms / 1e3)
