"""Taking a batch, from the headers of its request to its receipt."""

from starlette.requests import Request

from beamtouch_service.context import Context
from beamtouch_service.intake import parse_batch, read_body
from beamtouch_service.problems import ProblemError
from beamtouch_service.samples import Receipt


async def take(context: Context, name: str, request: Request) -> Receipt:
    """Read the batch in a request that may write, and hand it to its surface. Raises ProblemError."""
    surface = context.registry.named(name)
    try:
        context.take_turn(name)
        # The age was stated before the body travelled, so the instant is one before it came: what the body takes makes
        # the samples older, never younger.
        arrival_s = context.clock()
        # The body is read here and not by the framework: never beyond its limits.
        body = await read_body(request)
        batch, changes = parse_batch(body), surface.sender_changes
        receipt = surface.receive(batch, arrival_s)
    except ProblemError as error:
        context.counts.rejected[error.problem.kind] += 1
        raise
    if surface.sender_changes != changes:
        context.counts.sender_changed(name, batch.boot_id)
    return receipt
