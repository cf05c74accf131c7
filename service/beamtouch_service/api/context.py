"""The state that routes share: surfaces, clock, tokens, counts, and the keepers of models and events."""

import time
from asyncio import Event
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Protocol

from fastapi import Depends, Query
from fastapi import Path as PathParameter
from starlette.requests import HTTPConnection
from starlette.types import Scope

from beamtouch_service.access import Access, Role
from beamtouch_service.api.counts import Counts
from beamtouch_service.api.encoded import EncodedContacts
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.limits import MAX_BATCHES_PER_S, MAX_STREAMS, Bucket
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.surfaces.registry import Registry

Clock = Callable[[], float]
"""Returns the time in seconds. It never goes back."""


def boot_clock() -> float:
    """Return the time since the machine started [s]. It includes sleep: a contact from before a suspend is stale."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class ModelKeeper(Protocol):
    """Keeps the model of one surface in step with its file."""

    async def reload(self) -> bool:
        """Read the file again; return whether the surface has another model now."""


@dataclass
class Streams:
    """The open streams of one service."""

    max_open: int = MAX_STREAMS
    stop: Event = field(default_factory=Event)
    """Set when the service stops."""
    drop: Callable[[Scope], None] = lambda _scope: None
    """Ends the connection of a request without waiting for its client. The server sets it."""
    open: int = 0

    def admit(self) -> None:
        """Count one more stream; raises ProblemError if too many are open or the service stops."""
        if self.stop.is_set():
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
    contacts: EncodedContacts
    streams: Streams
    keepers: Mapping[str, ModelKeeper] = field(default_factory=dict)
    """By surface name, for surfaces that have a model file."""
    max_batches_per_s: float = MAX_BATCHES_PER_S
    missing: dict[str, str] = field(default_factory=dict)
    """Section of the configuration -> why its address or broker is not there; empty while it is."""
    buckets: dict[str, Bucket] = field(default_factory=dict)

    def reasons(self) -> dict[str, str]:
        """Return `missing`, with the record of events."""
        return self.missing | {"events": self.recorder.away_because}

    def require_all(self, instead: str) -> None:
        """Refuse a question about all surfaces; raises ProblemError (421) if other services have some of them."""
        if self.recorder.is_replica:
            detail = f"Several services share the surfaces, and a load balancer knows which has which. {instead}"
            raise ProblemError(Problem(Kind.ONE_OF_SEVERAL, detail, members={"surfaces": self.registry.names}))

    def allow(self, scope: Scope, role: Role) -> None:
        """Let a request with a token for `role` pass; raises ProblemError (401, 403)."""
        given = next((value for name, value in scope["headers"] if name == b"authorization"), None)
        self.access.require(role, given)

    def take_turn(self, surface: str) -> None:
        """Count a batch for a surface; raises ProblemError (429) when too many came within a second."""
        bucket = self.buckets.setdefault(surface, Bucket(self.max_batches_per_s))
        if bucket.take(self.clock()) > 0:
            detail = f"The surface takes {self.max_batches_per_s:g} batches per second. Put more samples into each."
            # Retry-After takes whole seconds only.
            raise ProblemError(Problem(Kind.TOO_MANY_REQUESTS, detail, surface), {"Retry-After": "1"})


def context_of(scope: Scope) -> Context:
    """Return the context of the application that serves a request."""
    context: Context = scope["app"].state.context
    return context


async def _context(connection: HTTPConnection) -> Context:
    return context_of(connection.scope)


ContextParameter = Annotated[Context, Depends(_context)]
SurfaceInPath = Annotated[str, PathParameter(description="Name of the surface.", examples=["press-7"])]
"""Any text from the client. The registry finds the surface of that name."""
SurfaceInQuery = Annotated[str | None, Query(description="Name of the surface. Required if there are several.")]
