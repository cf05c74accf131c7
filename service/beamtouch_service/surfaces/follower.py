"""Decides on the samples that move the answer of a surface. Pure but for the run of the model."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from beamtouch_models.modelfile import LeftOut, ModelFile, State, Suspects, is_overload, is_unchecked
from beamtouch_service.problems import Problem
from beamtouch_service.samples import Note
from beamtouch_service.surfaces.contact import Decision
from beamtouch_service.surfaces.estimates import Ask, Estimated
from beamtouch_service.surfaces.judge import Judge, Judged, evidence_of

_ALL = 40
"""Number of samples at the beginning of a stretch, all of which are examined without each channel: as many as name a
suspect."""
_EVERY = 20
"""Of later ones, one in this many is: it takes long."""


class Seen(NamedTuple):
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
    """Decides on the samples of one sender, in the order of their numbers; some may be missing."""

    def __init__(self, model: ModelFile, ask: Ask, surface: str, hold_ms: float) -> None:
        self._metadata = model.metadata
        self._judge = Judge(model, surface, hold_ms)
        self._suspects = Suspects(model.metadata, ask)
        self._before: int | None = None
        """Number of the last sample."""
        self._decided: Estimated | None = None
        """The last decided sample."""
        self._length = 0
        """Samples of the current unexplained stretch with the same channels."""

    def follow(self, samples: Iterable[Estimated]) -> list[Seen]:
        """Decide on the next samples."""
        judged = [self._next(one) for one in samples]
        # The graph runs once for all samples that need each channel left out.
        asked = [one.estimated for one, number in judged if _is_asked(number)]
        left_out = iter(self._suspects.leave_out([one.weighed.part(np.array([one.row])) for one in asked]))
        return [self._seen(one, number, next(left_out) if _is_asked(number) else None) for one, number in judged]

    def _next(self, estimated: Estimated) -> tuple[Judged, int | None]:
        """Return the next sample with its state, and its place in an unexplained stretch."""
        if self._before is not None and estimated.sequence != self._before + 1:
            self._judge.miss(estimated.acquired_unix_us)
        self._before = estimated.sequence
        judged, last = self._judge.judge(estimated), self._decided
        if judged.state is None:
            return judged, None
        self._decided = estimated
        if judged.state is not State.UNEXPLAINED or (last and last.bad.keys() != estimated.bad.keys()):
            self._length = 0
        if judged.state is not State.UNEXPLAINED:
            return judged, None
        self._length += 1
        return judged, self._length - 1

    def _seen(self, judged: Judged, number: int | None, without: dict[str, LeftOut] | None) -> Seen:
        estimated, state = judged.estimated, judged.state
        if state is None:
            assert judged.problem  # noqa: S101  # there is one for each undecided sample
            return Seen(estimated, judged.problem, judged.held)
        notes: list[str] = [Note.UNSTEADY] if judged.is_unsteady else []
        suspect = None
        if number in {None, 0}:
            self._suspects.clear()
        if state is State.CONTACT:
            notes += self._doubts(judged)
        if without is not None:
            self._suspects.add(without)
        if state is State.UNEXPLAINED:
            suspect = self._suspects.suspect
            notes += [f"check-{suspect}"] if suspect else []
        evidence = evidence_of(judged)
        limits, place = self._metadata.thresholds, evidence.channels - 1
        misfit, limit = min((evidence.rest_misfit, limits.rest[place]), (evidence.misfit, limits.misfit[place]))
        return Seen(estimated, Decision(state, judged.figures, misfit, limit, notes, suspect), judged.held)

    def _doubts(self, judged: Judged) -> list[str]:
        """Return the notes on a contact."""
        evidence = evidence_of(judged)
        notes: list[str] = [Note.OVERLOAD] if is_overload(self._metadata, evidence) else []
        return [*notes, Note.UNCHECKED] if is_unchecked(evidence) else notes


def _is_asked(number: int | None) -> bool:
    """Return whether to examine the sample with this place in a stretch without each channel."""
    return number is not None and (number < _ALL or number % _EVERY == 0)
