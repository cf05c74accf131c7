"""Every error of the web application, ours or the framework's, as problem+json."""

import json

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from beamtouch_service.api.intake import invalid_request, pointer
from beamtouch_service.problems import MEDIA_TYPE, Kind, Problem, ProblemError

NO_STORE = {"Cache-Control": "no-store"}


def install(app: FastAPI) -> None:
    """Have `app` answer every error with problem+json."""
    app.add_exception_handler(ProblemError, _problem)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(RequestValidationError, _validation)
    app.add_exception_handler(ClientDisconnect, _disconnect)
    app.add_exception_handler(Exception, _internal)


def answer(problem: Problem, headers: dict[str, str] | None = None) -> Response:
    """Return a problem as an answer."""
    # allow_nan=False: what is not JSON must not leave, not even in an error.
    content = json.dumps(problem.body(), allow_nan=False, ensure_ascii=False).encode("utf-8", "replace")
    return Response(content, problem.kind.status, {**NO_STORE, **(headers or {})}, MEDIA_TYPE)


def _counted(request: Request, problem: Problem, headers: dict[str, str] | None = None) -> Response:
    address = request.client.host if request.client else "unknown"
    request.app.state.context.counts.problem(problem.kind, address)
    return answer(problem, headers)


async def _problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, ProblemError)  # noqa: S101  # narrows the type; registered for nothing else
    return _counted(request, error.problem, error.headers)


async def _http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101  # narrows the type; registered for nothing else
    headers = dict(error.headers or {})
    if error.status_code == Kind.METHOD_NOT_ALLOWED.status:
        detail = f"{request.method} is not one of the methods here: {headers.get('Allow', 'see /openapi.json')}."
        return _counted(request, Problem(Kind.METHOD_NOT_ALLOWED, detail), headers)
    if error.status_code == Kind.NOT_FOUND.status:
        return _counted(
            request, Problem(Kind.NOT_FOUND, "See /openapi.json for the addresses of this service."), headers
        )
    # The framework has a few more of its own; it words them well enough, and RFC 9457 has a type for just that.
    body = {"type": "about:blank", "title": error.detail, "status": error.status_code, "detail": error.detail}
    return Response(json.dumps(body), error.status_code, {**NO_STORE, **headers}, MEDIA_TYPE)


async def _validation(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101  # narrows the type; registered for nothing else
    found = error.errors()
    places = [{"pointer": pointer(tuple(entry["loc"])), "detail": str(entry["msg"])} for entry in found[:10]]
    return _counted(request, invalid_request(places, len(found)))


async def _disconnect(_request: Request, _error: Exception) -> Response:
    # The sender left in the middle of its body: nobody reads this answer, and nothing was accepted.
    return Response(status_code=400)


def internal() -> Response:
    """Return the answer for an error of ours."""
    return answer(Problem(Kind.INTERNAL, "An error inside the service ended this request; its log says more."))


async def _internal(request: Request, _error: Exception) -> Response:
    request.app.state.context.counts.problem(Kind.INTERNAL, "")
    return internal()
