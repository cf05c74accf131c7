"""`GET /surfaces/NAME/beam`: the shape of the beam at rest and under a contact, by the model of a surface.

It changes only with the model, so it is not part of the stream. The page asks for it once per model.
"""

from typing import Any

from pydantic import BaseModel

from beamtouch_models.modelfile import Drawn
from beamtouch_service.access import Role
from beamtouch_service.api import examples, gate, openapi
from beamtouch_service.api.context import ContextParameter, SurfaceInPath
from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.surfaces import refusals

router = gate.make_router("model", Role.READ)

_EXAMPLE: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/json": {"examples": {"a table cut short": {"value": examples.BEAM}}}}}
}


class Beam(BaseModel):
    """The data to draw a beam."""

    model: str
    """Name and fingerprint of the model; a contact that states the same one belongs to this beam."""
    length_mm: float
    drawn: Drawn


@router.get(
    "/surfaces/{name}/beam",
    responses=_EXAMPLE | openapi.problems(Kind.UNKNOWN_SURFACE, Kind.NO_SURFACE, Kind.NO_MODEL),
)
async def get_beam(context: ContextParameter, name: SurfaceInPath) -> Beam:
    """Return the supports of the beam, and its deflection per newton for positions of the contact along it."""
    surface = context.registry.named(name)
    model = surface.model
    if model is None:
        raise ProblemError(refusals.no_model(name, surface.model_error))
    return Beam(model=model.identity, length_mm=model.metadata.length_mm, drawn=model.metadata.drawn)
