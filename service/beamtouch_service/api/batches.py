"""Taking a batch, from the headers of its request to its receipt."""

from starlette.requests import Request

from beamtouch_service.api.context import Context
from beamtouch_service.api.intake import parse_batch, read_body
from beamtouch_service.problems import ProblemError
from beamtouch_service.samples import Receipt


async def take(context: Context, name: str, request: Request) -> Receipt:
    """Read the batch in a request that may write, and hand it to its surface. Raises ProblemError."""
    try:
        surface = context.registry.named(name)
        context.take_turn(name)
        # The age was stated before the body travelled, so the instant is one before it came: what the body takes makes
        # the samples older, never younger.
        arrival_s = context.clock()
        # The body is read here and not by the framework: never beyond its limits.
        body = await read_body(request)
        batch, changes = parse_batch(body), surface.sender_changes
        receipt = surface.receive(batch, arrival_s)
    except ProblemError as error:
        # Whatever a client makes up is no label: there is one per surface, and an empty one.
        context.counts.rejected[name if context.registry.find(name) else "", error.problem.kind] += 1
        raise
    surface.timings.batch_s.add(context.clock() - arrival_s)
    if surface.sender_changes != changes:
        context.counts.sender_changed(name, batch.boot_id)
    return receipt
