"""The state that routes share: surfaces, clock, tokens, counts, and the keeper of events."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends, Query
from fastapi import Path as PathParameter
from starlette.requests import HTTPConnection
from starlette.types import Scope

from beamtouch_common.parts import Parts
from beamtouch_service.access import Access, Role
from beamtouch_service.api.change_log import ChangeLog
from beamtouch_service.callers import Caller, TrustedProxies
from beamtouch_service.commissioning.runs import CommissioningRuns
from beamtouch_service.metrics.counts import Counts
from beamtouch_service.own_names import OwnNames
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.record import Recorder
from beamtouch_service.steps import Stepper
from beamtouch_service.surfaces.freshness import StallDetector
from beamtouch_service.surfaces.listeners import Listeners
from beamtouch_service.surfaces.registry import Registry

Clock = Callable[[], float]
"""Returns the time in seconds. It never goes back."""


@dataclass
class Streams:
    """The open streams of one service."""

    max_open: int = 32
    open: int = 0
    is_stopping: bool = False
    ends: Listeners[None] = field(default_factory=Listeners)
    """Told when the service stops."""

    def stop(self) -> None:
        """End all streams, and admit no more."""
        self.is_stopping = True
        self.ends.tell(None)

    def admit(self) -> None:
        """Count one more stream; raises ProblemError if too many are open or the service stops."""
        if self.is_stopping:
            raise ProblemError(Problem(Kind.STOPPING, "Open the stream again once the service is back."))
        if self.open >= self.max_open:
            detail = f"{self.max_open} streams are open, which is the limit. Close one, or raise server.max_streams."
            raise ProblemError(Problem(Kind.TOO_MANY_CLIENTS, detail), {"Retry-After": "5"})
        self.open += 1


@dataclass(frozen=True)
class Context:
    """The state of one application."""

    registry: Registry
    clock: Clock
    access: Access
    recorder: Recorder
    counts: Counts
    change_log: ChangeLog
    streams: Streams
    commissioning_runs: CommissioningRuns = field(default_factory=CommissioningRuns)
    proxies: TrustedProxies = field(default_factory=TrustedProxies)
    names: OwnNames | None = None
    """The names that clients may ask for; None: any."""
    stepper: Stepper = field(default_factory=Stepper)
    stalls: StallDetector = field(default_factory=StallDetector)
    """Notices that the process stood still."""
    missing: dict[str, str] = field(default_factory=dict)
    """Section of the configuration -> why its address or broker is not there, empty while it is."""
    parts: Parts = field(default_factory=lambda: Parts(logging.getLogger(__name__)))
    """The parts that run beside the routes."""

    def reasons(self) -> dict[str, str]:
        """Return `missing`, with the record of events, and with the parts that fail."""
        failing = {name: why for name, why in self.parts.failing.items() if why or name not in self.missing}
        return self.missing | {"events": self.recorder.away_because} | failing

    def require_all(self, instead: str) -> None:
        """Refuse a question about all surfaces; raises ProblemError (421) if other services have some of them."""
        if self.recorder.is_replica:
            detail = f"Several services share the surfaces, and a load balancer knows which has which. {instead}"
            raise ProblemError(Problem(Kind.WRONG_REPLICA, detail, members={"surfaces": self.registry.names}))

    def allow(self, scope: Scope, role: Role) -> Caller:
        """Let a request with a token for `role` pass, and return who sent it; raises ProblemError (401, 403)."""
        given = next((value for name, value in scope["headers"] if name == b"authorization"), None)
        token = self.access.require(role, given)
        peer = scope["client"][0] if scope.get("client") else "unknown"
        return self.proxies.find_caller(token, peer, scope["headers"])


def context_of(scope: Scope) -> Context:
    """Return the context of the application that serves a request."""
    context: Context = scope["app"].state.context
    return context


CALLER = "beamtouch.caller"
"""Key of the scope of a request: who sent it, once its token was looked at."""
IS_HEAD = "beamtouch.is_head"
"""Key of the scope of a request: true if only the headers of its answer are asked for. Routes see it as a GET."""


async def _caller(connection: HTTPConnection) -> Caller:
    caller: Caller = connection.scope[CALLER]
    return caller


async def _context(connection: HTTPConnection) -> Context:
    return context_of(connection.scope)


ContextParameter = Annotated[Context, Depends(_context)]
CallerParameter = Annotated[Caller, Depends(_caller)]
SurfaceInPath = Annotated[str, PathParameter(description="Name of the surface.", examples=["press-7"])]
"""Any text from the client. The registry finds the surface of that name."""
SurfaceInQuery = Annotated[str | None, Query(description="Name of the surface. Required if there are several.")]
