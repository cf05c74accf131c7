"""Everything that a surface tells beside its contact: its summary, and its state at one time for the stream. Pure."""

from typing import Any

from pydantic import BaseModel

from beamtouch_models.runtime import State
from beamtouch_service.problems import Kind, Problem, ProblemBody
from beamtouch_service.samples import Quality
from beamtouch_service.surfaces.channels import ChannelHealth, ChannelOut
from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.order import SampleCounts
from beamtouch_service.surfaces.surface import Surface

_OF_NO_SAMPLE = {Kind.NO_SAMPLES, Kind.STALE, Kind.OTHER_BEAM}


class SurfaceSummary(BaseModel):
    """Channels, model, state, ages and counts of one surface."""

    name: str
    model: str | None
    """Name and fingerprint of the model; null without one."""
    beam: str | None
    """Identity of the beam and layout that the model is of; null without one."""
    channels: list[str]
    """Channels that a batch must contain, in the order of the model; empty without one."""
    stale_ms: float
    """No contact is served from a sample older than this."""
    age_ms: float | None
    """Age of the newest sample; null before the first."""
    state: State | None
    """State, as `GET /contact` gives it; null where that is a problem."""
    problem: ProblemBody | None
    """Problem that `GET /contact` answers with; null where there is a contact."""
    notes: list[str]
    """Notes, as `GET /contact` gives them."""
    misfit: float | None
    """Misfit, as `GET /contact` gives it; null where that is a problem."""
    misfit_limit: float | None
    """Its scale: neither rest nor a single contact explains a sample with a larger one."""
    channels_out: dict[str, ChannelOut]
    """Channels that have not been good for longer than `degraded_after_s`."""
    wiring: str | None
    """Cables that seem to be swapped, or a sensor that seems to be inverted: put right, they explain several contacts
    that are unexplained as they are. Null if there is none."""
    model_error: str | None
    """Reason not to use the newest model file; null if it is used."""
    samples: SampleCounts
    health: dict[str, ChannelHealth] | None = None
    """Channel -> how it has changed; empty before the first contact. Null without a model."""


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


def summary_of(surface: Surface, now_s: float) -> SurfaceSummary:
    """Return the summary of a surface at `now_s` [s, monotonic]."""
    found = surface.answer(now_s)
    answer, problem = (None, found) if isinstance(found, Problem) else (found, None)
    misfit, misfit_limit = answer.misfit if answer else (None, None)
    return SurfaceSummary(
        name=surface.name,
        model=surface.model.identity if surface.model else None,
        beam=surface.model.metadata.beam if surface.model else None,
        channels=surface.model.channels if surface.model else [],
        stale_ms=surface.stale_ms,
        age_ms=surface.newest.age_ms(now_s) if surface.newest else None,
        state=answer.state if answer else None,
        problem=problem and ProblemBody.model_validate(problem.body()),
        notes=answer.notes if answer else [],
        misfit=misfit,
        misfit_limit=misfit_limit,
        channels_out=surface.channels_out.now,
        wiring=surface.wiring,
        model_error=surface.model_error,
        samples=surface.counts,
        health=surface.channel_health,
    )


def state_of(surface: Surface, now_s: float) -> SurfaceState:
    """Return the state of a surface at `now_s` [s, monotonic]."""
    answer, newest = surface.answer(now_s), surface.newest
    problem = answer if isinstance(answer, Problem) else None
    # A deflection that is too old for a contact must not be shown as current either.
    is_current = problem is None or problem.kind not in _OF_NO_SAMPLE
    return SurfaceState(
        surface=surface.name,
        contact=None if isinstance(answer, Problem) else surface.contact(now_s),
        problem=problem and ProblemBody.model_validate(problem.body()),
        misfit_limit=None if isinstance(answer, Problem) else answer.misfit[1],
        age_ms=newest.age_ms(now_s) if newest else None,
        channels=_channels(surface, is_current=is_current),
        length_mm=surface.model.metadata.length_mm if surface.model else None,
        sequence=newest.sample.sequence if newest else None,
    )


def _channels(surface: Surface, *, is_current: bool) -> list[ChannelState]:
    deflections_mm, qualities = dict[str, float | None](), dict[str, Quality]()
    if surface.newest and is_current:
        names, sample = surface.newest.channels, surface.newest.sample
        deflections_mm = dict(zip(names, sample.deflection_mm, strict=True))
        qualities = dict(zip(names, sample.quality, strict=True))
    return [
        ChannelState(
            name=channel.name,
            position_mm=channel.position_mm,
            deflection_mm=deflections_mm.get(channel.name),
            quality=qualities.get(channel.name, Quality.MISSING).value,
        )
        for channel in (surface.model.metadata.layout if surface.model else [])
    ]


def changing(state: dict[str, Any]) -> dict[str, Any]:
    """Return a state (as JSON) without the members that change by time alone."""
    essence = state | {"age_ms": None}
    for name in ("contact", "problem"):
        if essence[name]:
            # The detail of a stale contact contains its age.
            essence[name] = {key: value for key, value in essence[name].items() if key not in ("age_ms", "detail")}
    return essence
