"""Decides on the samples of one sender, in the order in which they were taken. Pure but for the run of the model."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.modelfile import Decider, Evidence, ModelFile, State, Suspects, is_overload, is_unchecked
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.surfaces.contact import (
    NO_FIGURES,
    Decision,
    Doubt,
    UnusableEstimateError,
    figures_of,
    require_usable,
)
from beamtouch_service.surfaces.contradiction import Contradiction, contradiction
from beamtouch_service.surfaces.estimates import Ask, Estimated


@dataclass(frozen=True, slots=True)
class Seen:
    """The decision on one sample."""

    estimated: Estimated
    outcome: Decision | Problem
    held: State
    """The state, also for undecided samples that follow closely on a decided one."""
    is_odd: bool = False
    """Whether neither rest nor a single contact explains the sample. The state follows only after several of them."""
    why: Contradiction | None = None
    """What the sample says channel by channel, if its state is `unexplained`."""

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
        evidence = estimated.evidence
        if isinstance(evidence, Problem):
            return Seen(estimated, evidence, self._decider.state)
        try:
            seen = self._decide(estimated, evidence)
        except UnusableEstimateError as error:
            detail = (
                f"For the newest sample, {error}. Check the characteristics and tare of the sensors, then the model."
            )
            problem = Problem(Kind.UNUSABLE_ESTIMATE, detail, self._surface)
            return Seen(estimated, problem, self._decider.state)
        self._last = estimated
        return seen

    def _decide(self, estimated: Estimated, evidence: Evidence) -> Seen:
        require_usable(evidence)
        verdict = self._decider.step(evidence)
        misfit = min(evidence.rest_misfit, evidence.misfit)
        notes: list[str] = [Doubt.UNSTEADY] if verdict.unsteady else []
        figures, suspect, why = NO_FIGURES, None, None
        if verdict.state is not State.UNEXPLAINED:
            self._suspects.clear()
        if verdict.state is State.CONTACT:
            figures = figures_of(evidence.answer, self._metadata.length_mm)
            notes += self._doubts(evidence)
        if verdict.state is State.UNEXPLAINED:
            suspect = self._suspects.step(estimated.weighed.part(np.array([estimated.row])))
            notes += [f"check-{suspect}"] if suspect else []
            why = contradiction(self._metadata, estimated, evidence, self._suspects, notes)
        is_odd = not self._suspects.explained(evidence)
        decision = Decision(verdict.state, figures, misfit, notes, suspect)
        return Seen(estimated, decision, verdict.state, is_odd, why)

    def _doubts(self, evidence: Evidence) -> list[str]:
        """Return what is doubtful about a contact."""
        found: list[str] = [Doubt.OVERLOAD] if is_overload(self._metadata, evidence) else []
        return [*found, Doubt.UNCHECKED] if is_unchecked(evidence) else found
