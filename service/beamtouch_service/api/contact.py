"""`GET /contact`."""

from fastapi import APIRouter
from fastapi.routing import APIRoute
from starlette.datastructures import QueryParams
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api import openapi as documentation
from beamtouch_service.api.context import Context, ContextParameter, SurfaceInPath, SurfaceInQuery, context_of
from beamtouch_service.problems import Kind, ProblemError
from beamtouch_service.surfaces.contact import Contact

_PROBLEMS = (
    Kind.STALE,
    Kind.NO_SAMPLES,
    Kind.NO_MODEL,
    Kind.NO_SURFACE,
    Kind.UNKNOWN_SURFACE,
    Kind.TOO_FEW_CHANNELS,
    Kind.UNUSABLE_ESTIMATE,
)


class ContactRoute(APIRoute):
    """Finds the parameters of a contact route itself.

    The framework takes three times as long to do so as the whole answer takes. It still handles whatever ends in a
    problem, and describes the route. docs/decisions/008-contact-at-once.md has the figures.
    """

    async def handle(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with the contact, or let the framework find out what is wrong."""
        answer = self._contact(scope) if scope["method"] == "GET" else None
        await (answer or super().handle)(scope, receive, send)

    def _contact(self, scope: Scope) -> Response | None:
        context = context_of(scope)
        name = scope["path_params"].get("name") or QueryParams(scope["query_string"]).get("surface")
        try:
            context.allow(scope, Role.READ)
            return _answer(context, name)
        except ProblemError:
            return None


router = APIRouter(
    tags=["contact"],
    dependencies=gate.READING,
    route_class=ContactRoute,
    generate_unique_id_function=lambda route: route.name,
)


def _answer(context: Context, name: str | None) -> Response:
    surface = context.registry.chosen(name)
    return Response(context.contacts.get(surface, context.clock()), media_type="application/json")


@router.get("/contact", response_model=Contact, responses=documentation.problems(Kind.SURFACE_REQUIRED, *_PROBLEMS))
async def get_contact(context: ContextParameter, surface: SurfaceInQuery = None) -> Response:
    """Return the contact on the only surface, or on the one that is named."""
    return _answer(context, surface)


@router.get("/surfaces/{name}/contact", response_model=Contact, responses=documentation.problems(*_PROBLEMS))
async def get_surface_contact(context: ContextParameter, name: SurfaceInPath) -> Response:
    """Return the contact on this surface."""
    return _answer(context, name)
