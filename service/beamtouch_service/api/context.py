"""What every route works with."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated

from fastapi import Depends
from fastapi import Path as PathParameter
from starlette.requests import HTTPConnection

from beamtouch_service.api.counts import Counts
from beamtouch_service.defaults import BATCHES_PER_S
from beamtouch_service.events.recorder import Recorder
from beamtouch_service.host.model_watch import ModelKeeper
from beamtouch_service.limits import Bucket
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.surfaces.registry import Registry

Clock = Callable[[], float]
"""Gives the present in seconds, never going back."""


def boot_clock() -> float:
    """Return seconds since the machine started [s], sleep included: a contact from before a suspend is not fresh."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


@dataclass(frozen=True)
class Context:
    """The surfaces, and what goes with them."""

    registry: Registry
    clock: Clock
    counts: Counts = field(default_factory=Counts)
    keepers: Mapping[str, ModelKeeper] = field(default_factory=dict)
    """Of those surfaces that have a model file, by name."""
    max_batches_per_s: float = BATCHES_PER_S
    recorder: Recorder | None = None
    """Of the contacts of all surfaces."""
    buckets: dict[str, Bucket] = field(default_factory=dict)

    def take_turn(self, surface: str) -> None:
        """Let a batch for a surface pass; raises ProblemError (429) when there were too many within a second."""
        bucket = self.buckets.setdefault(surface, Bucket(self.max_batches_per_s))
        if bucket.take(self.clock()) > 0:
            detail = f"The surface takes {self.max_batches_per_s:g} batches per second; put more samples into each."
            # Retry-After knows whole seconds only.
            raise ProblemError(Problem(Kind.TOO_MANY_REQUESTS, detail, surface), {"Retry-After": "1"})


async def _context(connection: HTTPConnection) -> Context:
    context: Context = connection.app.state.context
    return context


ContextParameter = Annotated[Context, Depends(_context)]
SurfaceInPath = Annotated[str, PathParameter(description="Name of the surface.", examples=["press-7"])]
"""Whatever a client put there; the registry says whether there is such a surface."""
