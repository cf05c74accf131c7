"""The routes of commissioning: begin, look, skip a step, confirm or abandon; and the results on record."""

import time
from typing import Annotated, Literal

from fastapi import Path as PathParameter
from fastapi import Query, Response
from pydantic import AfterValidator, BaseModel, ConfigDict

from beamtouch_service.access import Role
from beamtouch_service.api import gate
from beamtouch_service.api.changes import make_entry
from beamtouch_service.api.context import CallerParameter, Context, ContextParameter, SurfaceInPath
from beamtouch_service.api.record_answers import SLOT
from beamtouch_service.callers import Caller, one_line
from beamtouch_service.commissioning import results
from beamtouch_service.commissioning.pressing import Stage
from beamtouch_service.commissioning.report import PlaceMm, Recorded, Report, as_text
from beamtouch_service.commissioning.run import CommissioningRun
from beamtouch_service.commissioning.runs import hides_presses
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.record import Action, Entry
from beamtouch_service.surfaces.contact import rfc3339

_TEXT = "text/plain; charset=utf-8"
_MAX_BY = 80
"""Length of the longest name of a person."""
_ABANDONED = "It was abandoned."


_Person = Annotated[
    str, AfterValidator(one_line), Query(min_length=1, max_length=_MAX_BY, description="Who confirms it.")
]
_RunId = Annotated[str, Query(alias="run", max_length=64, description="`id` of the run, as its state gives it.")]

router = gate.make_router("commissioning", Role.READ)
admin_router = gate.make_router("commissioning", Role.ADMIN)


class RunState(BaseModel):
    """A commissioning that is under way."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    id: str
    step: int
    """Number of the current step, from 0: a press above each sensor, then one at each mark."""
    steps: int
    """Number of steps. Once `step` has reached it, the result can be confirmed."""
    stage: Stage | None
    """The step's awaited action; null once every step is done."""
    held: float
    """Fraction of the hold time that has elapsed, 0 to 1."""
    at_mm: PlaceMm | None
    """The place to press now, by axis."""
    prompt: str
    """Instruction for the current step."""
    report: Report
    """The result so far."""


class CommissioningState(BaseModel):
    """The progress of a surface's commissioning, if one is under way."""

    model_config = ConfigDict(use_attribute_docstrings=True)

    run: RunState | None
    """Null if none is under way."""
    ended: str | None
    """Why the last one ended without a result; null if it did not, or the service was restarted."""
    lasting: bool
    """True if results outlive the service. Without a file or a database for events they do not."""


class CommissioningList(BaseModel):
    """The results on record, newest first."""

    commissionings: list[Recorded]


def _state(context: Context, name: str) -> CommissioningState:
    runs = context.commissioning_runs
    run = runs.of(name)
    problem = hides_presses(context.registry.named(name), context.clock())
    return CommissioningState(
        run=None if run is None else _run_state(run, problem),
        ended=None if run else runs.why_ended(name),
        lasting=context.recorder.transactions.is_lasting,
    )


def _run_state(run: CommissioningRun, problem: Problem | None) -> RunState:
    return RunState(
        id=run.id,
        step=run.step,
        steps=run.steps,
        stage=run.stage,
        held=round(run.held, 2),
        at_mm=run.at_mm,
        prompt=f"{problem.kind.title}. Go on once samples come again." if problem and not run.is_done else run.prompt,
        report=run.report,
    )


def _now_us() -> int:
    return round(time.time() * 1e6)


def _entry(run: CommissioningRun, caller: Caller, **details: object) -> Entry:
    """Return what the trail says of a step of a run."""
    return make_entry(Action.COMMISSIONING, details, caller, surface=run.report.surface, subject=run.id)


@router.get("/surfaces/{name}/commissioning")
async def get_commissioning(context: ContextParameter, name: SurfaceInPath) -> CommissioningState:
    """Return how far the commissioning of this surface is, if one is under way."""
    return _state(context, name)


