"""`GET /surfaces`: the surfaces of the service, each with its summary."""

from pydantic import BaseModel

from beamtouch_service.access import Role
from beamtouch_service.api import gate, openapi
from beamtouch_service.api.context import ContextParameter, SurfaceInPath
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.summary import SurfaceSummary

router = gate.make_router("surfaces", Role.READ)


class SurfaceList(BaseModel):
    """All surfaces of the service."""

    surfaces: list[SurfaceSummary]


@router.get("/surfaces", responses=openapi.problems(Kind.ONE_OF_SEVERAL))
async def get_surfaces(context: ContextParameter) -> SurfaceList:
    """Return all surfaces of this service."""
    context.require_all("Ask for /surfaces/NAME of each.")
    now_s = context.clock()
    return SurfaceList(surfaces=[surface.summary(now_s) for surface in context.registry])


@router.get("/surfaces/{name}", responses=openapi.problems(Kind.UNKNOWN_SURFACE, Kind.NO_SURFACE))
async def get_surface(context: ContextParameter, name: SurfaceInPath) -> SurfaceSummary:
    """Return one surface: its channels, model, age limit, and counts of samples."""
    return context.registry.named(name).summary(context.clock())
