"""Asks the service whether it takes the samples of a surface, without sending one, so that no answer of it changes."""

from typing import Literal, NamedTuple

from pydantic import BaseModel

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.delivery.client import INVALID_REQUEST, ServiceClient, UnreachableError


class _Summary(BaseModel):
    """The members of the service's summary of a surface that are used here."""

    channels: list[str]
    """Channels that the model needs."""
    model: str | None = None
    """Identity of the model; null without one."""
    beam: str | None = None
    """Identity of the beam and layout that the model is of; null without a model."""


class _Contact(BaseModel):
    """The members of the answer to `GET /contact` that are used here."""

    state: Literal["clear", "contact", "unexplained"]
    position_mm: float | None = None
    x_mm: float | None = None
    y_mm: float | None = None
    force_n: float | None


class _Model(BaseModel):
    """The members of the answer to `GET /surfaces/NAME/model` that are used here."""

    calibration: dict[str, object] | None


class Readiness(NamedTuple):
    """The service's answer: whether it takes the samples of a surface, and whether they belong to its model."""

    refusal: str | None = None
    """Reason why it does not take them; None: it takes them."""
    doubt: str | None = None
    """Reason why its model may be of another beam without anybody noticing, and what to write."""


async def contact_on(client: ServiceClient, surface: str) -> str | None:
    """Return what the service sees on a surface now, in words: empty for a beam at rest, None if it cannot tell."""
    try:
        contact = (await client.get(f"/surfaces/{surface}/contact")).parsed(_Contact)
    except UnreachableError:
        return None
    if contact is None:
        return None
    if contact.state == "clear":
        return ""
    place_mm = [at_mm for at_mm in (contact.position_mm, contact.x_mm, contact.y_mm) if at_mm is not None]
    if not place_mm:
        return "something that it cannot explain"
    force = "" if contact.force_n is None else f" of {contact.force_n:.3g} N"
    return f"a contact{force} at {', '.join(f'{at_mm:.0f}' for at_mm in place_mm)} mm"


async def calibration_on(client: ServiceClient, surface: str) -> bool | None:
    """Return whether the service's model of a surface is calibrated; None if it cannot tell."""
    try:
        model = (await client.get(f"/surfaces/{surface}/model")).parsed(_Model)
    except UnreachableError:
        return None
    return None if model is None else model.calibration is not None


async def readiness_of(client: ServiceClient, name: str, surface: Surface) -> Readiness:
    """Ask the service about a surface.

    The service refuses an empty batch as incomplete only after the token and the surface are found right.
    """
    try:
        answer = await client.post_samples(name, None)
        if answer.problem != INVALID_REQUEST:
            return Readiness(f"the service at {client.url} takes no samples: {answer.explanation}")
        answer = await client.get(f"/surfaces/{name}")
    except UnreachableError as error:
        advice = (
            error.advice or "does it run, is publish.url right (http or https?), and does a firewall let it through?"
        )
        return Readiness(f"no answer from the service at {client.url} ({error}); {advice}")
    if not answer.is_success:
        return Readiness(f"the service at {client.url}: {answer.explanation}")
    summary = answer.parsed(_Summary)
    if summary is None:
        return Readiness(f"{client.url} is not a beamtouch service, or another version; correct publish.url")
    return _compare(summary, name, surface)


def _compare(summary: _Summary, name: str, surface: Surface) -> Readiness:
    """Return whether samples of a surface fit the service's model, and whether anybody would notice if they did not."""
    if surface.beam is not None and summary.beam not in {None, surface.beam}:
        return Readiness(
            f"the service's model is of beam {summary.beam}, but surfaces.{name}.beam is {surface.beam}: give the "
            f"service the model of {surface.beam}, or use the configuration that was built with its model"
        )
    if missing := [channel for channel in summary.channels if channel not in surface.channel_names]:
        needed = ", ".join(summary.channels)
        return Readiness(f"the service's model needs channels {needed}; {', '.join(missing)} not in the configuration")
    if surface.beam is not None or summary.beam is None:
        return Readiness()
    doubt = (
        f"surfaces.{name} states no beam, so a model of another beam would pass unnoticed; "
        f'if the service\'s model {summary.model} is the right one, write beam = "{summary.beam}"'
    )
    return Readiness(doubt=doubt)
