"""The state of one surface at one time, as the stream sends it. Pure."""

from typing import Any

from pydantic import BaseModel

from beamtouch_service.problems import Kind, ProblemBody, ProblemError
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.surface import Surface

_OF_NO_SAMPLE = {Kind.NO_SAMPLES, Kind.STALE, Kind.OTHER_BEAM}


class ChannelState(BaseModel):
    """One channel of the model."""

    name: str
    position_mm: float
    """Distance from the left end of the beam."""
    deflection_mm: float | None
    """Positive in the direction of the load; null without a fresh value."""
    quality: str


class SurfaceState(BaseModel):
    """The data of an event `state`: a contact or the problem that prevents it, and the channels."""

    surface: str
    contact: Contact | None
    problem: ProblemBody | None
    misfit_limit: float | None
    """The scale of the contact's misfit: neither rest nor a single contact explains a sample with a larger one."""
    age_ms: float | None
    """Age of the newest sample; null before the first."""
    channels: list[ChannelState]
    """Channels in the order of the model; empty without one."""
    length_mm: float | None
    """Length of the beam; null without a model."""
    sequence: int | None
    """Number of the newest sample."""


def state_of(surface: Surface, now_s: float) -> SurfaceState:
    """Return the state of a surface at `now_s` [s, monotonic]."""
    contact, problem, kind = None, None, None
    try:
        contact = surface.contact(now_s)
    except ProblemError as error:
        kind = error.problem.kind
        problem = ProblemBody.model_validate(error.problem.body())
    newest = surface.newest
    return SurfaceState(
        surface=surface.name,
        contact=contact,
        problem=problem,
        misfit_limit=surface.misfit_limit(now_s),
        age_ms=newest.age_ms(now_s) if newest else None,
        # A deflection that is too old for a contact must not be shown as current either.
        channels=_channels(surface, fresh=kind not in _OF_NO_SAMPLE),
        length_mm=surface.model.metadata.length_mm if surface.model else None,
        sequence=newest.sample.sequence if newest else None,
    )


def _channels(surface: Surface, *, fresh: bool) -> list[ChannelState]:
    newest = surface.newest if fresh else None
    known: dict[str, tuple[float | None, str]] = {}
    if newest:
        sample = newest.sample
        qualities = [quality.value for quality in sample.quality]
        known = dict(zip(newest.channels, zip(sample.deflection_mm, qualities, strict=True), strict=True))
    states = []
    for channel in surface.model.metadata.layout if surface.model else []:
        deflection, quality = known.get(channel.name, (None, Quality.MISSING.value))
        states.append(
            ChannelState(name=channel.name, position_mm=channel.position_mm, deflection_mm=deflection, quality=quality)
        )
    return states


def changing(state: dict[str, Any]) -> dict[str, Any]:
    """Return a state (as JSON) without the members that change by time alone."""
    kept = state | {"age_ms": None}
    for name in ("contact", "problem"):
        if kept[name]:
            # The detail of a stale contact contains its age.
            kept[name] = {key: value for key, value in kept[name].items() if key not in ("age_ms", "detail")}
    return kept
