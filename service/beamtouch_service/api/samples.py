"""`POST /surfaces/NAME/samples`: from the headers of a batch to its receipt."""

import logging
import zlib
from asyncio import CancelledError, get_running_loop, timeout
from collections.abc import Iterator
from math import inf

from starlette.requests import Request
from starlette.responses import Response

from beamtouch_service.access import Role
from beamtouch_service.api import gate, openapi
from beamtouch_service.api.batches import read_batch
from beamtouch_service.api.changes import note_tare
from beamtouch_service.api.context import CALLER, Context, SurfaceInPath, context_of
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Batch, Receipt
from beamtouch_service.surfaces.surface import Received, Surface

MAX_BODY_BYTES = 1024 * 1024
MAX_BODY_S = 10.0
"""Longest time for a whole body to arrive. A sender states the age of its samples before it sends the body."""
LINGER_S = 5.0
"""Drain an oversized body for this long, so that the client can read the 413."""
_MAX_PEER = 64
"""Length of the longest address that the log repeats."""
_CLOSE = {"Connection": "close"}
"""The rest of the body may still come, and nobody reads it."""

_log = logging.getLogger(__name__)

router = gate.make_router("samples", Role.WRITE)


@router.post("/surfaces/{name}/samples", response_model=Receipt, openapi_extra=openapi.BATCH_BODY)
async def post_samples(name: SurfaceInPath, request: Request) -> Response:
    """Take a batch of samples. A repeated batch changes nothing. State the age of the newest sample at each attempt."""
    context = context_of(request.scope)
    try:
        surface = context.registry.named(name)
        # The age was stated before the body travelled. Counted from here, travel makes samples older, never younger.
        begin_s = context.clock()
        earliest_s = context.stalls.earliest_s(begin_s)
        body = decompress(await read_body(request), request.headers.get("content-encoding", ""))
        batch = await read_batch(body, context.stepper)
        async with surface.lock:
            arrival_s = surface.transit.arrival_s(batch, begin_s, earliest_s)
            received = surface.begin(batch, arrival_s, _peer(request))
            await context.stepper.finish(_follow(context, surface, batch, received))
    except ProblemError as error:
        known = name if name in context.registry.names else ""
        context.counts.rejected.labels(known, error.problem.kind.slug).inc()
        if error.problem.kind is Kind.OTHER_BEAM:
            context.change_log.log_other_beam(name, error.problem.detail)
        _log.debug(
            "%s: a batch from %s is refused: %s: %s",
            known,
            _peer(request),
            error.problem.kind.slug,
            error.problem.detail,
        )
        raise
    context.counts.batch_s.labels(name).observe(context.clock() - begin_s)
    with context.parts.attempt("trail", name):
        note_tare(context, name, batch, request.scope[CALLER])
    with context.parts.attempt("change log", name):
        context.change_log.log_changes(surface, begin_s)
    durable = expected = None
    with context.parts.attempt("record samples", name):
        durable, expected = await context.recorder.take(surface, batch, received.weighed(surface.model))
    receipt = Receipt(
        accepted=received.accepted,
        repeated=received.repeated,
        durable=durable,
        expected=expected,
        stale_ms=surface.stale_ms,
    )
    if _log.isEnabledFor(logging.DEBUG):
        _tell(name, request, batch, receipt, context.clock() - begin_s)
    return Response(receipt.model_dump_json(), media_type="application/json")


def _tell(name: str, request: Request, batch: Batch, receipt: Receipt, took_s: float) -> None:
    """Write a batch that was taken to the debug log."""
    numbers = [sample.sequence for sample in batch.samples]
    samples = f"samples {numbers[0]} to {numbers[-1]}" if numbers else "no samples"
    words = "%s: a batch from %s, boot %s, %s: %s; %.1f ms"
    _log.debug(words, name, _peer(request), batch.boot_id, samples, receipt, took_s * 1e3)


def _follow(context: Context, surface: Surface, batch: Batch, received: Received) -> Iterator[None]:
    """Move the answer by one sample after another, and the commissioning with it."""
    heard = 0
    for step in received.steps:
        with context.parts.attempt("commissioning", surface.name):
            yield from context.commissioning_runs.take(surface, batch, received.decisions[heard:])
        heard = len(received.decisions)
        yield step


def _peer(request: Request) -> str:
    """Return the address and port that a batch came from, for the log, and before it the client of a proxy."""
    peer = f"{request.client.host}:{request.client.port}" if request.client else "unknown"
    behind = request.headers.get("x-forwarded-for", "").rpartition(",")[2].strip()[:_MAX_PEER]
    return f"{behind} (through {peer})" if behind else peer


async def read_body(request: Request) -> bytes:
    """Return the body of a request.

    Raises
    ------
    ProblemError
        413 once the body is known to exceed `MAX_BODY_BYTES`, stated or chunked; 408 if it takes longer than
        `MAX_BODY_S`; 503 if the service stops meanwhile, and the sender repeats it.
    """
    stated = request.headers.get("content-length", "")
    is_too_large = stated.isdecimal() and int(stated) > MAX_BODY_BYTES
    body = bytearray()
    try:
        async with timeout(LINGER_S if is_too_large else MAX_BODY_S) as deadline:
            async for chunk in request.stream():
                if not is_too_large:
                    body += chunk
                    if len(body) > MAX_BODY_BYTES:
                        is_too_large = True
                        deadline.reschedule(min(deadline.when() or inf, get_running_loop().time() + LINGER_S))
                        body.clear()
    except TimeoutError:
        if is_too_large:
            raise _too_large() from None
        detail = f"The body was not complete after {MAX_BODY_S:g} s; send fewer samples at a time."
        raise ProblemError(Problem(Kind.TOO_SLOW, detail), _CLOSE) from None
    except CancelledError:
        # Only the server cancels a request, at the end of its patience, and would log a traceback of it.
        raise ProblemError(Problem(Kind.STOPPING, "Nothing was accepted; send the batch again.")) from None
    if is_too_large:
        raise _too_large()
    return bytes(body)


def decompress(body: bytes, encoding: str) -> bytes:
    """Return a body as it was before a `Content-Encoding`.

    Raises
    ------
    ProblemError
        413 as soon as it is known to exceed `MAX_BODY_BYTES`; 415 for another encoding than gzip; 400 if it is not gzip
        or not whole.
    """
    match encoding.strip().lower():
        case "" | "identity":
            return body
        case "gzip" | "x-gzip":
            return _unzip(body)
        case _:
            detail = "Send the batch with Content-Encoding: gzip, or without one."
            raise ProblemError(Problem(Kind.UNKNOWN_ENCODING, detail), {"Accept-Encoding": "gzip"})


def _unzip(body: bytes) -> bytes:
    decoder = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        content = decoder.decompress(body, MAX_BODY_BYTES + 1)
    except zlib.error:
        content = b""
    if len(content) > MAX_BODY_BYTES:
        raise _too_large()
    if not decoder.eof or decoder.unused_data:
        detail = "The body is not one whole gzip stream; send it as it is, or without Content-Encoding."
        raise ProblemError(Problem(Kind.MALFORMED_ENCODING, detail))
    return content


def _too_large() -> ProblemError:
    detail = f"A batch may be at most {MAX_BODY_BYTES} bytes long, also decompressed; send fewer samples at a time."
    return ProblemError(Problem(Kind.TOO_LARGE, detail, members={"limit_bytes": MAX_BODY_BYTES}), _CLOSE)
