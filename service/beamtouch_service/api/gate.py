"""In front of the routes: who may pass, the headers of every answer, contacts and batches without a detour."""

import logging
from collections.abc import Iterable

from fastapi import FastAPI
from starlette.requests import ClientDisconnect, Request
from starlette.routing import Match
from starlette.types import Message, Receive, Scope, Send

from beamtouch_service.access import Access, Role
from beamtouch_service.api import batches
from beamtouch_service.api import errors as handlers
from beamtouch_service.api import page as page_files
from beamtouch_service.api.context import Context
from beamtouch_service.api.encoded import EncodedContacts
from beamtouch_service.problems import Kind, ProblemError

_log = logging.getLogger("beamtouch.service")

HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
}
_HEADERS = [(name.lower().encode(), value.encode()) for name, value in HEADERS.items()]
CONTACT_HEADERS = [(b"content-type", b"application/json"), (b"cache-control", b"no-store"), *_HEADERS]
"""Of an answer that is not the framework's, but for its length."""
# The files of the page hold no data; whatever it shows it asks for with the token.
LIVE_PATH = "/health/live"
_OPEN_PATHS = frozenset({LIVE_PATH, *page_files.PATHS})
_READING = frozenset({"GET", "HEAD"})
_PREFIX, _SAMPLES = "/surfaces/", "/samples"
_SURFACES, _CONTACT, _BY_NAME = b"/surfaces/", b"/contact", b"surface="
_STREAM = "/stream"
_RELOAD = "/model/reload"


class Front:
    """The application: `api` behind its guard."""

    def __init__(self, api: FastAPI, access: Access, context: Context) -> None:
        self.api = api
        self.context = context
        self._access = access
        self._contacts = EncodedContacts(context.registry)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request (ASGI)."""
        if scope["type"] != "http":
            await self.api(scope, receive, send)
            return
        if scope["method"] == "HEAD" and not scope["path"].endswith(_STREAM):
            # The server leaves the body out. A stream would never end.
            scope = {**scope, "method": "GET"}
        try:
            self._access.require(self._role(scope), _authorization(scope["headers"]))
            body = await self._receipt(scope, receive)
        except ClientDisconnect:
            # In the middle of its body: nobody would read an answer, and nothing was accepted.
            return
        except ProblemError as error:
            self.context.counts.problem(error.problem.kind, client(scope))
            await handlers.answer(error.problem, error.headers)(scope, receive, _guarded(send))
            return
        except Exception as error:  # noqa: BLE001  # the last resort: whatever it is, the answer is a problem
            _log.error("an error ended a request", exc_info=error)
            self.context.counts.problem(Kind.INTERNAL, client(scope))
            await handlers.internal()(scope, receive, _guarded(send))
            return
        if body is None:
            await self.api(scope, receive, _guarded(send))
            return
        headers = [*CONTACT_HEADERS, (b"content-length", b"%d" % len(body))]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})

    def contact_at_once(self, target: bytes, authorization: bytes | None) -> bytes | None:
        """Return the contact that `GET target` asks for, as JSON.

        None where it asks for something else, may not be answered, or there is none to give: the routes say which.
        """
        path, _, query = target.partition(b"?")
        name = None
        if path != _CONTACT:
            if query or not path.startswith(_SURFACES) or not path.endswith(_CONTACT):
                return None
            name = path[len(_SURFACES) : -len(_CONTACT)].decode("ascii", "replace")
        elif query:
            if not query.startswith(_BY_NAME):
                return None
            name = query[len(_BY_NAME) :].decode("ascii", "replace")
        try:
            self._access.require(Role.READ, authorization)
        except ProblemError:
            return None
        state_and_body = self._contacts.get(name, self.context.clock())
        if state_and_body is None:
            return None
        counted, body = state_and_body
        self.context.counts.contacts[counted] += 1
        return body

    def knows(self, authorization: bytes) -> bool:
        """Say whether an `Authorization` header bears one of the tokens."""
        return self._access.knows(authorization)

    async def _receipt(self, scope: Scope, receive: Receive) -> bytes | None:
        """Take the batch that is sent; None for another request. Raises ProblemError."""
        path = scope["path"]
        name = path[len(_PREFIX) : -len(_SAMPLES)]
        if scope["method"] != "POST" or not path.startswith(_PREFIX) or not path.endswith(_SAMPLES) or "/" in name:
            return None
        receipt = await batches.take(self.context, name, Request(scope, receive))
        return receipt.model_dump_json().encode()

    def _role(self, scope: Scope) -> Role:
        needed = role(scope["method"], scope["path"])
        if scope["method"] in _READING or (needed is Role.WRITE and scope["path"].endswith(_SAMPLES)):
            return needed
        # Where there is no such route there is nothing to guard but the answer.
        is_route = any(route.matches(scope)[0] is Match.FULL for route in self.api.router.routes)
        return needed if is_route else Role.READ


def role(method: str, path: str) -> Role:
    """Return what a request needs; everything that is not reading writes, or administrates."""
    if method in _READING:
        return Role.OPEN if path in _OPEN_PATHS else Role.READ
    return Role.ADMIN if path.endswith(_RELOAD) else Role.WRITE


def client(scope: Scope) -> str:
    """Return the address of who asks."""
    return scope["client"][0] if scope.get("client") else "unknown"


def _authorization(headers: Iterable[tuple[bytes, bytes]]) -> bytes | None:
    for name, value in headers:
        if name == b"authorization":
            return value
    return None


def _guarded(send: Send) -> Send:
    """Return a `send` that adds our headers, unless a route has set its own."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = list(message.get("headers", []))
            names = {name.lower() for name, _ in headers}
            message = {**message, "headers": headers + [pair for pair in _HEADERS if pair[0] not in names]}
        await send(message)

    return sent
