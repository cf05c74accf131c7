"""The present of a surface as server-sent events: every 50 ms what a page needs to draw it.

A stand-in: it sends all the time, changed or not, and takes the channels to come in the order of the model.
"""

import asyncio
import json
from collections.abc import AsyncIterator
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import StreamingResponse

from beamtouch_service.problems import ProblemError
from beamtouch_service.surface import Surface

_PERIOD_S = 0.05

router = APIRouter(include_in_schema=False)


@router.get("/stream")
async def get_stream(request: Request, surface: str | None = None) -> StreamingResponse:
    """Stream the only surface, or the one that is named."""
    return _answer(request, request.app.state.context.registry.chosen(surface))


@router.get("/surfaces/{name}/stream")
async def get_surface_stream(request: Request, name: str) -> StreamingResponse:
    """Stream this surface."""
    return _answer(request, request.app.state.context.registry.named(name))


def _answer(request: Request, surface: Surface) -> StreamingResponse:
    async def events() -> AsyncIterator[str]:
        while not await request.is_disconnected():
            yield f"event: state\ndata: {json.dumps(_state(surface, request.app.state.context.clock()))}\n\n"
            await asyncio.sleep(_PERIOD_S)

    return StreamingResponse(events(), media_type="text/event-stream", headers={"Cache-Control": "no-store"})


def _state(surface: Surface, now_s: float) -> dict[str, Any]:
    contact, problem = None, None
    try:
        contact = surface.contact(now_s).model_dump(mode="json")
    except ProblemError as error:
        problem = error.problem.body()
    present, metadata = surface._present, surface.model.metadata if surface.model else None
    layout = metadata.layout if metadata else []
    channels = [
        {
            "name": channel.name,
            "position_mm": channel.position_mm,
            "deflection_mm": present.sample.deflection_mm[index] if present else None,
            "quality": present.sample.quality[index] if present else "missing",
        }
        for index, channel in enumerate(layout)
    ]
    return {
        "surface": surface.name,
        "contact": contact,
        "problem": problem,
        "age_ms": present.age_ms(now_s) if present else None,
        "channels": channels,
        "length_mm": metadata.length_mm if metadata else None,
        "sequence": present.sample.sequence if present else None,
    }
