"""The routes of the stream."""

from typing import Annotated, Any

from fastapi import APIRouter, Query
from fastapi.responses import StreamingResponse

from beamtouch_service.api import openapi as documentation
from beamtouch_service.api import stream as streams
from beamtouch_service.api.context import Clock, SurfaceInPath
from beamtouch_service.api.stream import StateStream, Streams
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.registry import Registry

_INTERVAL = "At most one event in this time [ms]; one is sent when something changed, and at least every second."
_Interval = Annotated[int, Query(ge=20, le=5000, description=_INTERVAL)]
_PROBLEMS = (Kind.NO_SURFACE, Kind.UNKNOWN_SURFACE, Kind.INVALID_REQUEST, Kind.TOO_MANY_CLIENTS, Kind.STOPPING)


def _responses(*kinds: Kind) -> dict[int | str, dict[str, Any]]:
    events = {"schema": {"type": "string"}, "examples": {"a clear beam": {"value": documentation.STATE_EVENT}}}
    answer = {"description": "Server-sent events named `state`.", "content": {streams.MEDIA_TYPE: events}}
    return {200: answer, **documentation.problems(*kinds)}


def make_router(registry: Registry, clock: Clock, open_streams: Streams) -> APIRouter:
    """Return the routes of the stream over these surfaces."""
    router = APIRouter(tags=["stream"])

    @router.get("/stream", response_class=StreamingResponse, responses=_responses(Kind.SURFACE_REQUIRED, *_PROBLEMS))
    async def get_stream(
        surface: Annotated[str | None, Query(description="Name of the surface; needed when there are several.")] = None,
        interval_ms: _Interval = 50,
    ) -> StateStream:
        """Send the state of the only surface, or of the one that is named, as server-sent events."""
        return StateStream(open_streams, registry.chosen(surface), clock, interval_ms / 1e3)

    @router.get("/surfaces/{name}/stream", response_class=StreamingResponse, responses=_responses(*_PROBLEMS))
    async def get_surface_stream(
        name: SurfaceInPath,
        interval_ms: _Interval = 50,
    ) -> StateStream:
        """Send the state of this surface as server-sent events."""
        return StateStream(open_streams, registry.named(name), clock, interval_ms / 1e3)

    return router
