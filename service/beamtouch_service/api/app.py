"""The web application.

All routes run in one event loop, so code between two awaits runs alone and needs no locks. A change that takes longer
than a slice of `steps` awaits between its steps. Batches of one surface hold its lock meanwhile (`samples`). Whatever
else may have changed during an await, such as the record of a surface, is looked at again after it
(`record/recorder.py`). Other threads, such as those of the record, run a call and return its answer. But for counts,
only the loop changes what routes read.
"""

import asyncio
import json
from collections.abc import Iterable
from typing import Any

from fastapi import FastAPI, Request, Response

from beamtouch_common.commands import version
from beamtouch_common.uptime import uptime_s
from beamtouch_service.access import Access, Role
from beamtouch_service.api import (
    calibration_data,
    commissioning,
    errors,
    events,
    gate,
    health,
    openapi,
    page,
    samples,
    stream,
    surfaces,
    trail,
)
from beamtouch_service.api.change_log import ChangeLog
from beamtouch_service.api.context import Clock, Context, Streams
from beamtouch_service.callers import TrustedProxies
from beamtouch_service.metrics.counts import Counts
from beamtouch_service.own_names import OwnNames
from beamtouch_service.record import Recorder
from beamtouch_service.surfaces.registry import Registry
from beamtouch_service.surfaces.surface import Surface

_description_router = gate.make_router("description", Role.READ)


@_description_router.get("/openapi.json", include_in_schema=False)
async def _get_openapi(request: Request) -> Response:
    return Response(await request.app.describe(), media_type="application/json")


_ROUTERS = (
    surfaces.contact_router,
    samples.router,
    surfaces.router,
    surfaces.model_router,
    stream.router,
    events.router,
    trail.router,
    calibration_data.router,
    commissioning.router,
    commissioning.admin_router,
    health.live_router,
    health.router,
    _description_router,
)


class Application(FastAPI):
    """The application and its context."""

    def __init__(self, context: Context) -> None:
        super().__init__(
            title="Beamtouch service",
            version=version(),
            description=openapi.DESCRIPTION,
            # No documentation pages: those of the framework load scripts from another host. The description has a
            # route of its own, with a role.
            openapi_url=None,
            redirect_slashes=False,
            # `/metrics` is for that. Looking for another program's telemetry takes a tenth of the time of a contact.
            telemetry={"tracing": False, "metrics": False, "logs": False},
            # Directly: to find a route in an included router takes longer.
            routes=[route for router in _ROUTERS for route in router.routes],
        )
        self.context = self.state.context = context
        self._description = ""
        self._describing = asyncio.Lock()
        self.add_middleware(gate.Gate)

    async def describe(self) -> str:
        """Return the OpenAPI description as JSON. A thread makes it once: that takes a tenth of a second."""
        async with self._describing:
            self._description = self._description or await asyncio.to_thread(self._make_description)
        return self._description

    def _make_description(self) -> str:
        return json.dumps(self.openapi(), ensure_ascii=False, separators=(",", ":"))

    def openapi(self) -> dict[str, Any]:
        """Return the OpenAPI description, with the schemas that routes only refer to."""
        if self.openapi_schema is None:
            openapi.complete(super().openapi(), self.context.access)
        return super().openapi()


def create_app(
    served: Iterable[Surface],
    access: Access | str | None = None,
    clock: Clock = uptime_s,
    streams: Streams | None = None,
    recorder: Recorder | None = None,
    names: OwnNames | None = None,
    proxies: TrustedProxies | None = None,
) -> Application:
    """Return the application for these surfaces.

    Parameters
    ----------
    served : surfaces in the order in which they are listed; their names differ
    access : the tokens, or only the write token; without one every write is refused
    clock : the time [s]; it never goes back
    streams : the limit of open streams, and the signal to end them
    recorder : keeps the events; default: in memory
    names : the names that clients may ask for; default: any
    proxies : those that are believed what they say of their clients; default: none
    """
    registry, counts, recorder = Registry(served), Counts(), recorder or Recorder()
    for surface in registry:
        recorder.watch(surface)
        counts.watch(surface)
    context = Context(
        registry,
        clock,
        access if isinstance(access, Access) else Access.of(access),
        recorder,
        counts,
        ChangeLog(clock),
        streams or Streams(),
        names=names,
        proxies=proxies or TrustedProxies(),
    )
    app = Application(context)
    errors.install(app)
    app.router.routes.extend(page.routes())
    return app
