"""`GET /health` and `GET /metrics`: readiness of the service and each surface, and figures for Prometheus."""

import asyncio
from typing import Annotated

from fastapi import Query, Response
from prometheus_client import generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from pydantic import BaseModel

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import ContextParameter
from beamtouch_service.metrics.figures import Figures
from beamtouch_service.problems import ProblemBody

live_router = gate.make_router("health", Role.OPEN)
router = gate.make_router("health", Role.READ)

_HEALTH = (
    "Also require that nothing needs a technician: no sensor is out or has changed for certain, the zeros have not "
    "moved far, and no unexplained stretch lasts too long."
)


class Health(BaseModel):
    """The answer of a health check that passed."""

    status: str


class Alarms(BaseModel):
    """What needs a technician now; empty while nothing does."""

    surfaces: dict[str, ProblemBody]
    """Surface -> the first reason: what is out, since when if that is known (`since`), and what to do."""
    missing: dict[str, str]
    """Part of the service that is missing, by the section of its configuration -> the reason."""


@live_router.get("/health/live")
async def get_live() -> Health:
    """Say that the process runs and answers."""
    return Health(status="live")


@router.get("/health/ready")
async def get_ready(context: ContextParameter, health: Annotated[bool, Query(description=_HEALTH)] = False) -> Health:
    """Check that every surface has a model and fresh samples, and no address, broker, record or task is missing."""
    context.require_all("Ask for /health/live of each service, and for /surfaces/NAME/contact of each surface.")
    context.registry.require_ready(context.clock(), context.reasons(), healthy=health)
    return Health(status="ready")


@router.get("/alarms")
async def get_alarms(context: ContextParameter) -> Alarms:
    """Return what needs a technician now, as `/health/ready?health=true` states it, with the status 200."""
    context.require_all("Ask for /surfaces/NAME of each surface.")
    faults = context.registry.faults(context.clock())
    return Alarms(
        surfaces={name: ProblemBody.model_validate(fault.body()) for name, fault in faults.items()},
        missing={part: reason for part, reason in context.reasons().items() if reason},
    )


@router.get("/metrics", responses={200: {"content": {"text/plain": {}}}})
async def get_metrics(context: ContextParameter) -> Response:
    """Return counts, ages and durations for Prometheus, as text."""
    figures = Figures(context.counts.registry)
    figures.read_service(context.recorder, context.reasons(), context.parts.failures)
    await context.stepper.finish(figures.read_surfaces(context.registry, context.clock()))
    # In a thread: of many surfaces, there are tens of thousands.
    text = await asyncio.to_thread(generate_latest, figures)
    return Response(text, media_type=CONTENT_TYPE_LATEST)
