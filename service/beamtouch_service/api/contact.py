"""`GET /contact`."""

from starlette.datastructures import QueryParams
from starlette.responses import Response
from starlette.routing import Match
from starlette.types import ASGIApp, Receive, Scope, Send

from beamtouch_service.access import Role
from beamtouch_service.api import gate, openapi
from beamtouch_service.api.context import Context, ContextParameter, SurfaceInPath, SurfaceInQuery
from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.surfaces.contact import Contact

PROBLEMS = (
    Kind.STALE,
    Kind.NO_SAMPLES,
    Kind.OTHER_BEAM,
    Kind.NO_MODEL,
    Kind.NO_SURFACE,
    Kind.UNKNOWN_SURFACE,
    Kind.TOO_FEW_CHANNELS,
    Kind.UNUSABLE_ESTIMATE,
)
"""Those that the routes answer with, besides `surface-required`."""


_BY_PATH = "Ask for /surfaces/NAME/contact."

router = gate.make_router("contact", Role.READ)


def _answer(context: Context, name: str | None) -> Response:
    surface = context.registry.chosen(name)
    return Response(context.contacts.get(surface, context.clock()), media_type="application/json")


@router.get(
    "/contact",
    response_model=Contact,
    responses=openapi.problems(Kind.SURFACE_REQUIRED, Kind.ONE_OF_SEVERAL, *PROBLEMS),
)
async def get_contact(context: ContextParameter, surface: SurfaceInQuery = None) -> Response:
    """Return the contact on the only surface, or on the one that is named."""
    context.require_all(_BY_PATH)
    return _answer(context, surface)


@router.get("/surfaces/{name}/contact", response_model=Contact, responses=openapi.problems(*PROBLEMS))
async def get_surface_contact(context: ContextParameter, name: SurfaceInPath) -> Response:
    """Return the contact on this surface."""
    return _answer(context, name)


class ContactFirst:
    """Answers the contact, and leaves all other requests to the layers below (ASGI).

    These layers take three times as long as the whole answer. They get every request for a contact that ends in a
    problem. docs/decisions/008-contact-at-once.md has the figures.
    """

    def __init__(self, context: Context, others: ASGIApp) -> None:
        self._context = context
        self._others = others

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        answer = self._contact(scope) if scope["type"] == "http" and scope["method"] == "GET" else None
        await (answer or self._others)(scope, receive, send)

    def _contact(self, scope: Scope) -> Response | None:
        for route in router.routes:
            match, found = route.matches(scope)
            if match is Match.FULL:
                query = QueryParams(scope["query_string"]) if scope["query_string"] else {}
                try:
                    self._context.allow(scope, Role.READ)
                    name = found["path_params"].get("name")
                    if name is None:
                        self._context.require_all(_BY_PATH)
                    return _answer(self._context, name or query.get("surface"))
                except ProblemError:
                    return None
        return None
