"""Decides on the samples of one sender, in the order in which they were taken. Pure but for the run of the model."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from beamtouch_models.modelfile import (
    Evidence,
    Hypotheses,
    Judgement,
    LeftOut,
    Memory,
    ModelFile,
    State,
    Suspects,
    is_odd,
    is_overload,
    is_unchecked,
    memories_after,
)
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.samples import Note
from beamtouch_service.surfaces.contact import (
    NO_FIGURES,
    Decision,
    Figures,
    UnusableEstimateError,
    figures_of,
    require_usable,
)
from beamtouch_service.surfaces.contradiction import Contradiction, contradiction
from beamtouch_service.surfaces.estimates import Ask, Estimated
from beamtouch_service.surfaces.stretch_samples import is_asked, is_kept


class Past(NamedTuple):
    """What the samples so far mean for the next one."""

    memories: tuple[Memory, ...]
    """What they may have left; several while the state before the first of them still matters."""
    decided_us: int | None = None
    """Time of the last decided sample [us since 1970]; None if it is not known."""
    is_held: bool = False
    """Whether the samples after that could not be decided, so that the state is held."""


NO_PAST = Past(memories_after(None))


class Seen(NamedTuple):
    """The decision on one sample."""

    estimated: Estimated
    outcome: Decision | Problem
    held: State
    """The state, also for undecided samples that follow closely on a decided one."""
    shown: bool
    """Whether the state is known, whatever the samples before were that are missing."""
    past: Past
    """What it leaves to the next sample."""
    is_odd: bool = False
    """Whether neither rest nor a single contact explains the sample. The state follows only after several of them."""
    why: Contradiction | None = None
    """The sample channel by channel, if its stretch keeps it."""

    @property
    def is_sure(self) -> bool:
        """Whether missing samples no longer matter, for this sample and all that follow."""
        return len(self.past.memories) == 1

    @property
    def state(self) -> State | None:
        """The state; None if it could not be decided."""
        return self.outcome.state if isinstance(self.outcome, Decision) else None

    @property
    def is_unsteady(self) -> bool:
        """Whether position and force are less certain than those of a sample at rest."""
        return isinstance(self.outcome, Decision) and Note.UNSTEADY in self.outcome.notes


class _Judged(NamedTuple):
    """A sample whose state is decided."""

    estimated: Estimated
    evidence: Evidence
    verdict: Judgement
    figures: Figures
    number: int
    """Its place in an unexplained stretch of the same channels."""
    past: Past

    @property
    def is_asked(self) -> bool:
        return self.verdict.state is State.UNEXPLAINED and is_asked(self.number)


class Follower:
    """Decides on the samples of one sender, in the order of their numbers.

    Over gaps and undecided samples, a state is held for `hold_ms` of the sender's time.
    """

    def __init__(self, model: ModelFile, ask: Ask, surface: str, hold_ms: float, past: Past = NO_PAST) -> None:
        """Begin after samples with that past."""
        self._metadata, self._surface = model.metadata, surface
        self._hold_us = hold_ms * 1e3
        self._suspects = Suspects(model.metadata, ask)
        self._hypotheses = Hypotheses(model.metadata.thresholds, past.memories)
        self._decided_us, self._is_held = past.decided_us, past.is_held
        self._before: int | None = None
        """Number of the last sample."""
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
        self._pass_to(estimated)
        evidence = estimated.evidence
        if isinstance(evidence, Problem):
            return self._undecided(estimated, evidence)
        figures = NO_FIGURES
        try:
            require_usable(evidence)
            verdict = self._hypotheses.step(evidence)
            if verdict.state is State.CONTACT:
                figures = figures_of(evidence.answer, self._metadata.length_mm)
        except UnusableEstimateError as error:
            detail = (
                f"For the newest sample, {error}. Check the characteristics and tare of the sensors, then the model."
            )
            return self._undecided(estimated, Problem(Kind.UNUSABLE_ESTIMATE, detail, self._surface))
        if verdict.state is not State.UNEXPLAINED or (last and last.bad.keys() != estimated.bad.keys()):
            self._length = 0
        number = self._length
        self._length += verdict.state is State.UNEXPLAINED
        self._last, self._decided_us, self._is_held = estimated, estimated.acquired_unix_us, False
        return _Judged(estimated, evidence, verdict, figures, number, self._past)

    def _pass_to(self, estimated: Estimated) -> None:
        """Pass over the samples that are missing before this one. A state is held for a while."""
        is_missing = self._before is not None and estimated.sequence != self._before + 1
        self._before = estimated.sequence
        if is_missing:
            self._hypotheses.miss()
        decided_us = self._decided_us if is_missing or self._is_held else None
        if decided_us is not None and abs(estimated.acquired_unix_us - decided_us) > self._hold_us:
            self._hypotheses = Hypotheses(self._metadata.thresholds, NO_PAST.memories)
            self._length = 0

    def _undecided(self, estimated: Estimated, problem: Problem) -> Seen:
        self._is_held = True
        return Seen(estimated, problem, self._hypotheses.state, self._hypotheses.agree, self._past)

    @property
    def _past(self) -> Past:
        return Past(self._hypotheses.memories, self._decided_us, self._is_held)

    def _seen(self, judged: _Judged, without: dict[str, LeftOut] | None) -> Seen:
        estimated, evidence, state = judged.estimated, judged.evidence, judged.verdict.state
        notes: list[str] = [Note.UNSTEADY] if judged.verdict.unsteady else []
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
        limits, place = self._metadata.thresholds, evidence.channels - 1
        misfit, limit = min((evidence.rest_misfit, limits.rest[place]), (evidence.misfit, limits.misfit[place]))
        decision = Decision(state, judged.figures, misfit, limit, notes, suspect)
        odd = is_odd(self._metadata.thresholds, evidence)
        return Seen(estimated, decision, state, judged.verdict.shown, judged.past, odd, why)

    def _doubts(self, evidence: Evidence) -> list[str]:
        """Return the notes on a contact."""
        found: list[str] = [Note.OVERLOAD] if is_overload(self._metadata, evidence) else []
        return [*found, Note.UNCHECKED] if is_unchecked(evidence) else found
