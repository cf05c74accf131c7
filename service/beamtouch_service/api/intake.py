"""What a batch goes through before a surface sees it: size, time, format."""

from asyncio import CancelledError, get_running_loop, timeout
from math import inf

from pydantic import ValidationError
from starlette.requests import Request

from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Batch

MAX_BODY_BYTES = 1024 * 1024
MAX_BODY_S = 10.0
"""For a whole body to arrive; a sender states the age of its samples before it."""
LINGER_S = 5.0
"""What is too large is read on and dropped for so long: who still sends when the connection closes reads no answer."""
_CLOSE = {"Connection": "close"}
"""The rest of the body may still come, and nobody wants it."""
_MAX_ERRORS = 10
_MAX_POINTER = 200


async def read_body(request: Request, limit: int = MAX_BODY_BYTES, limit_s: float = MAX_BODY_S) -> bytes:
    """Return the body; raises ProblemError (413) once it is known to exceed `limit` bytes, stated or chunked.

    A body that takes longer than `limit_s` [s] ends in a problem too (408), as does one that is still under way when
    the service stops (503): the sender will repeat it.
    """
    stated = request.headers.get("content-length", "")
    is_too_large = stated.isdecimal() and int(stated) > limit
    body = bytearray()
    try:
        async with timeout(LINGER_S if is_too_large else limit_s) as deadline:
            async for chunk in request.stream():
                if not is_too_large:
                    body += chunk
                    if len(body) > limit:
                        is_too_large = True
                        deadline.reschedule(min(deadline.when() or inf, get_running_loop().time() + LINGER_S))
                        body.clear()
    except TimeoutError:
        if is_too_large:
            raise _too_large(limit) from None
        detail = f"The body was not complete after {limit_s:g} s; send fewer samples at a time."
        raise ProblemError(Problem(Kind.TOO_SLOW, detail), _CLOSE) from None
    except CancelledError:
        # Only the server cancels a request, at the end of its patience, and would log a traceback of it.
        raise ProblemError(Problem(Kind.STOPPING, "Nothing was accepted; send the batch again.")) from None
    if is_too_large:
        raise _too_large(limit)
    return bytes(body)


def _too_large(limit: int) -> ProblemError:
    detail = f"A batch may be at most {limit} bytes long; send fewer samples at a time."
    return ProblemError(Problem(Kind.TOO_LARGE, detail, members={"limit_bytes": limit}), _CLOSE)


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
