"""Whether the service takes the samples of a surface. Asks without sending a sample, so no answer of it changes."""

from collections.abc import Sequence

from pydantic import BaseModel, ValidationError

from beamtouch_daemon.config.settings import Loads
from beamtouch_daemon.delivery.client import INVALID_REQUEST, ServiceClient
from beamtouch_daemon.delivery.unreachable import UnreachableError


class _Summary(BaseModel):
    """What counts here of the service's summary of a surface."""

    channels: list[str]
    """Channels that the model needs."""


class _Ranges(BaseModel):
    """The loads that a model covers."""

    position_mm: tuple[float, float]
    force_n: tuple[float, float]


class _ModelSummary(BaseModel):
    """What counts here of the service's description of a model."""

    identity: str
    ranges: _Ranges


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


async def doubt_of(client: ServiceClient, surface: str, loads: Loads | None) -> str | None:
    """Return why the service's model seems to be that of another surface; None if nothing says so.

    `build` writes the ranges of the model into the daemon's configuration, as the loads that `record` accepts.
    """
    if loads is None:
        return None
    try:
        answer = await client.get(f"/surfaces/{surface}/model")
        model = _ModelSummary.model_validate_json(answer.content)
    except (UnreachableError, ValidationError):  # `refusal_of` says what is wrong
        return None
    (first_mm, last_mm), (_, max_n) = model.ranges.position_mm, model.ranges.force_n
    covers = f"{first_mm:g} to {last_mm:g} mm and {max_n:g} N"
    records = f"{loads.position_mm[0]:g} to {loads.position_mm[1]:g} mm and {loads.max_force_n:g} N"
    if covers == records:  # a smaller difference is a rounding of the file
        return None
    return (
        f"the service's model {model.identity} covers {covers}, surfaces.{surface}.loads {records}: "
        "is it the model of this surface?"
    )
