"""The routes `GET /contact` and `GET /surfaces`: contact, summary, model and beam; from views of `surfaces/view.py`."""

from fastapi import Response
from pydantic import BaseModel
from starlette.requests import Request

from beamtouch_common.zones import Zone
from beamtouch_models.runtime import BeamDrawing, ModelFile, State
from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.context import Context, ContextParameter, SurfaceInPath, SurfaceInQuery, context_of
from beamtouch_service.problems import ProblemBody, ProblemError
from beamtouch_service.surfaces.channels import ChannelHealth, ChannelOut
from beamtouch_service.surfaces.comparison import ComparisonReport
from beamtouch_service.surfaces.fields import Contact, PlateContact, encode
from beamtouch_service.surfaces.model_description import ModelDescription, describe_model
from beamtouch_service.surfaces.order import SampleCounts
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.surface_problems import no_model

contact_router = gate.make_router("contact", Role.READ)
router = gate.make_router("surfaces", Role.READ)
model_router = gate.make_router("model", Role.READ)


class SurfaceSummary(BaseModel):
    """Channels, model, state, ages and counts of one surface."""

    name: str
    model: str | None
    """Name and fingerprint of the model; null without one."""
    beam: str | None
    """Identity of the beam and layout that the model is of; null without one."""
    channels: list[str]
    """Channels that a batch must contain, in the order of the model; empty without one."""
    unit: str | None
    """Unit of what the channels show, in which a batch states deflections; null without a model."""
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


class SurfaceList(BaseModel):
    """All surfaces of the service."""

    surfaces: list[SurfaceSummary]


class CandidateReport(BaseModel):
    """The candidate of a surface beside its model."""

    model: str | None
    """Name and fingerprint of the model in use; null without one."""
    candidate: str | None
    """Name and fingerprint of the candidate that is compared with it; null without one."""
    error: str | None
    """Reason not to compare the file of the candidate, or no longer; null while it is compared, and without a file."""
    comparison: ComparisonReport | None
    """What is known so far; null without a candidate that is compared, or was until an error ended that."""


class Beam(BaseModel):
    """The data to draw a beam, or a plate from above."""

    model: str
    """Name and fingerprint of the model; a contact that states the same one belongs to this beam."""
    length_mm: float
    """Of a plate, along `x`."""
    width_mm: float | None
    """Of a plate, along `y`; null on a beam."""
    drawn: BeamDrawing
    zones: dict[str, Zone]
    """The zones of the configuration by name."""


@contact_router.get("/contact", response_model=Contact | PlateContact)
async def get_contact(request: Request, surface: SurfaceInQuery = None) -> Response:
    """Return the contact on the only surface, or on the one that is named."""
    context = context_of(request.scope)
    context.require_all("Ask for /surfaces/NAME/contact.")
    return _contact(context, surface)


@contact_router.get("/surfaces/{name}/contact", response_model=Contact | PlateContact)
async def get_surface_contact(request: Request, name: SurfaceInPath) -> Response:
    """Return the contact on this surface."""
    return _contact(context_of(request.scope), name)


def _contact(context: Context, name: str | None) -> Response:
    view = context.registry.chosen(name).view(context.clock())
    content = encode(view)
    context.counts.contacts.labels(view.surface, str(view.state)).inc()
    return Response(content, media_type="application/json")


@router.get("/surfaces")
async def get_surfaces(context: ContextParameter) -> SurfaceList:
    """Return all surfaces of this service."""
    context.require_all("Ask for /surfaces/NAME of each.")
    now_s = context.clock()
    return SurfaceList(surfaces=[summarize(surface, now_s) for surface in context.registry])


@router.get("/surfaces/{name}")
async def get_surface(context: ContextParameter, name: SurfaceInPath) -> SurfaceSummary:
    """Return one surface: its channels, model, age limit, and counts of samples."""
    return summarize(context.registry.named(name), context.clock())


@model_router.get("/surfaces/{name}/model")
async def get_model(context: ContextParameter, name: SurfaceInPath) -> ModelDescription:
    """Return the metadata of the model of this surface: layout, ranges, accuracy, calibration."""
    return describe_model(_model(context, name))


@model_router.get("/surfaces/{name}/candidate")
async def get_candidate(context: ContextParameter, name: SurfaceInPath) -> CandidateReport:
    """Return how the candidate of this surface differs from its model, on the samples that arrived since it came.

    It answers 200 without a candidate, too.
    """
    surface = context.registry.named(name)
    shadow = surface.shadow
    return CandidateReport(
        model=surface.model.identity if surface.model else None,
        candidate=shadow.model.identity if shadow else None,
        error=surface.candidate_error or (shadow.error if shadow else None),
        comparison=shadow.comparison.report() if shadow else None,
    )


@model_router.get("/surfaces/{name}/beam")
async def get_beam(context: ContextParameter, name: SurfaceInPath) -> Beam:
    """Return the supports of the beam, its deflection per newton for positions of the contact along it, and its zones.

    It changes only with the model, so it is not part of the stream.
    """
    model, zones = _model(context, name), context.registry.named(name).section.zones
    metadata = model.metadata
    return Beam(
        model=model.identity,
        length_mm=metadata.length_mm,
        width_mm=metadata.width_mm,
        drawn=metadata.drawn,
        zones=zones,
    )


def summarize(surface: Surface, now_s: float) -> SurfaceSummary:
    """Return the summary of a surface at `now_s` [s, monotonic]."""
    view, model = surface.view(now_s), surface.model
    return SurfaceSummary(
        name=surface.name,
        model=model.identity if model else None,
        beam=model.metadata.beam if model else None,
        channels=model.channels if model else [],
        unit=model.metadata.unit if model else None,
        stale_ms=surface.stale_ms,
        age_ms=view.age_ms,
        state=view.state,
        problem=view.problem and ProblemBody.model_validate(view.problem.body()),
        notes=view.notes,
        misfit=view.misfit,
        misfit_limit=view.misfit_limit,
        channels_out=dict(view.totals.channels_out),
        wiring=surface.wiring,
        model_error=surface.model_error,
        samples=surface.counts,
        health=surface.channel_health,
    )


def _model(context: Context, name: str) -> ModelFile:
    surface = context.registry.named(name)
    if surface.model is None:
        raise ProblemError(no_model(name, surface.model_error))
    return surface.model
