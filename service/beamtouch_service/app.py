"""The web application: routes around the surfaces, nothing more.

Every route is a coroutine without an await between reading and changing state, so that one thread needs no locks.
"""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends, FastAPI, Query, Request, Response
from fastapi import Path as PathParameter
from pydantic import BaseModel

from beamtouch_service import documentation, handlers, page_files, stream, version
from beamtouch_service.contact import Contact
from beamtouch_service.intake import check_token, parse_batch, read_body
from beamtouch_service.problems import Kind
from beamtouch_service.registry import Registry
from beamtouch_service.samples import Receipt
from beamtouch_service.surface import Surface, SurfaceSummary

Clock = Callable[[], float]
"""Gives the present in seconds, never going back."""


def boot_clock() -> float:
    """Return seconds since the machine started [s], sleep included: a contact from before a suspend is not fresh."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class SurfaceList(BaseModel):
    """All surfaces of the service."""

    surfaces: list[SurfaceSummary]


class Health(BaseModel):
    """The answer of a health check that passed."""

    status: str


@dataclass(frozen=True)
class _Context:
    registry: Registry
    token: str | None
    clock: Clock


async def _context(request: Request) -> _Context:
    context: _Context = request.app.state.context
    return context


async def _no_store(response: Response) -> None:
    response.headers.update(handlers.NO_STORE)


_ContextParameter = Annotated[_Context, Depends(_context)]
_SurfaceName = Annotated[str, PathParameter(description="Name of the surface.", examples=["press-7"])]
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
    context: _ContextParameter,
    surface: Annotated[str | None, Query(description="Name of the surface; needed when there are several.")] = None,
) -> Contact:
    """Return the contact on the only surface, or on the one that is named."""
    return context.registry.chosen(surface).contact(context.clock())


@router.get(
    "/surfaces/{name}/contact",
    tags=["contact"],
    responses=documentation.problems(Kind.UNKNOWN_SURFACE, *_CONTACT_PROBLEMS),
)
async def get_surface_contact(context: _ContextParameter, name: _SurfaceName) -> Contact:
    """Return the contact on this surface."""
    return context.registry.named(name).contact(context.clock())


@router.post(
    "/surfaces/{name}/samples",
    tags=["samples"],
    openapi_extra=documentation.BATCH_BODY,
    responses=documentation.problems(
        Kind.MALFORMED_JSON,
        Kind.UNAUTHORIZED,
        Kind.UNKNOWN_SURFACE,
        Kind.TOO_LARGE,
        Kind.INVALID_REQUEST,
        Kind.MISSING_CHANNELS,
        Kind.NO_SURFACE,
        Kind.STOPPING,
    ),
)
async def post_samples(context: _ContextParameter, name: _SurfaceName, request: Request) -> Receipt:
    """Take a batch of samples. Sending one twice changes nothing; state the age of the newest anew at each attempt."""
    # The body is read here and not by the framework: not before the token is right, and never beyond its limit.
    check_token(request, context.token)
    surface = context.registry.named(name)
    body = await read_body(request)
    # The age was stated before the body travelled; the instant is taken before the body is parsed.
    arrival_s = context.clock()
    return surface.receive(parse_batch(body), arrival_s)


@router.get("/surfaces", tags=["surfaces"])
async def get_surfaces(context: _ContextParameter) -> SurfaceList:
    """Return all surfaces of this service."""
    now_s = context.clock()
    return SurfaceList(surfaces=[surface.summary(now_s) for surface in context.registry])


@router.get(
    "/surfaces/{name}", tags=["surfaces"], responses=documentation.problems(Kind.UNKNOWN_SURFACE, Kind.NO_SURFACE)
)
async def get_surface(context: _ContextParameter, name: _SurfaceName) -> SurfaceSummary:
    """Return one surface: its channels, model, limit, and what it received."""
    return context.registry.named(name).summary(context.clock())


@router.get("/health/live", tags=["health"])
async def get_live() -> Health:
    """Say that the process runs and answers."""
    return Health(status="live")


@router.get("/health/ready", tags=["health"], responses=documentation.problems(Kind.NOT_READY, Kind.NO_SURFACE))
async def get_ready(context: _ContextParameter) -> Health:
    """Say whether every surface, at least one, has a model and fresh samples."""
    context.registry.require_ready(context.clock())
    return Health(status="ready")


class _Application(FastAPI):
    def openapi(self) -> dict[str, object]:
        """Return the OpenAPI description, with the schemas that routes only refer to."""
        if self.openapi_schema is None:
            documentation.complete(super().openapi())
        return super().openapi()


def create_app(surfaces: Iterable[Surface], token: str | None = None, clock: Clock = boot_clock) -> FastAPI:
    """Return the application for these surfaces.

    Parameters
    ----------
    surfaces : in the order in which they are listed; names differ
    token : that writes must bear; without one every write is refused
    clock : the present [s], never going back
    """
    # No documentation pages: the framework's load their scripts from another host.
    app = _Application(
        title="Beamtouch service",
        version=version.current(),
        description=documentation.DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.context = _Context(Registry(surfaces), token, clock)
    handlers.install(app)
    app.include_router(router)
    app.include_router(stream.router)
    app.router.routes.extend(page_files.routes())
    return app
