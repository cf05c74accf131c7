"""Every error as problem+json: our own, the framework's, and unexpected ones."""

import json

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response
from starlette.routing import Match, Route
from starlette.types import Scope

from beamtouch_service.access import Role
from beamtouch_service.api.context import context_of
from beamtouch_service.problems import MEDIA_TYPE, Kind, Problem, ProblemError
from beamtouch_service.record import MAX_ANSWERS, RecordAwayError, TooManyReadersError

MAX_ERRORS = 10
"""Places that an answer lists. A batch can be wrong in thousands."""
_MAX_POINTER = 200


def install(app: FastAPI) -> None:
    """Make `app` answer every error with problem+json."""
    app.exception_handler(ProblemError)(_problem)
    app.exception_handler(RecordAwayError)(_record_unavailable)
    app.exception_handler(TooManyReadersError)(_too_many_readers)
    app.exception_handler(HTTPException)(_http)
    app.exception_handler(RequestValidationError)(_validation)
    app.exception_handler(ClientDisconnect)(_disconnect)


def answer(problem: Problem, headers: dict[str, str] | None = None) -> Response:
    """Return a problem as an answer."""
    return Response(encode(problem), problem.kind.status, headers, MEDIA_TYPE)


def encode(problem: Problem) -> bytes:
    """Return a problem as JSON."""
    # allow_nan=False: NaN is not JSON, so it must not leave the service, not even in an error.
    return json.dumps(problem.body(), allow_nan=False, ensure_ascii=False).encode("utf-8", "replace")


def internal(scope: Scope, _error: Exception) -> Response:
    """Count an unexpected error and return its answer, which does not quote it."""
    return _counted(scope, Problem(Kind.INTERNAL, "An error in the service ended this request. See its log."))


def invalid_request(flaws: list[dict[str, str]], count: int) -> Problem:
    """Return the problem of a request with `count` flaws; `flaws` lists the first of them."""
    first = f"{flaws[0]['pointer']}: {flaws[0]['detail']}" if flaws else "unknown place"
    more = f" (and {count - 1} more)" if count > 1 else ""
    return Problem(Kind.INVALID_REQUEST, f"{first}{more}", members={"errors": flaws})


def pointer(location: tuple[int | str, ...]) -> str:
    """Return a location in a JSON document as a pointer (RFC 6901) in fragment form. Very long ones are cut."""
    parts = (str(part).replace("~", "~0").replace("/", "~1") for part in location)
    return ("#" + "".join(f"/{part}" for part in parts))[:_MAX_POINTER]


def client(scope: Scope) -> str:
    """Return the address of the client."""
    return scope["client"][0] if scope.get("client") else "unknown"


def _counted(scope: Scope, problem: Problem, headers: dict[str, str] | None = None) -> Response:
    context = context_of(scope)
    context.counts.count_problem(problem.kind)
    context.change_log.log_refusal(problem.kind, client(scope))
    return answer(problem, headers)


def refuse(scope: Scope, error: ProblemError) -> Response:
    """Count a problem and return its answer."""
    return _counted(scope, error.problem, error.headers)


async def _problem(request: Request, error: ProblemError) -> Response:
    return refuse(request.scope, error)


async def _record_unavailable(request: Request, error: RecordAwayError) -> Response:
    detail = f"{error}. Answers go on, and daemons keep their samples."
    return _counted(request.scope, Problem(Kind.RECORD_UNAVAILABLE, detail), {"Retry-After": "1"})


async def _too_many_readers(request: Request, _error: TooManyReadersError) -> Response:
    detail = (
        f"{MAX_ANSWERS} answers from the record are under way, which is the limit. Ask again later, and less often."
    )
    return _counted(request.scope, Problem(Kind.TOO_MANY_CLIENTS, detail), {"Retry-After": "1"})


async def _http(request: Request, error: HTTPException) -> Response:
    headers = dict(error.headers or {})
    try:
        # No route and no role: which addresses exist is told only to clients that may read.
        context_of(request.scope).allow(request.scope, Role.READ)
    except ProblemError as refusal:
        return await _problem(request, refusal)
    if error.status_code == Kind.METHOD_NOT_ALLOWED.status:
        allowed = headers["Allow"] = ", ".join(_methods_at(request))
        detail = f"{request.method} is not allowed here. Allowed: {allowed}."
        return _counted(request.scope, Problem(Kind.METHOD_NOT_ALLOWED, detail), headers)
    if error.status_code == Kind.NOT_FOUND.status:
        return _counted(request.scope, Problem(Kind.NOT_FOUND, "See /openapi.json for the addresses."), headers)
    # The framework has a few more. It words them well enough, and RFC 9457 has a type for them.
    body = {"type": "about:blank", "title": error.detail, "status": error.status_code, "detail": error.detail}
    return Response(json.dumps(body), error.status_code, headers, MEDIA_TYPE)


def _methods_at(request: Request) -> list[str]:
    """Return the methods of all routes at the address of a request; the framework names those of the first one."""
    routes = [one for one in request.app.routes if isinstance(one, Route)]
    here = [one for one in routes if one.matches(request.scope)[0] != Match.NONE]
    return sorted({method for one in here for method in one.methods or ()})


async def _validation(request: Request, error: RequestValidationError) -> Response:
    found = error.errors()
    flaws = [{"pointer": pointer(tuple(one["loc"])), "detail": str(one["msg"])} for one in found[:MAX_ERRORS]]
    return _counted(request.scope, invalid_request(flaws, len(found)))


async def _disconnect(_request: Request, _error: ClientDisconnect) -> Response:
    # The sender left in the middle of its body: nobody reads this answer, and nothing was accepted.
    return Response(status_code=400)
