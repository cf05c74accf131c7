"""The states that samples show, and what is doubtful about them. Pure but for the run of the model."""

import logging
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from beamtouch_models.runtime import (
    Evidence,
    Hypotheses,
    Memory,
    ModelFile,
    State,
    Suspects,
    Wirings,
    is_odd,
    is_overload,
    is_unchecked,
    memories_after,
)
from beamtouch_service.problems import Problem
from beamtouch_service.samples import Batch, Note, Sample
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.contact import (
    Figures,
    UnusableEstimateError,
    figures_of,
    require_usable,
)
from beamtouch_service.surfaces.estimate import Estimate, Estimator
from beamtouch_service.surfaces.surface_problems import unusable_estimate
from beamtouch_service.surfaces.warmth import Warmth
from beamtouch_service.surfaces.zones import NO_ZONES, ZoneEvidence, ZoneFollower, ZoneReport

_log = logging.getLogger(__name__)
_ALWAYS_EXAMINED = 40
"""Samples at the beginning of an unexplained stretch that are examined without each channel: enough to name a suspect.
"""
_EXAMINED_EVERY = 20
"""After these, one sample in this many is examined: an examination takes long."""
PAUSE = 4.0
"""A device may give no sample for this many times `stale_ms` within one contact: a busy machine pauses, too."""
_HOLD_READINGS = 3
"""Readings for which a state is held at least: those of a slow surface may be far apart."""
_DOUBTS = frozenset({Note.OVERLOAD, Note.UNCHECKED, Note.SENDERS})
"""Notes with which a contact is judged by no zone: it may be another load than one contact, or on another beam."""


class Past(NamedTuple):
    """The memory of the samples so far, for the next one."""

    memories: tuple[Memory, ...]
    """The memories that they may have left; several while the state before the first of them still matters."""
    is_known: bool = False
    """True if a state was known at any time."""
    decided_us: int | None = None
    """Time of the last decided sample [us]; None if it is not known."""
    is_held: bool = False
    """True if the samples after that could not be decided, so that the state is held."""
    zones: Mapping[str, Any] | None = None
    """The memory of the zones."""

    @classmethod
    def read(cls, kept: Mapping[str, Any]) -> "Past":
        """Return a past that was kept as JSON; raises KeyError, TypeError or ValueError for anything else."""
        memories = tuple(_read_memory(values) for values in kept["memories"])
        return cls(memories, kept["is_known"], kept["decided_us"], kept["is_held"], kept["zones"])


def _read_memory(values: list[Any]) -> Memory:
    memory = Memory(*values)
    return memory._replace(state=State(memory.state), seen_mm=memory.seen_mm and tuple(memory.seen_mm))


NEUTRAL = Past(memories_after(None))
"""Nothing is known of the samples before."""


class Decision(NamedTuple):
    """The state that a sample shows."""

    estimate: Estimate
    state: State | None
    """None if it could not be decided."""
    held: State
    """The state, also for undecided samples that follow closely on a decided one."""
    is_certain: bool
    """True if the state does not depend on samples before the first one."""
    is_odd: bool = False
    """True if neither rest nor a single contact explains the sample. The state follows only after several of them."""
    is_unsteady: bool = False
    """True if position and force are less certain than those of a sample at rest."""
    figures: Figures | None = None
    """Of a contact."""
    problem: Problem | None = None
    """Why it could not be decided."""
    suspect: str | None = None
    """In the state `unexplained`, the channel that contradicts the others, as far as the samples so far say."""
    zones: ZoneReport = NO_ZONES
    shift_mm: float | None = None
    """In the state `unexplained`, by how much all zeros have moved together, if that explains the samples so far."""

    @property
    def evidence(self) -> Evidence:
        """The evidence of a decided sample."""
        evidence = self.estimate.evidence
        assert isinstance(evidence, Evidence)  # noqa: S101  # a decided sample has evidence
        return evidence

    def notes(self, model: ModelFile) -> list[str]:
        """Return the notes on a decided sample: values of `Note`, or `check-NAME`."""
        is_contact = self.state is State.CONTACT
        each = {
            Note.UNSTEADY: self.is_unsteady,
            Note.OVERLOAD: is_contact and is_overload(model.metadata, self.evidence),
            Note.UNCHECKED: is_contact and is_unchecked(model.metadata, self.evidence),
            Note.ZEROS: self.shift_mm is not None,
            f"check-{self.suspect}": self.suspect is not None,
        }
        return [str(note) for note, applies in each.items() if applies]

    def misfit(self, model: ModelFile) -> tuple[float, float]:
        """Return the misfit of a decided sample, the smaller of rest and of a contact, with its limit."""
        evidence, limits = self.evidence, model.metadata.thresholds
        place = evidence.channels - 1
        return min((evidence.rest_misfit, limits.rest[place]), (evidence.misfit, limits.misfit[place]))


