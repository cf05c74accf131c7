"""`GET /health`: checks that the process answers, and that every surface can answer `GET /contact`."""

from typing import Annotated

from fastapi import Query
from pydantic import BaseModel

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import ContextParameter

live_router = gate.make_router("health", Role.OPEN)
ready_router = gate.make_router("health", Role.READ)

_HEALTH = "Also require that no sensor is out, or has changed for certain."


class Health(BaseModel):
    """The answer of a health check that passed."""

    status: str


@live_router.get("/health/live")
async def get_live() -> Health:
    """Say that the process runs and answers."""
    return Health(status="live")


@ready_router.get("/health/ready")
async def get_ready(context: ContextParameter, health: Annotated[bool, Query(description=_HEALTH)] = False) -> Health:
    """Check that every surface has a model and fresh samples, and that every address, broker and record is there."""
    context.require_all("Ask for /health/live of each service, and for /surfaces/NAME/contact of each surface.")
    context.registry.require_ready(context.clock(), context.reasons(), healthy=health)
    return Health(status="ready")
