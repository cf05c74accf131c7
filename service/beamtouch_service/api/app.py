"""The web application: routes around the surfaces, nothing more.

Every route is a coroutine without an await between reading and changing state, so that one thread needs no locks.
"""

from collections.abc import Iterable, Mapping
from typing import Annotated

from fastapi import APIRouter, Depends, FastAPI, Query, Request, Response
from fastapi.routing import APIRoute
from pydantic import BaseModel

from beamtouch_service import version
from beamtouch_service.access import Access
from beamtouch_service.api import batches, metrics, stream_routes
from beamtouch_service.api import errors as handlers
from beamtouch_service.api import events as event_routes
from beamtouch_service.api import models as model_routes
from beamtouch_service.api import openapi as documentation
from beamtouch_service.api import page as page_files
from beamtouch_service.api.context import Clock, Context, ContextParameter, SurfaceInPath, boot_clock
from beamtouch_service.api.gate import Front, role
from beamtouch_service.api.stream import Streams
from beamtouch_service.defaults import BATCHES_PER_S
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.host.model_watch import ModelKeeper
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Receipt
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.registry import Registry
from beamtouch_service.surfaces.summary import SurfaceSummary
from beamtouch_service.surfaces.surface import Surface


class SurfaceList(BaseModel):
    """All surfaces of the service."""

    surfaces: list[SurfaceSummary]


class Health(BaseModel):
    """The answer of a health check that passed."""

    status: str


async def _no_store(response: Response) -> None:
    response.headers.update(handlers.NO_STORE)


_CONTACT_PROBLEMS = (
    Kind.STALE,
    Kind.NO_SAMPLES,
    Kind.NO_MODEL,
    Kind.NO_SURFACE,
    Kind.TOO_FEW_CHANNELS,
    Kind.UNUSABLE_ESTIMATE,
)

router = APIRouter(dependencies=[Depends(_no_store)])


@router.get(
    "/contact",
    tags=["contact"],
    responses=documentation.problems(Kind.SURFACE_REQUIRED, Kind.UNKNOWN_SURFACE, *_CONTACT_PROBLEMS),
)
async def get_contact(
    context: ContextParameter,
    surface: Annotated[str | None, Query(description="Name of the surface; needed when there are several.")] = None,
) -> Contact:
    """Return the contact on the only surface, or on the one that is named."""
    return _counted(context, context.registry.chosen(surface))


@router.get(
    "/surfaces/{name}/contact",
    tags=["contact"],
    responses=documentation.problems(Kind.UNKNOWN_SURFACE, *_CONTACT_PROBLEMS),
)
async def get_surface_contact(context: ContextParameter, name: SurfaceInPath) -> Contact:
    """Return the contact on this surface."""
    return _counted(context, context.registry.named(name))


def _counted(context: Context, surface: Surface) -> Contact:
    contact = surface.contact(context.clock())
    context.counts.contacts[surface.name, contact.state.value] += 1
    return contact


@router.post(
    "/surfaces/{name}/samples",
    tags=["samples"],
    openapi_extra=documentation.BATCH_BODY,
    responses=documentation.problems(
        Kind.MALFORMED_JSON,
        Kind.UNKNOWN_SURFACE,
        Kind.TOO_SLOW,
        Kind.TOO_LARGE,
        Kind.TOO_MANY_REQUESTS,
        Kind.INVALID_REQUEST,
        Kind.MISSING_CHANNELS,
        Kind.NO_SURFACE,
        Kind.BUSY,
        Kind.STOPPING,
    ),
)
async def post_samples(context: ContextParameter, name: SurfaceInPath, request: Request) -> Receipt:
    """Take a batch of samples. Sending one twice changes nothing; state the age of the newest anew at each attempt."""
    # Front takes every batch before the routes are asked. This is their description, and the same taking for an
    # application without Front.
    return await batches.take(context, name, request)


@router.get("/surfaces", tags=["surfaces"])
async def get_surfaces(context: ContextParameter) -> SurfaceList:
    """Return all surfaces of this service."""
    now_s = context.clock()
    return SurfaceList(surfaces=[surface.summary(now_s) for surface in context.registry])


@router.get(
    "/surfaces/{name}", tags=["surfaces"], responses=documentation.problems(Kind.UNKNOWN_SURFACE, Kind.NO_SURFACE)
)
async def get_surface(context: ContextParameter, name: SurfaceInPath) -> SurfaceSummary:
    """Return one surface: its channels, model, limit, and what it received."""
    return context.registry.named(name).summary(context.clock())


@router.get("/health/live", tags=["health"])
async def get_live() -> Health:
    """Say that the process runs and answers."""
    return Health(status="live")


@router.get("/health/ready", tags=["health"], responses=documentation.problems(Kind.NOT_READY, Kind.NO_SURFACE))
async def get_ready(context: ContextParameter) -> Health:
    """Say whether every surface, at least one, has a model and fresh samples."""
    context.registry.require_ready(context.clock())
    return Health(status="ready")


class _Application(FastAPI):
    needs_read_token = False

    def openapi(self) -> dict[str, object]:
        """Return the OpenAPI description, with the schemas that routes only refer to."""
        if self.openapi_schema is None:
            documentation.complete(super().openapi(), role, needs_read_token=self.needs_read_token)
        return super().openapi()


def _operation_name(route: APIRoute) -> str:
    """Return the name of a route's function, which becomes that of a method of a generated client."""
    return route.name


def create_app(
    surfaces: Iterable[Surface],
    access: Access | str | None = None,
    clock: Clock = boot_clock,
    keepers: Mapping[str, ModelKeeper] | None = None,
    max_batches_per_s: float = BATCHES_PER_S,
    streams: Streams | None = None,
    recorder: Recorder | None = None,
) -> Front:
    """Return the application for these surfaces.

    Parameters
    ----------
    surfaces : in the order in which they are listed; names differ
    access : tokens, or the one that writes must bear; without one every write is refused
    clock : the present [s], never going back
    keepers : by surface, of those that have a model file
    max_batches_per_s : per surface
    streams : how many there may be, and when they end
    recorder : keeps the events; without one they are kept in memory
    """
    # No documentation pages: the framework's load their scripts from another host.
    app = _Application(
        title="Beamtouch service",
        version=version.current(),
        description=documentation.DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
        generate_unique_id_function=_operation_name,
    )
    tokens = access if isinstance(access, Access) else Access(write=access)
    app.needs_read_token = tokens.read is not None
    registry = Registry(surfaces)
    recorder = recorder or Recorder()
    for surface in registry:
        surface.witness = recorder
    context = Context(registry, clock, keepers=keepers or {}, max_batches_per_s=max_batches_per_s, recorder=recorder)
    app.state.context = context
    handlers.install(app)
    stream_router = stream_routes.make_router(registry, clock, streams or Streams())
    for part in (router, model_routes.router, metrics.router, stream_router):
        app.include_router(part)
    app.include_router(event_routes.make_router(registry, recorder, clock))
    app.router.routes.extend(page_files.routes())
    return Front(app, tokens, context)