class Judge:
    """Decides on consecutive samples of one sender.

    Over undecided samples, a state is held for `stale_ms`, or some readings if those take longer; without any sample,
    for `PAUSE` times that. After a longer pause, as of a device that was off, nothing is known. The samples have their
    times by any clock, but by the same for all of them: one that is set in between seems to be a pause.
    """

    def __init__(self, model: ModelFile, surface: str, section: SurfaceSection, past: Past = NEUTRAL) -> None:
        """Begin after samples with that past."""
        self._model, self._surface, self._outline = model, surface, model.metadata.outline
        self._hold_us = max(section.stale_ms * 1e3, _HOLD_READINGS * 1e6 / model.metadata.sensor.rate_hz)
        self._hypotheses = Hypotheses(model.metadata.thresholds, past.memories, is_known=past.is_known)
        self._decided_us, self._is_held = past.decided_us, past.is_held
        self._zones = ZoneFollower(section.zones, self._outline, self._hold_us, past.zones)

    @property
    def past(self) -> Past:
        """The memory of the samples so far, for the next one."""
        state = self._hypotheses
        return Past(state.memories, state.is_known, self._decided_us, self._is_held, self._zones.memory)

    def miss(self) -> None:
        """Note that samples before the next one are missing."""
        self._hypotheses = Hypotheses(self._model.metadata.thresholds, NEUTRAL.memories)
        self._decided_us, self._is_held = None, False
        self._zones.miss()

    def is_over(self, at_us: int) -> bool:
        """Return whether the state is held no longer at the time of the next sample [us]."""
        longest_us = self._hold_us if self._is_held else PAUSE * self._hold_us
        return self._decided_us is not None and abs(at_us - self._decided_us) > longest_us

    def judge(self, estimate: Estimate, at_us: int, sender_notes: Iterable[str] = ()) -> Decision:
        """Decide on the next sample, taken at this time [us], with these notes on its sender."""
        decision = self._decide(estimate, at_us)
        if not self._zones.defined:
            return decision
        return decision._replace(zones=self._follow_zones(decision, at_us, sender_notes))

    def _decide(self, estimate: Estimate, at_us: int) -> Decision:
        metadata, evidence = self._model.metadata, estimate.evidence
        if self.is_over(at_us):
            self._hypotheses = Hypotheses(metadata.thresholds, NEUTRAL.memories)
        if isinstance(evidence, Problem):
            return self._undecided(estimate, evidence)
        figures = None
        try:
            require_usable(evidence)
            verdict = self._hypotheses.step(evidence)
            if verdict.state is State.CONTACT:
                figures = figures_of(evidence.answer, self._outline)
        except UnusableEstimateError as error:
            detail = (
                f"For the newest sample, {error}. Check the characteristics and tare of the sensors, then the model."
            )
            return self._undecided(estimate, unusable_estimate(self._surface, detail))
        self._decided_us, self._is_held = at_us, False
        odd = is_odd(metadata.thresholds, evidence)
        return Decision(estimate, verdict.state, verdict.state, verdict.shown, odd, verdict.unsteady, figures)

    def _undecided(self, estimate: Estimate, problem: Problem) -> Decision:
        self._is_held = True
        return Decision(estimate, None, self._hypotheses.state, self._hypotheses.agree, problem=problem)

    def _follow_zones(self, decision: Decision, at_us: int, sender_notes: Iterable[str]) -> ZoneReport:
        """Return what a sample shows of the zones."""
        if decision.state is State.CLEAR and not decision.is_unsteady:
            return self._zones.step(ZoneEvidence(at_us, is_clear=True))
        figures = decision.figures
        if figures and not decision.is_odd and _DOUBTS.isdisjoint([*sender_notes, *decision.notes(self._model)]):
            return self._zones.step(ZoneEvidence(at_us, place=figures.place, force=figures.force))
        return self._zones.step(ZoneEvidence(at_us))


