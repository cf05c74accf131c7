"""The commissioning runs that are under way, at most one per surface. They are in memory: a restart ends them."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from secrets import token_hex

from beamtouch_service.commissioning.run import CommissioningRun, PressDecision
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.follower import Decision
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.surface_problems import no_model

_HIDING_PRESSES = {Kind.NO_MODEL, Kind.NO_SAMPLES, Kind.STALE, Kind.OTHER_BEAM}
"""Problems while which no press can be seen. Any other problem may have the cause that commissioning looks for."""


def hides_presses(surface: Surface, now_s: float) -> Problem | None:
    """Return why nothing could be seen of a press at `now_s` [s, monotonic], or None."""
    problem = surface.view(now_s).problem
    return problem if problem and problem.kind in _HIDING_PRESSES else None


class CommissioningRuns:
    """Begins, feeds and ends the runs of all surfaces."""

    def __init__(self) -> None:
        self._runs: dict[str, CommissioningRun] = {}
        self._being_confirmed: set[str] = set()
        """Ids of the runs whose results are being written: nothing else happens to them meanwhile."""
        self._ended: dict[str, str] = {}
        """Surface -> why its last run ended without a result."""

    def of(self, surface: str) -> CommissioningRun | None:
        """Return the run of a surface; None if none is under way."""
        return self._runs.get(surface)

    def why_ended(self, surface: str) -> str | None:
        """Return why the last run of a surface ended without a result; None if it did not."""
        return self._ended.get(surface)

    def start(self, surface: Surface, now_s: float, now_us: int) -> CommissioningRun:
        """Begin a run at `now_s` [s, monotonic], `now_us` [us since 1970].

        Raises
        ------
        ProblemError
            One is under way, or nothing can be seen of a press: no model, no samples, stale ones, or another beam.
        """
        if run := self._runs.get(surface.name):
            detail = f"One has been under way since {run.report.begun_at}. Go on with it, or abandon it first."
            raise ProblemError(_other(surface.name, detail))
        if problem := hides_presses(surface, now_s):
            raise ProblemError(problem)
        if surface.model is None:
            raise ProblemError(no_model(surface.name, surface.model_error))
        self._ended.pop(surface.name, None)
        run = CommissioningRun(token_hex(8), surface.name, surface.model, surface.stale_ms, now_us)
        self._runs[surface.name] = run
        return run

    def require(self, surface: str, run_id: str, step: int | None = None) -> CommissioningRun:
        """Return the run of a surface; raises ProblemError unless it is this one, at this step."""
        run = self._runs.get(surface)
        if run is None:
            detail = self._ended.get(surface) or "It has been confirmed or abandoned, or the service was restarted."
            raise ProblemError(Problem(Kind.NO_COMMISSIONING, detail, surface))
        if run.id != run_id:
            raise ProblemError(_other(surface, "Another one was begun meanwhile. Look at its state first."))
        if run.id in self._being_confirmed:
            raise ProblemError(_other(surface, "Its result is being put on record. Look at its state first."))
        if step is not None and run.step != step:
            raise ProblemError(_other(surface, f"It is at step {run.step} now. Look at its state first."))
        return run

    @contextmanager
    def confirm(self, run: CommissioningRun) -> Iterator[None]:
        """Write the result of a run within this; the run ends if that raises nothing, and goes on otherwise."""
        self._being_confirmed.add(run.id)
        try:
            yield
            del self._runs[run.report.surface]
        finally:
            self._being_confirmed.remove(run.id)

    def abandon(self, run: CommissioningRun, reason: str) -> None:
        """End a run without a result."""
        del self._runs[run.report.surface]
        self._ended[run.report.surface] = reason

    def take(self, surface: Surface, batch: Batch, decisions: Iterable[Decision]) -> Iterator[None]:
        """Take the samples of a batch that moved the answer of a surface in steps, with the decisions on them."""
        run = self._runs.get(surface.name)
        if run is None or run.id in self._being_confirmed:
            return
        if surface.model is not run.model:
            self.abandon(run, "The model of the surface changed meanwhile. Begin again.")
            return
        try:
            yield from _take(run, batch, decisions)
        except Exception:
            if self._runs.get(surface.name) is run:
                self.abandon(run, "An unexpected error of the service ended it; its log has the error. Begin again.")
            raise


def _take(run: CommissioningRun, batch: Batch, decisions: Iterable[Decision]) -> Iterator[None]:
    """Let a run take the samples of a batch, with the decisions on them."""
    for decision in decisions:
        reason = f"no position: {decision.problem.kind.title.lower()}" if decision.problem else ""
        seen = PressDecision(decision.state, decision.figures, reason)
        yield from run.take(batch.boot_id, batch.channels, decision.estimate.sample, seen)


def _other(surface: str, detail: str) -> Problem:
    return Problem(Kind.OTHER_COMMISSIONING, detail, surface)
