"""The web application.

Every route is a coroutine without an await between reading and changing state, so one thread needs no locks.
"""

from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager
from typing import Any

from fastapi import APIRouter, FastAPI, Response
from fastapi.middleware.asyncexitstack import AsyncExitStackMiddleware
from fastapi.routing import APIRoute
from starlette.middleware.exceptions import ExceptionMiddleware
from starlette.types import ASGIApp

from beamtouch_common.commands import version
from beamtouch_service.access import Access
from beamtouch_service.api import contact, errors, gate, health, metrics, models, page, samples, stream, surfaces
from beamtouch_service.api import events as event_routes
from beamtouch_service.api import openapi as documentation
from beamtouch_service.api.context import Clock, Context, ModelKeeper, Streams, boot_clock
from beamtouch_service.api.counts import Counts
from beamtouch_service.api.encoded import EncodedContacts
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.limits import MAX_BATCHES_PER_S
from beamtouch_service.surfaces.registry import Registry
from beamtouch_service.surfaces.surface import Surface

Lifespan = Callable[[Any], AbstractAsyncContextManager[None]]
"""Runs the tasks of the process while the application runs."""


class Application(FastAPI):
    """The application and its context."""

    def __init__(self, context: Context, lifespan: Lifespan | None = None) -> None:
        super().__init__(
            title="Beamtouch service",
            version=version(),
            description=documentation.DESCRIPTION,
            # No documentation pages: those of the framework load scripts from another host. The description has a
            # route of its own, with a role.
            openapi_url=None,
            redirect_slashes=False,
            generate_unique_id_function=_operation_name,
            lifespan=lifespan,
            # Directly, not as an included router: this saves a third of the time of a contact.
            routes=contact.router.routes,
        )
        self.context = self.state.context = context

    def openapi(self) -> dict[str, Any]:
        """Return the OpenAPI description, with the schemas that routes only refer to."""
        if self.openapi_schema is None:
            needs_read_token = self.context.access.read is not None
            documentation.complete(super().openapi(), needs_read_token=needs_read_token)
        return super().openapi()

    def build_middleware_stack(self) -> ASGIApp:
        """Return the layers around the routes: those of the framework that are needed, and ours outside."""
        routes = AsyncExitStackMiddleware(self.router)
        return gate.Gate(ExceptionMiddleware(routes, handlers=self.exception_handlers))


def _operation_name(route: APIRoute) -> str:
    """Return the name of a route's function, which becomes a method name of a generated client."""
    return route.name


def create_app(
    served: Iterable[Surface],
    access: Access | str | None = None,
    clock: Clock = boot_clock,
    keepers: Mapping[str, ModelKeeper] | None = None,
    max_batches_per_s: float = MAX_BATCHES_PER_S,
    streams: Streams | None = None,
    recorder: Recorder | None = None,
    lifespan: Lifespan | None = None,
) -> Application:
    """Return the application for these surfaces.

    Parameters
    ----------
    served : surfaces in the order in which they are listed; their names differ
    access : the tokens, or only the write token; without one every write is refused
    clock : the time [s]; it never goes back
    keepers : by surface name, for surfaces that have a model file
    max_batches_per_s : limit for each surface
    streams : the limit of open streams, and the signal to end them
    recorder : keeps the events; default: in memory
    lifespan : runs the tasks of the process
    """
    registry, counts, recorder = Registry(served), Counts(), recorder or Recorder()
    for surface in registry:
        surface.witness = recorder
        counts.watch(surface)
    context = Context(
        registry,
        clock,
        access if isinstance(access, Access) else Access(write=access),
        recorder,
        counts,
        EncodedContacts(counts.contacts),
        streams or Streams(),
        keepers or {},
        max_batches_per_s,
    )
    counts.registry.register(metrics.SurfaceCollector(context))
    app = Application(context, lifespan)
    errors.install(app)
    for part in (samples, surfaces, models, metrics, stream):
        app.include_router(part.router)
    app.include_router(health.live_router)
    app.include_router(health.ready_router)
    app.include_router(event_routes.make_router(registry, recorder, clock), dependencies=gate.READING)
    app.include_router(_description(app))
    _require_roles(app)
    app.router.routes.extend(page.routes())
    return app


def _description(app: Application) -> APIRouter:
    """Return the route of the OpenAPI description."""
    router = APIRouter(dependencies=gate.READING)

    @router.get("/openapi.json", include_in_schema=False)
    async def get_openapi() -> Response:
        return Response(documentation.encoded(app.openapi()), media_type="application/json")

    return router


def _require_roles(app: FastAPI) -> None:
    """Refuse to start with a route that says nothing about who may use it."""
    found = gate.without_role(app.routes)
    if found:
        message = f"routes without exactly one role: {', '.join(found)}"
        raise RuntimeError(message)
