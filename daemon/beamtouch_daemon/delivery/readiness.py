"""Whether the service takes the samples of a surface. Asks without sending a sample, so no answer of it changes."""

from typing import Literal, TypeVar

from pydantic import BaseModel

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.delivery.client import INVALID_REQUEST, ServiceClient, UnreachableError


class _Summary(BaseModel):
    """What counts here of the service's summary of a surface."""

    channels: list[str]
    """Channels that the model needs."""
    beam: str | None = None
    """Identity of the beam and layout that the model is of; null without a model."""


class _Contact(BaseModel):
    """What counts here of the service's answer to `GET /contact`."""

    state: Literal["clear", "contact", "unexplained"]
    position_mm: float | None
    force_n: float | None


class _Model(BaseModel):
    """What counts here of the service's description of a model."""

    identity: str
    beam: str


_T = TypeVar("_T", bound=BaseModel)


async def contact_on(client: ServiceClient, surface: str) -> str | None:
    """Return what the service sees on a surface now, in words: empty for a beam at rest, None if it cannot tell."""
    contact = await _ask(client, f"/surfaces/{surface}/contact", _Contact)
    if contact is None:
        return None
    if contact.state == "clear":
        return ""
    if contact.position_mm is None:
        return "something that it cannot explain"
    force = "" if contact.force_n is None else f" of {contact.force_n:.3g} N"
    return f"a contact{force} at {contact.position_mm:.0f} mm"


async def refusal_of(client: ServiceClient, name: str, surface: Surface) -> str | None:
    """Return why the service does not take the samples of a surface; None if it takes them.

    The service refuses an empty batch as incomplete only after the token and the surface are found right.
    """
    try:
        answer = await client.post_samples(name, None)
        if answer.problem != INVALID_REQUEST:
            return f"the service at {client.url} takes no samples: {answer.explanation}"
        answer = await client.get(f"/surfaces/{name}")
    except UnreachableError as error:
        advice = (
            error.advice or "does it run, is publish.url right (http or https?), and does a firewall let it through?"
        )
        return f"no answer from the service at {client.url} ({error}); {advice}"
    if not answer.is_success:
        return f"the service at {client.url}: {answer.explanation}"
    summary = answer.parsed(_Summary)
    if summary is None:
        return f"{client.url} is not a beamtouch service, or another version; correct publish.url"
    return _mismatch_of(summary, name, surface)


def _mismatch_of(summary: _Summary, name: str, surface: Surface) -> str | None:
    """Return why samples of a surface do not fit the service's model; None if they do."""
    if surface.beam is not None and summary.beam not in {None, surface.beam}:
        return (
            f"the service's model is of beam {summary.beam}, but surfaces.{name}.beam is {surface.beam}: give the "
            f"service the model of {surface.beam}, or use the configuration that was built with its model"
        )
    if missing := [channel for channel in summary.channels if channel not in surface.channel_names]:
        needed = ", ".join(summary.channels)
        return f"the service's model needs channels {needed}; {', '.join(missing)} not in the configuration"
    return None


async def doubt_of(client: ServiceClient, name: str, surface: Surface) -> str | None:
    """Return that nobody would notice a model of another beam, and what to write; None if somebody would."""
    model = await _ask(client, f"/surfaces/{name}/model", _Model) if surface.beam is None else None
    if model is None:  # `refusal_of` says what is wrong
        return None
    return (
        f"surfaces.{name} states no beam, so a model of another beam would pass unnoticed; "
        f'if the service\'s model {model.identity} is the right one, write beam = "{model.beam}"'
    )


async def _ask(client: ServiceClient, path: str, model: type[_T]) -> _T | None:
    """Return the service's answer; None if there is none, or another one, such as a problem."""
    try:
        return (await client.get(path)).parsed(model)
    except UnreachableError:
        return None
