"""Decides on the state that the samples of one sender show, in their order. Pure."""

from typing import NamedTuple

from beamtouch_models.modelfile import Evidence, Hypotheses, Memory, ModelFile, State, is_odd, memories_after
from beamtouch_service.problems import Kind, Problem
from beamtouch_service.surfaces.contact import NO_FIGURES, Figures, UnusableEstimateError, figures_of, require_usable
from beamtouch_service.surfaces.estimates import Estimated


class Past(NamedTuple):
    """What the samples so far mean for the next one."""

    memories: tuple[Memory, ...]
    """What they may have left; several while the state before the first of them still matters."""
    is_known: bool = False
    """Whether a state was known at any time."""
    decided_us: int | None = None
    """Time of the last decided sample [us since 1970]; None if it is not known."""
    is_held: bool = False
    """Whether the samples after that could not be decided, so that the state is held."""


NEUTRAL = Past(memories_after(None))
"""Nothing is known of the samples before."""


class Judged(NamedTuple):
    """A sample with the state that it shows."""

    estimated: Estimated
    state: State | None
    """None if it could not be decided."""
    held: State
    """The state, also for undecided samples that follow closely on a decided one."""
    shown: bool
    """Whether the state is certain even though earlier samples may be missing."""
    is_odd: bool = False
    """Whether neither rest nor a single contact explains the sample. The state follows only after several of them."""
    is_unsteady: bool = False
    """Whether position and force are less certain than those of a sample at rest."""
    figures: Figures = NO_FIGURES
    problem: Problem | None = None
    """Why it could not be decided."""


class Judge:
    """Decides on the samples of one sender, in the order of their numbers.

    Over gaps and undecided samples, a state is held for `hold_ms` of the sender's time.
    """

    def __init__(self, model: ModelFile, surface: str, hold_ms: float, past: Past = NEUTRAL) -> None:
        """Begin after samples with that past."""
        self._metadata, self._surface = model.metadata, surface
        self._hold_us = hold_ms * 1e3
        self._hypotheses = Hypotheses(model.metadata.thresholds, past.memories, is_known=past.is_known)
        self._decided_us, self._is_held = past.decided_us, past.is_held

    @property
    def past(self) -> Past:
        """What the samples so far mean for the next one."""
        return Past(self._hypotheses.memories, self._hypotheses.is_known, self._decided_us, self._is_held)

    def miss(self, next_us: int) -> None:
        """Pass over missing samples, up to one of this time."""
        self._hypotheses.miss()
        self._hold(next_us)

    def judge(self, estimated: Estimated) -> Judged:
        """Decide on the next sample."""
        if self._is_held:
            self._hold(estimated.acquired_unix_us)
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
        self._decided_us, self._is_held = estimated.acquired_unix_us, False
        return Judged(
            estimated,
            verdict.state,
            verdict.state,
            verdict.shown,
            is_odd(self._metadata.thresholds, evidence),
            verdict.unsteady,
            figures,
        )

    def _hold(self, next_us: int) -> None:
        """Forget the state if it was decided too long before a sample of this time."""
        if self._decided_us is not None and abs(next_us - self._decided_us) > self._hold_us:
            self._hypotheses = Hypotheses(self._metadata.thresholds, NEUTRAL.memories)

    def _undecided(self, estimated: Estimated, problem: Problem) -> Judged:
        self._is_held = True
        return Judged(estimated, None, self._hypotheses.state, self._hypotheses.agree, problem=problem)


def evidence_of(judged: Judged) -> Evidence:
    """Return the evidence of a decided sample."""
    evidence = judged.estimated.evidence
    assert isinstance(evidence, Evidence)  # noqa: S101  # a decided sample has evidence
    return evidence
