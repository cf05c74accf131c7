"""Whether the service takes the samples of a surface. Asks without sending a sample, so no answer of it changes."""

from collections.abc import Sequence

from pydantic import BaseModel, ValidationError

from beamtouch_daemon.delivery.client import INVALID_REQUEST, ServiceClient
from beamtouch_daemon.delivery.unreachable import UnreachableError


class _Summary(BaseModel):
    """What counts here of the service's summary of a surface."""

    channels: list[str]
    """Channels that the model needs."""


async def refusal_of(client: ServiceClient, surface: str, channels: Sequence[str]) -> str | None:
    """Return why the service does not take samples of a surface with these channels; None if it takes them.

    The service refuses an empty batch as incomplete only after the token and the surface are found right.
    """
    try:
        answer = await client.post_samples(surface, b"{}")
        if answer.type != INVALID_REQUEST:
            return f"the service at {client.url} takes no samples: {answer.explanation}"
        summary = await client.get(f"/surfaces/{surface}")
    except UnreachableError as error:
        advice = (
            error.advice or "does it run, is publish.url right (http or https?), and does a firewall let it through?"
        )
        return f"no answer from the service at {client.url} ({error}); {advice}"
    if not summary.is_success:
        return f"the service at {client.url}: {summary.explanation}"
    try:
        needed = _Summary.model_validate_json(summary.content).channels
    except ValidationError:
        return f"{client.url} is not a beamtouch service, or another version; correct publish.url"
    missing = [name for name in needed if name not in channels]
    if missing:
        return f"the service's model needs channels {', '.join(needed)}; {', '.join(missing)} not in the configuration"
    return None