class Follower:
    """Decides on the samples that move the answer of a surface, under one model."""

    def __init__(
        self,
        model: ModelFile,
        surface: str,
        section: SurfaceSection,
        on_run: Callable[[float], None],
        *,
        examines: bool = True,
    ) -> None:
        """Call `on_run` after each run of the graph on new samples, with the time that it took [s].

        Unless it `examines`, it decides on states alone: no suspects, no shift of the zeros, no wiring.
        """
        self.model = model
        self._examines = examines
        self.estimator = Estimator(model, surface, on_run)
        self._surface, self._section = surface, section
        self._judge = Judge(model, surface, section)
        self._last = "", 0
        """Boot id and number of the last sample."""
        self._suspects = Suspects(model.metadata, model.run)
        self._warmth = Warmth(model.metadata.thresholds)
        self._stretch_of: set[str] | None = None
        """Bad channels of the current unexplained stretch; None without one."""
        self._length = 0
        """Samples of that stretch."""
        self._wirings = Wirings(model.metadata, model.run)
        self._settled: Estimate | None = None
        """The last settled sample of what acts on the beam."""
        self._told: tuple[State | None, str] | None = None
        """State and problem of the last sample, as the debug log has them."""

    @property
    def wiring(self) -> str | None:
        """Cables that seem to be swapped, or a sensor that seems to be inverted, in words; None if there is none."""
        return self._wirings.finding

    def go_on_from(self, other: "Follower") -> None:
        """Go on after the samples of a follower whose model has the same beam and channels.

        The state is that of the beam: a contact that no model would see begin now may still be there.
        """
        self._judge = Judge(self.model, self._surface, self._section, other._judge.past)
        self._last = other._last

    def follow(
        self, batch: Batch, samples: list[Sample], taken_us: Iterable[int], sender_notes: Collection[str]
    ) -> Iterator[Decision]:
        """Decide on samples of a batch, one after another. After a gap, and with another sender, no state is known.

        `taken_us` are the times of the samples [us, monotonic], `sender_notes` what the service notes on their sender.
        """
        moments_us = iter(taken_us)
        for estimate in self.estimator.estimate(batch, samples):
            yield self._follow_one(batch.boot_id, estimate, next(moments_us), sender_notes)

    def _follow_one(self, boot_id: str, estimate: Estimate, taken_us: int, sender_notes: Collection[str]) -> Decision:
        number, (last_boot_id, last_number) = estimate.sample.sequence, self._last
        if (boot_id, number) != (last_boot_id, last_number + 1):
            self._stretch_of = None
            if boot_id == last_boot_id:
                self._judge.miss()
            else:
                self._judge = Judge(self.model, self._surface, self._section)
        self._last = boot_id, number
        decision = self._judge.judge(estimate, taken_us, sender_notes)
        if not self._examines:
            return decision
        if _log.isEnabledFor(logging.DEBUG):
            self._tell_change(decision)
        self._seek_wiring(decision)
        if decision.state is None:
            return decision
        if decision.state is not State.UNEXPLAINED:
            self._stretch_of = None
            return decision
        self._seek_suspect(estimate)
        self._warmth.add(decision.evidence)
        shift_mm = self._warmth.shift_mm
        return decision._replace(suspect=self._suspects.suspect if shift_mm is None else None, shift_mm=shift_mm)

    def _tell_change(self, decision: Decision) -> None:
        """Write to the debug log that the state has changed, and from which figures that follows."""
        told = decision.state, decision.problem.detail if decision.problem else ""
        if told == self._told:
            return
        self._told = told
        words = f"undecided: {told[1]}"
        if decision.state is not None:
            evidence, limits = decision.evidence, self.model.metadata.thresholds
            place = evidence.channels - 1
            words = (
                f"{decision.state}: log odds {evidence.log_odds:.4g}, of a touch {limits.touch[place]:.4g}; misfit of "
                f"one contact {evidence.misfit:.4g} of at most {limits.misfit[place]:.4g}, of rest "
                f"{evidence.rest_misfit:.4g} of at most {limits.rest[place]:.4g}"
            )
        _log.debug("%s: sample %d: %s", self._surface, decision.estimate.sample.sequence, words)

    def _seek_suspect(self, estimate: Estimate) -> None:
        """Examine a sample of an unexplained stretch without each of its channels, unless enough others were."""
        if self._stretch_of != estimate.bad.keys():
            self._stretch_of, self._length = set(estimate.bad), 0
            self._suspects.clear()
            self._warmth.clear()
        if self._length < _ALWAYS_EXAMINED or self._length % _EXAMINED_EVERY == 0:
            (without,) = self._suspects.leave_out(estimate.weighed)
            self._suspects.add(without)
        self._length += 1

    def _seek_wiring(self, decision: Decision) -> None:
        """Look at one sample of each contact, and of each unexplained stretch, once it has been lifted."""
        estimate, evidence = decision.estimate, decision.estimate.evidence
        if decision.state is State.CLEAR:
            if self._settled is not None:
                self._wirings.add(self._settled.weighed)
            self._settled = None
        elif isinstance(evidence, Evidence) and evidence.is_settled and not evidence.moves and not estimate.bad:
            # The state follows a lift only after some samples: those at rest say nothing of the contact.
            at_rest = evidence.rest_misfit <= self.model.metadata.thresholds.rest[-1]
            self._settled = self._settled if at_rest else estimate
