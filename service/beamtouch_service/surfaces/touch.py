"""Decides on the samples of one sender, in the order in which they were taken. Pure but for the run of the model."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from beamtouch_models.modelfile import (
    Decider,
    Evidence,
    LeftOut,
    ModelFile,
    State,
    Suspects,
    Verdict,
    is_odd,
    is_overload,
    is_unchecked,
)
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.surfaces.contact import (
    NO_FIGURES,
    Decision,
    Doubt,
    Figures,
    UnusableEstimateError,
    figures_of,
    require_usable,
)
from beamtouch_service.surfaces.contradiction import Contradiction, contradiction
from beamtouch_service.surfaces.estimates import Ask, Estimated
from beamtouch_service.surfaces.stretch_samples import is_asked, is_kept


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
    """The sample channel by channel, if its stretch keeps it."""

    shown: bool = True
    """Whether the sample shows the state by itself. If not, the state stands on earlier samples."""

    @property
    def state(self) -> State | None:
        """The state; None if it could not be decided."""
        return self.outcome.state if isinstance(self.outcome, Decision) else None

    @property
    def is_unsteady(self) -> bool:
        """Whether position and force are less certain than those of a sample at rest."""
        return isinstance(self.outcome, Decision) and Doubt.UNSTEADY in self.outcome.notes


@dataclass(frozen=True, slots=True)
class _Judged:
    """A sample whose state is decided."""

    estimated: Estimated
    evidence: Evidence
    verdict: Verdict
    figures: Figures
    number: int
    """Its place in an unexplained stretch of the same channels."""

    @property
    def is_asked(self) -> bool:
        return self.verdict.state is State.UNEXPLAINED and is_asked(self.number)


class Follower:
    """Decides on the samples of one sender, in the order of their numbers.

    Over gaps and undecided samples, a state is held for `hold_ms` of the sender's time.
    """

    def __init__(self, model: ModelFile, ask: Ask, surface: str, hold_ms: float, *, state: State | None = None) -> None:
        """Begin after a sample of that state; None if it is not known."""
        self._metadata = model.metadata
        self._surface = surface
        self._hold_us = hold_ms * 1e3
        self._decider = Decider(model.metadata.thresholds, state)
        self._suspects = Suspects(model.metadata, ask)
        self._last: Estimated | None = None
        """The last decided sample."""
        self._length = 0
        """Samples of the current unexplained stretch with the same channels."""

    def follow(self, samples: Iterable[Estimated]) -> list[Seen]:
        """Decide on the next samples."""
        judged = [self._judge(one) for one in samples]
        # The graph runs once for all samples that need each channel left out.
        asked = [one.estimated for one in judged if isinstance(one, _Judged) and one.is_asked]
        left_out = iter(self._suspects.leave_out([one.weighed.part(np.array([one.row])) for one in asked]))
        return [
            one if isinstance(one, Seen) else self._seen(one, next(left_out) if one.is_asked else None)
            for one in judged
        ]

    def _judge(self, estimated: Estimated) -> _Judged | Seen:
        """Return a sample with its state, or as seen if it is undecided."""
        last = self._last
        # The sample before this one may be missing, or undecided.
        if last and estimated.sequence != last.sequence + 1:
            is_held = abs(estimated.acquired_unix_us - last.acquired_unix_us) <= self._hold_us
            if not is_held:
                self._decider, self._length = Decider(self._metadata.thresholds, None), 0
        evidence = estimated.evidence
        if isinstance(evidence, Problem):
            return Seen(estimated, evidence, self._decider.state)
        figures = NO_FIGURES
        try:
            require_usable(evidence)
            verdict = self._decider.step(evidence)
            if verdict.state is State.CONTACT:
                figures = figures_of(evidence.answer, self._metadata.length_mm)
        except UnusableEstimateError as error:
            detail = (
                f"For the newest sample, {error}. Check the characteristics and tare of the sensors, then the model."
            )
            problem = Problem(Kind.UNUSABLE_ESTIMATE, detail, self._surface)
            return Seen(estimated, problem, self._decider.state)
        if verdict.state is not State.UNEXPLAINED or (last and last.bad.keys() != estimated.bad.keys()):
            self._length = 0
        number = self._length
        self._length += verdict.state is State.UNEXPLAINED
        self._last = estimated
        return _Judged(estimated, evidence, verdict, figures, number)

    def _seen(self, judged: _Judged, without: dict[str, LeftOut] | None) -> Seen:
        estimated, evidence, state = judged.estimated, judged.evidence, judged.verdict.state
        notes: list[str] = [Doubt.UNSTEADY] if judged.verdict.unsteady else []
        suspect, why = None, None
        if judged.number == 0:
            self._suspects.clear()
        if state is State.CONTACT:
            notes += self._doubts(evidence)
        if without is not None:
            self._suspects.add(without)
        if state is State.UNEXPLAINED:
            suspect = self._suspects.suspect
            notes += [f"check-{suspect}"] if suspect else []
        if without is not None and is_kept(judged.number):
            why = contradiction(self._metadata, estimated, evidence, without, notes)
        misfit = min(evidence.rest_misfit, evidence.misfit)
        decision = Decision(state, judged.figures, misfit, notes, suspect)
        odd = is_odd(self._metadata.thresholds, evidence)
        return Seen(estimated, decision, state, odd, why, judged.verdict.shown)

    def _doubts(self, evidence: Evidence) -> list[str]:
        """Return the notes on a contact."""
        found: list[str] = [Doubt.OVERLOAD] if is_overload(self._metadata, evidence) else []
        return [*found, Doubt.UNCHECKED] if is_unchecked(evidence) else found
