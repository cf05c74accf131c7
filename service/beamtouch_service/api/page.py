"""`GET /`: the files of the page, which hold no data and need no token, with headers that keep a browser to them."""

import mimetypes
from pathlib import Path

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.staticfiles import StaticFiles

FOLDER = Path(__file__).parents[1] / "page"
_HEADERS = {
    # The browser keeps files but asks each time whether they changed, so an update never mixes old and new files.
    "Cache-Control": "no-cache",
    "Content-Security-Policy": (
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; object-src 'none'"
    ),
    "Cross-Origin-Opener-Policy": "same-origin",
}
# Older versions of Python, and some machines, have another type, which a browser need not take for a module.
mimetypes.add_type("text/javascript", ".js")
_FILES = StaticFiles(directory=FOLDER, html=True)


def routes() -> list[Route]:
    """Return a route for each file of the page: a mount would also take the addresses that do not exist."""
    names = [path.name for path in sorted(FOLDER.iterdir())]
    return [Route("/" if name == "index.html" else f"/{name}", _serve, methods=["GET"]) for name in names]


async def _serve(request: Request) -> Response:
    response = await _FILES.get_response(request.url.path.removeprefix("/") or "index.html", request.scope)
    response.headers.update(_HEADERS)
    return response
