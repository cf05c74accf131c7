"""`GET /contact`."""

from starlette.requests import Request
from starlette.responses import Response

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import Context, SurfaceInPath, SurfaceInQuery, context_of
from beamtouch_service.surfaces.contact import Contact

router = gate.make_router("contact", Role.READ)


@router.get("/contact", response_model=Contact)
async def get_contact(request: Request, surface: SurfaceInQuery = None) -> Response:
    """Return the contact on the only surface, or on the one that is named."""
    context = context_of(request.scope)
    context.require_all("Ask for /surfaces/NAME/contact.")
    return _answer(context, surface)


@router.get("/surfaces/{name}/contact", response_model=Contact)
async def get_surface_contact(request: Request, name: SurfaceInPath) -> Response:
    """Return the contact on this surface."""
    return _answer(context_of(request.scope), name)


def _answer(context: Context, name: str | None) -> Response:
    contact = context.registry.chosen(name).contact(context.clock())
    context.counts.contacts.labels(contact.surface, contact.state.value).inc()
    return Response(contact.model_dump_json(), media_type="application/json")
