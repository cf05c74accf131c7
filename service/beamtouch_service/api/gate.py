"""The token that each route needs, and the layer around all routes: headers, HEAD, errors of last resort."""

import logging
from collections.abc import Callable, Iterable

from fastapi import Depends, Security
from fastapi.routing import iter_route_contexts
from fastapi.security import HTTPBearer
from starlette.requests import HTTPConnection
from starlette.routing import BaseRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from beamtouch_service.access import Role
from beamtouch_service.api import errors
from beamtouch_service.api.context import context_of

_log = logging.getLogger("beamtouch.service")

HEADERS = {
    **errors.NO_STORE,
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
}
"""Headers of every answer, unless its route sets its own."""
_HEADERS = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]


class _Token(HTTPBearer):
    """A token as OpenAPI describes it. The header is read by `Access`, which knows all tokens."""

    async def __call__(self, request: HTTPConnection) -> None:
        """Take nothing from the request."""


_READ = _Token(scheme_name="read_token", description="For reading. The write and admin tokens read too.")
_WRITE = _Token(scheme_name="write_token", description="For sending samples and for reading.")
_ADMIN = _Token(scheme_name="admin_token", description="For reloading models and for reading.")


async def _may_read(connection: HTTPConnection) -> None:
    context_of(connection.scope).allow(connection.scope, Role.READ)


async def _may_write(connection: HTTPConnection) -> None:
    context_of(connection.scope).allow(connection.scope, Role.WRITE)


async def _may_administrate(connection: HTTPConnection) -> None:
    context_of(connection.scope).allow(connection.scope, Role.ADMIN)


async def _anyone_may() -> None:
    """Let every request pass."""


# The role first: a token scheme only describes it.
READING = [Depends(_may_read), Security(_READ), Security(_WRITE), Security(_ADMIN)]
"""Dependencies of a router whose routes need a token for reading, if the service has one."""
WRITING = [Depends(_may_write), Security(_WRITE)]
ADMINISTRATION = [Depends(_may_administrate), Security(_ADMIN)]
OPEN = [Depends(_anyone_may)]
"""Dependencies of a router whose routes need no token."""

_ROLES: dict[Callable[..., object] | None, Role] = {
    _may_read: Role.READ,
    _may_write: Role.WRITE,
    _may_administrate: Role.ADMIN,
    _anyone_may: Role.OPEN,
}


def without_role(routes: Iterable[BaseRoute]) -> list[str]:
    """Return the paths of the routes that do not have exactly one role."""
    found = []
    for route in iter_route_contexts(list(routes)):
        dependencies = getattr(route, "dependencies", [])
        if sum(one.dependency in _ROLES for one in dependencies) != 1:
            found.append(str(route.path))
    return found


class Gate:
    """The outermost layer of the application (ASGI): adds headers, answers HEAD, and turns any failure into a 500.

    It adds the headers here because answers also come from the framework and from error handlers.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
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
            scope = {**scope, "method": "GET"}
        try:
            await self._app(scope, receive, guarded)
        except Exception as error:
            _log.exception("an error ended a request")
            if started:
                raise
            await errors.internal(scope, error)(scope, receive, guarded)
