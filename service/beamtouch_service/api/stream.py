"""`GET /stream`: the state of a surface as server-sent events.

Nothing is queued: each stream reads the newest state at its own pace, so a slow client gets fewer events.

A client that takes nothing for some seconds is dropped by the system (`address.py`).
"""

import json
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import Query
from fastapi.sse import format_sse_event
from starlette.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import Context, ContextParameter, SurfaceInPath, SurfaceInQuery
from beamtouch_service.surfaces.fields import members_of
from beamtouch_service.surfaces.pace import Pace
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.view import ChannelView, View
from beamtouch_service.surfaces.watch import Watch

MEDIA_TYPE = "text/event-stream"
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
        "contact": None if view.problem else members_of(view),
        "problem": view.problem and view.problem.body(),
        "misfit_limit": view.misfit_limit,
        "age_ms": view.age_ms,
        "channels": [_channel(channel) for channel in view.channels],
        "length_mm": view.drawn_by.metadata.length_mm if view.drawn_by else None,
        "width_mm": view.drawn_by.metadata.width_mm if view.drawn_by else None,
        "sequence": view.sequence,
    }


def _channel(channel: ChannelView) -> dict[str, Any]:
    place_mm = {f"{axis}_mm": at_mm for axis, at_mm in channel.place_mm.items()}
    shown = {"deflection_mm": channel.deflection_mm, "quality": channel.quality, "unit": channel.unit}
    return {"name": channel.name, **place_mm, **shown}


class StateStream(StreamingResponse):
    """Sends the state of a surface until the client leaves or is dropped, or the service stops."""

    def __init__(self, context: Context, surface: Surface, interval_s: float) -> None:
        context.streams.admit()
        self._context, self._surface = context, surface
        pace = Pace([surface], interval_s, tells_status_at_once=False)
        self._watch = Watch([surface], pace, context.clock)
        # nginx would collect the events otherwise.
        headers = {"X-Accel-Buffering": "no"}
        super().__init__(self._events(), headers=headers, media_type=MEDIA_TYPE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one client."""
        streams, watch = self._context.streams, self._watch
        try:
            with watch.listening(), streams.ends.told(lambda _: watch.wake()):
                await super().__call__(scope, receive, send)
        finally:
            streams.open -= 1

    async def _events(self) -> AsyncIterator[bytes]:
        while not self._context.streams.is_stopping:
            for surface in self._watch.take_due():
                state = json.dumps(state_of(surface.view(self._context.clock())), allow_nan=False)
                yield format_sse_event(event="state", data_str=state)
            await self._watch.wait()


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
