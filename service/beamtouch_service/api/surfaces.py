"""`GET /surfaces`: the surfaces of the service, and how each one does."""

from fastapi import APIRouter
from pydantic import BaseModel

from beamtouch_service.api import gate
from beamtouch_service.api import openapi as documentation
from beamtouch_service.api.context import ContextParameter, SurfaceInPath
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.summary import SurfaceSummary

router = APIRouter(tags=["surfaces"], dependencies=gate.READING)


class SurfaceList(BaseModel):
    """All surfaces of the service."""

    surfaces: list[SurfaceSummary]


@router.get("/surfaces", responses=documentation.problems())
async def get_surfaces(context: ContextParameter) -> SurfaceList:
    """Return all surfaces of this service."""
    now_s = context.clock()
    return SurfaceList(surfaces=[surface.summary(now_s) for surface in context.registry])


@router.get("/surfaces/{name}", responses=documentation.problems(Kind.UNKNOWN_SURFACE, Kind.NO_SURFACE))
async def get_surface(context: ContextParameter, name: SurfaceInPath) -> SurfaceSummary:
    """Return one surface: its channels, model, age limit, and counts of samples."""
    return context.registry.named(name).summary(context.clock())
