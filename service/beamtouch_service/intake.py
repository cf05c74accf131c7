"""What a write goes through before a surface sees it: token, size, format."""

import hmac
from asyncio import CancelledError

from pydantic import ValidationError
from starlette.requests import Request

from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Batch

MAX_BODY_BYTES = 1024 * 1024
_MAX_ERRORS = 10
_MAX_POINTER = 200


def check_token(request: Request, token: str | None) -> None:
    """Let a request with the right bearer token pass; raises ProblemError (401) for any other, and without a token."""
    if token is None:
        raise _unauthorized("Writes are not allowed: start the service with --token-file FILE to allow them.")
    scheme, _, given = request.headers.get("authorization", "").partition(" ")
    if scheme.lower() != "bearer":
        raise _unauthorized("Send the header `Authorization: Bearer TOKEN` with the token of the service's token file.")
    # As bytes, since text beyond ASCII cannot be compared in constant time.
    if not hmac.compare_digest(given.strip().encode(), token.encode()):
        raise _unauthorized("The token is not the one in the service's token file.")


def _unauthorized(detail: str) -> ProblemError:
    return ProblemError(Problem(Kind.UNAUTHORIZED, detail), {"WWW-Authenticate": 'Bearer realm="beamtouch"'})


async def read_body(request: Request, limit: int = MAX_BODY_BYTES) -> bytes:
    """Return the body; raises ProblemError (413) once it is known to exceed `limit` bytes, stated or chunked.

    A body that is still under way when the service stops ends in a problem too (503): the sender will repeat it.
    """
    stated = request.headers.get("content-length", "")
    if stated.isdecimal() and int(stated) > limit:
        raise _too_large(limit)
    body = bytearray()
    try:
        async for chunk in request.stream():
            body += chunk
            if len(body) > limit:
                raise _too_large(limit)
    except CancelledError:
        # Only the server cancels a request, at the end of its patience, and would log a traceback of it.
        raise ProblemError(Problem(Kind.STOPPING, "Nothing was accepted; send the batch again.")) from None
    return bytes(body)


def _too_large(limit: int) -> ProblemError:
    detail = f"A batch may be at most {limit} bytes long; send fewer samples at a time."
    return ProblemError(Problem(Kind.TOO_LARGE, detail, members={"limit_bytes": limit}))


def parse_batch(body: bytes) -> Batch:
    """Read a batch; raises ProblemError (400 if it is not JSON, 422 with the places that are wrong)."""
    try:
        return Batch.model_validate_json(body)
    except ValidationError as error:
        # Neither input nor context: a wrong body can be a megabyte long, and an answer is no place to repeat it.
        found = error.errors(include_url=False, include_input=False, include_context=False)
        if found[0]["type"] == "json_invalid":
            detail = f"{found[0]['msg']}; send a batch as application/json."
            raise ProblemError(Problem(Kind.MALFORMED_JSON, detail)) from None
        places = [{"pointer": pointer(entry["loc"]), "detail": entry["msg"]} for entry in found[:_MAX_ERRORS]]
        raise ProblemError(invalid_request(places, error.error_count())) from None


def invalid_request(places: list[dict[str, str]], count: int) -> Problem:
    """Return the problem for a request that is wrong in `count` places, the first of which are given."""
    first = f"{places[0]['pointer']}: {places[0]['detail']}" if places else "unknown place"
    more = f" (and {count - 1} more)" if count > 1 else ""
    return Problem(Kind.INVALID_REQUEST, f"{first}{more}", members={"errors": places})


def pointer(location: tuple[int | str, ...]) -> str:
    """Return a place in a JSON document as a pointer (RFC 6901) in fragment form, cut where a key is absurdly long."""
    parts = (str(part).replace("~", "~0").replace("/", "~1") for part in location)
    return ("#" + "".join(f"/{part}" for part in parts))[:_MAX_POINTER]
