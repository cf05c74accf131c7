"""`GET /`: the files of the page, read once, with headers that keep a browser to them."""

import hashlib
from collections.abc import Awaitable, Callable
from importlib import resources

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

_TYPES = {
    "html": "text/html; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "svg": "image/svg+xml",
}
_HEADERS = {
    # The browser keeps files but asks each time whether they changed, so an update never mixes old and new files.
    "Cache-Control": "no-cache",
    "Content-Security-Policy": (
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


_FILES = {
    "/" if entry.name == "index.html" else f"/{entry.name}": entry
    for entry in sorted((resources.files("beamtouch_service") / "page").iterdir(), key=lambda entry: entry.name)
    if entry.is_file() and entry.name.rpartition(".")[2] in _TYPES
}
"""By path; the page itself is at `/`. The files hold no data, so they need no token."""


def routes() -> list[Route]:
    """Return a route for each file of the page."""
    return [_route(path, entry.name, entry.read_bytes()) for path, entry in _FILES.items()]


def _route(path: str, name: str, content: bytes) -> Route:
    return Route(path, _endpoint(content, _TYPES[name.rpartition(".")[2]]), methods=["GET"])


def _endpoint(content: bytes, media_type: str) -> Callable[[Request], Awaitable[Response]]:
    headers = {**_HEADERS, "ETag": f'"{hashlib.sha256(content).hexdigest()[:32]}"'}

    async def serve(request: Request) -> Response:
        known = request.headers.get("if-none-match", "")
        if headers["ETag"] in {tag.strip().removeprefix("W/") for tag in known.split(",")}:
            return Response(status_code=304, headers=headers)
        return Response(content, headers=headers, media_type=media_type)

    return serve