@admin_router.post("/surfaces/{name}/commissioning")
async def post_commissioning(
    context: ContextParameter, caller: CallerParameter, name: SurfaceInPath
) -> CommissioningState:
    """Begin a commissioning of this surface."""
    run = context.commissioning_runs.start(context.registry.named(name), context.clock(), _now_us())
    context.recorder.trail.note(_entry(run, caller, step="begun"))
    return _state(context, name)


@admin_router.post("/surfaces/{name}/commissioning/skip")
async def post_commissioning_skip(
    context: ContextParameter,
    name: SurfaceInPath,
    run_id: _RunId,
    step: Annotated[int, Query(ge=0, le=1000, description="The step to skip, which must be the current one.")],
) -> CommissioningState:
    """End a step whose press is not seen."""
    run = context.commissioning_runs.require(context.registry.named(name).name, run_id, step)
    if run.is_done:
        raise ProblemError(Problem(Kind.OTHER_COMMISSIONING, "Every step is done. Confirm the result.", name))
    run.skip()
    return _state(context, name)


@admin_router.post("/surfaces/{name}/commissioning/confirm")
async def post_commissioning_confirm(
    context: ContextParameter,
    caller: CallerParameter,
    name: SurfaceInPath,
    run_id: _RunId,
    by: _Person,
) -> Recorded:
    """Put the result on record, once every step is done."""
    run = context.commissioning_runs.require(context.registry.named(name).name, run_id)
    if not run.is_done:
        detail = f"Steps that are left: {run.steps - run.step}. Do them, skip them, or abandon it."
        raise ProblemError(Problem(Kind.OTHER_COMMISSIONING, detail, name))
    report = run.report.model_copy(update={"ended_at": rfc3339(_now_us()), "by": by})
    with context.commissioning_runs.confirm(run):
        entry = _entry(run, caller, step="confirmed", signed=by)
        number = await context.recorder.write(lambda transactions: results.add(transactions, run.id, report, entry))
    return Recorded(id=number, **report.model_dump())


@admin_router.post("/surfaces/{name}/commissioning/abandon")
async def post_commissioning_abandon(
    context: ContextParameter, caller: CallerParameter, name: SurfaceInPath, run_id: _RunId
) -> CommissioningState:
    """End a commissioning without a result."""
    run = context.commissioning_runs.require(context.registry.named(name).name, run_id)
    context.commissioning_runs.abandon(run, _ABANDONED)
    context.recorder.trail.note(_entry(run, caller, step="abandoned"))
    return _state(context, name)


@router.get("/surfaces/{name}/commissionings", dependencies=[SLOT])
async def get_commissionings(context: ContextParameter, name: SurfaceInPath) -> CommissioningList:
    """Return the results on record of this surface, newest first: the last 20."""
    return CommissioningList(commissionings=await _recorded(context, name))


@router.get(
    "/surfaces/{name}/commissionings/{id}",
    response_model=Recorded,
    responses={200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
    dependencies=[SLOT],
)
async def get_commissioning_result(
    context: ContextParameter,
    name: SurfaceInPath,
    number: Annotated[int, PathParameter(alias="id", ge=1, lt=2**63)],
    as_format: Annotated[Literal["json", "text"], Query(alias="format", description="JSON, or text to read.")] = "json",
) -> Response:
    """Return one result on record."""
    one = next((one for one in await _recorded(context, name) if one.id == number), None)
    if one is None:
        detail = f"Surface {name} has no commissioning {number} on record; see GET /surfaces/{name}/commissionings."
        raise ProblemError(Problem(Kind.NO_COMMISSIONING, detail, name))
    if as_format == "text":
        return Response(as_text(one), media_type=_TEXT)
    return Response(one.model_dump_json(indent=2), media_type="application/json")


async def _recorded(context: Context, name: str) -> list[Recorded]:
    surface = context.registry.named(name).name
    return await context.recorder.readers.read(lambda reader: results.read(reader, surface))
