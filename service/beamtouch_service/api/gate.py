"""The token that each route needs, and the layer around all routes: headers, HEAD, errors of last resort."""

from asyncio import CancelledError

from fastapi import APIRouter, Security, params
from fastapi.security import HTTPBearer
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from beamtouch_service.access import Role
from beamtouch_service.api import errors, openapi
from beamtouch_service.api.changes import note_token
from beamtouch_service.api.context import CALLER, IS_HEAD, context_of
from beamtouch_service.problems import ProblemError

HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
}
"""Headers of every answer, unless its route sets its own."""
_HEADERS = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]


class _Token(HTTPBearer):
    """Requires a token for a role, and describes it in OpenAPI."""

    def __init__(self, role: Role, description: str) -> None:
        super().__init__(scheme_name=f"{role.token}_token", description=description)
        self.role = role

    async def __call__(self, request: HTTPConnection) -> None:
        """Let a request pass, and note who sent one that writes; raises ProblemError (401, 403)."""
        context = context_of(request.scope)
        caller = request.scope[CALLER] = context.allow(request.scope, self.role)
        if self.role.includes(Role.WRITE) and request.scope["method"] != "GET":
            note_token(context, caller)


_NEEDS: dict[Role, list[params.Depends]] = {
    Role.OPEN: [],
    Role.READ: [Security(_Token(Role.READ, "For reading."))],
    Role.WRITE: [Security(_Token(Role.WRITE, "For sending samples and for reading."))],
    Role.ADMIN: [Security(_Token(Role.ADMIN, "For commissioning, the trail of changes, and all else."))],
}


def make_router(tag: str, role: Role) -> APIRouter:
    """Return a router whose routes need a token for this role.

    Each operation has the name of its function, which becomes a method name of a generated client.
    """
    return APIRouter(
        tags=[tag],
        dependencies=_NEEDS[role],
        responses=openapi.PROBLEMS,
        generate_unique_id_function=lambda route: route.name,
    )


class Gate:
    """The layer around all routes (ASGI): refuses foreign names, adds headers, answers HEAD, turns failures into a 500.

    It adds the headers here because answers also come from the framework and from error handlers.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request. The server passes on nothing else (`configure` in `host/serve.py`)."""
        started = False

        async def guarded(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                headers = message["headers"]
                names = {name for name, _ in headers}
                message["headers"] = [*headers, *(pair for pair in _HEADERS if pair[0] not in names)]
            await send(message)

        if scope["method"] == "HEAD" and not scope["path"].endswith("/stream"):
            # The server leaves the body out. A stream would never end.
            scope = {**scope, "method": "GET", IS_HEAD: True}
        try:
            if (names := context_of(scope).names) is not None:
                names.require(scope["headers"])
            await self._app(scope, receive, guarded)
        except ProblemError as refusal:
            await errors.refuse(scope, refusal)(scope, receive, guarded)
        except CancelledError:
            # Only the server cancels a request, at the end of its patience with a client that does not read.
            return
        except Exception as error:
            context_of(scope).change_log.log_failure(error)
            if started:
                raise
            await errors.internal(scope, error)(scope, receive, guarded)
