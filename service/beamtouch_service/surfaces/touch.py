"""Decides on the samples of one sender, in the order in which they were taken. Pure but for the run of the model."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.modelfile import Decider, Evidence, ModelFile, State, Suspects, Verdict, is_overload, is_unchecked
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.surfaces.contact import Decision, Doubt, UnusableEstimateError, figures_of, require_usable
from beamtouch_service.surfaces.estimates import Ask, Estimated


@dataclass(frozen=True, slots=True)
class Seen:
    """The decision on one sample."""

    estimated: Estimated
    outcome: Decision | Problem
    held: State
    """The state, also for undecided samples that follow closely on a decided one."""

    @property
    def state(self) -> State | None:
        """The state; None if it could not be decided."""
        return self.outcome.state if isinstance(self.outcome, Decision) else None


class Follower:
    """Decides on the samples of one sender, in the order of their numbers.

    Over gaps and undecided samples, a state is held for `hold_ms` of the sender's time.
    """

    def __init__(self, model: ModelFile, ask: Ask, surface: str, hold_ms: float, *, state: State = State.CLEAR) -> None:
        self._metadata = model.metadata
        self._surface = surface
        self._hold_us = hold_ms * 1e3
        self._decider = Decider(model.metadata.thresholds, state)
        self._suspects = Suspects(model.metadata, ask)
        self._last: Estimated | None = None
        """The last decided sample."""

    def step(self, estimated: Estimated) -> Seen:
        """Decide on the next sample."""
        last = self._last
        # The sample before this one may be missing, or undecided.
        if last and estimated.sequence != last.sequence + 1:
            is_held = abs(estimated.acquired_unix_us - last.acquired_unix_us) <= self._hold_us
            if not is_held and self._decider.state is not State.CLEAR:
                self._decider = Decider(self._metadata.thresholds)
        outcome = self._decide(estimated)
        if isinstance(outcome, Decision):
            self._last = estimated
        return Seen(estimated, outcome, self._decider.state)

    def _decide(self, estimated: Estimated) -> Decision | Problem:
        evidence = estimated.evidence
        if isinstance(evidence, Problem):
            return evidence
        try:
            require_usable(evidence)
            verdict = self._decider.step(evidence)
            return self._decision(estimated, evidence, verdict)
        except UnusableEstimateError as error:
            detail = (
                f"For the newest sample, {error}. Check the characteristics and tare of the sensors, then the model."
            )
            return Problem(Kind.UNUSABLE_ESTIMATE, detail, self._surface)

    def _decision(self, estimated: Estimated, evidence: Evidence, verdict: Verdict) -> Decision:
        misfit = min(evidence.rest_misfit, evidence.misfit)
        notes: list[str] = [Doubt.UNSTEADY] if verdict.unsteady else []
        if verdict.state is not State.UNEXPLAINED:
            self._suspects.clear()
        if verdict.state is State.CONTACT:
            figures = figures_of(evidence.answer, self._metadata.length_mm)
            return Decision(verdict.state, figures, misfit, notes + self._doubts(evidence))
        if verdict.state is State.UNEXPLAINED:
            suspect = self._suspects.step(estimated.weighed.part(np.array([estimated.row])))
            notes += [f"check-{suspect}"] if suspect else []
        return Decision(verdict.state, misfit=misfit, notes=notes)

    def _doubts(self, evidence: Evidence) -> list[str]:
        """Return what is doubtful about a contact."""
        found: list[str] = [Doubt.OVERLOAD] if is_overload(self._metadata, evidence) else []
        return [*found, Doubt.UNCHECKED] if is_unchecked(self._metadata, evidence) else found
