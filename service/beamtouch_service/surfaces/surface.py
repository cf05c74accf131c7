"""One surface: its newest sample, and the contact that its model finds in it.

No I/O and no clock: the caller gives the time, in seconds of the service's monotonic clock.
"""

import math
from asyncio import Lock
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from beamtouch_models.runtime import ModelFile, State
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Batch, Note, Quality, Sample
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces import problems
from beamtouch_service.surfaces.channels import ChannelHealth, ChannelsOut, SurfaceHealth
from beamtouch_service.surfaces.contact import Contact, ContactQuality, rfc3339
from beamtouch_service.surfaces.estimate import Estimate
from beamtouch_service.surfaces.follower import Decision, Follower
from beamtouch_service.surfaces.freshness import Moment, SampleClock, Transit
from beamtouch_service.surfaces.listeners import Listeners
from beamtouch_service.surfaces.order import DuplicateSenders, Order, SampleCounts
from beamtouch_service.surfaces.unexplained import UnexplainedTracker

_DEFAULTS = SurfaceSection()
SENDER_GONE_S = 10.0
"""A daemon whose samples are refused tries again sooner than this; after that, the problem is missing samples."""


@dataclass(slots=True)
class Received:
    """The outcome of a batch."""

    accepted: int
    """Samples that were new."""
    repeated: int
    decisions: list[Decision] = field(default_factory=list)
    """On those that moved the answer so far, in order."""
    model: ModelFile | None = None
    """The model of the last of them."""
    steps: Iterator[None] = field(default_factory=lambda: iter(()))
    """Moves the answer by one sample after another; the caller holds the lock of the surface until that is done."""

    def weighed(self, model: ModelFile | None) -> dict[int, Estimate]:
        """Return the samples that moved the answer under a model, by number."""
        if model is None or model is not self.model:
            return {}
        return {one.estimate.sample.sequence: one.estimate for one in self.decisions}


@dataclass(frozen=True, slots=True)
class Newest:
    """The newest sample and the decision on it."""

    boot_id: str
    channels: list[str]
    """The names of the values in the sample."""
    sample: Sample
    acquired_s: float
    sender_notes: list[str]
    """Notes on the sender: its own, and what the service says of it."""
    decided: tuple[ModelFile, Decision] | None = None
    """None without a model."""

    def age_ms(self, now_s: float) -> float:
        """Return the age at `now_s` [s, monotonic], rounded."""
        return round((now_s - self.acquired_s) * 1e3, 1)

    @property
    def bad(self) -> Mapping[str, Quality]:
        """Channels of the model that took no part."""
        return self.decided[1].estimate.bad if self.decided else {}


class Answer(NamedTuple):
    """The newest sample with a decision that stands."""

    newest: Newest
    model: ModelFile
    decision: Decision

    @property
    def state(self) -> State:
        """The state."""
        return self.decision.held

    @property
    def notes(self) -> list[str]:
        """Notes on the sender and on the sample."""
        return [*self.newest.sender_notes, *self.decision.notes(self.model)]

    @property
    def misfit(self) -> tuple[float, float]:
        """The misfit and its limit, rounded."""
        misfit, limit = self.decision.misfit(self.model)
        return round(misfit, 2), round(limit, 2)


class Surface:
    """One surface: takes batches, gives the contact."""

    def __init__(self, name: str, model: ModelFile | None = None, section: SurfaceSection = _DEFAULTS) -> None:
        self.name, self.section = name, section
        self.stale_ms = section.stale_ms
        self.model_error: str | None = None
        """Reason not to use the newest model file."""
        self.offered: list[str] | None = None
        """Channels of the newest batch, accepted or not."""
        self.sender_beam: str | None = None
        """Identity of the beam that the newest samples state, accepted or not; None if they state none."""
        self._sender_s = -math.inf
        """When they came."""
        self.newest: Newest | None = None
        """The newest sample; None before the first."""
        self.lock = Lock()
        """Held while a batch moves the answer: others wait for its last step."""
        self.transit = Transit()
        """Tells when a batch arrived."""
        self._order = Order(self.stale_ms)
        self._clock = SampleClock(self.stale_ms / 1e3)
        self.duplicate_senders = DuplicateSenders(self.stale_ms)
        """Notices that two daemons send samples."""
        self.unexplained = UnexplainedTracker(section.unexplained_after_s)
        """The unexplained stretches in the samples that moved the answer."""
        self.channels_out = ChannelsOut(section.degraded_after_s)
        """The channels that were not good for too long in these samples."""
        self.zone_entries = dict.fromkeys(section.zones, 0)
        """Zone -> times that a contact came to be inside it since the start."""
        self.health: SurfaceHealth | None = None
        """Health of the sensors, as the recorder finds it in the events so far."""
        self.moves = Listeners[Surface]()
        """Told after each batch that moved the answer."""
        self.runs = Listeners[float]()
        """Told the time of each run of the graph [s]."""
        self.arrivals = Listeners[float]()
        """Told the age of the newest sample of each batch that moves the answer, at its arrival [s]."""
        self._follower = self._follow(model) if model else None

    def _follow(self, model: ModelFile) -> Follower:
        return Follower(model, self.name, self.section, self.runs.tell)

    @property
    def model(self) -> ModelFile | None:
        """The model in use."""
        return self._follower.model if self._follower else None

    @property
    def wiring(self) -> str | None:
        """Cables that seem to be swapped, or a sensor that seems to be inverted, in words; None if there is none."""
        return self._follower.wiring if self._follower else None

    @property
    def counts(self) -> SampleCounts:
        """Counts of samples since the start."""
        return self._order.counts

    @property
    def sender_changes(self) -> int:
        """Number of changes of the sender of the newest sample."""
        return self._order.senders.changes

    def adopt(self, model: ModelFile) -> None:
        """Use this model from the next sample on. The contact so far stays with the model that gave it."""
        self._follower = self._follow(model)
        self.channels_out.forget()

    def receive(self, batch: Batch, arrival_s: float, address: str = "unknown") -> Received:
        """Take a batch as `begin` does, with all steps at once."""
        received = self.begin(batch, arrival_s, address)
        for _ in received.steps:
            pass
        return received

    def begin(self, batch: Batch, arrival_s: float, address: str = "unknown") -> Received:
        """Take a batch that arrived at `arrival_s` [s, monotonic] from this address; its steps move the answer.

        Every sample after the newest one moves the contact, in order. Others never do, nor does a backlog.

        Raises
        ------
        ProblemError
            The model is of another beam, or channels of it are missing. The batch changed nothing.
        """
        if not batch.backlog:
            self.offered = batch.channels
        # Samples of a former beam say nothing about the beam that is there.
        if self._order.moves_answer(batch, arrival_s):
            self.sender_beam, self._sender_s = batch.beam, arrival_s
        self._require_fit(batch)
        taken = self._order.take(batch, arrival_s)
        if batch.samples and not batch.backlog:
            self.duplicate_senders.note(batch.boot_id, address, taken.acquired_s)
        received = Received(taken.accepted, taken.repeated)
        if taken.fresh:
            self.arrivals.tell((batch.newest_age_ms or 0.0) / 1e3)
            received.steps = self._advance(batch, taken.fresh, taken.acquired_s, received)
        return received

    def _require_fit(self, batch: Batch) -> None:
        """Raise ProblemError unless a batch is of the beam and has the channels of the model."""
        if problem := self._other_beam(batch.beam):
            raise ProblemError(problem)
        missing = [name for name in self.model.channels if name not in batch.channels] if self.model else []
        if missing:
            raise ProblemError(problems.missing_channels(self.name, missing))

    def _advance(self, batch: Batch, fresh: list[Sample], acquired_s: float, received: Received) -> Iterator[None]:
        """Move the contact to new samples, one after another."""
        follower, moments = self._follower, self._clock.tell(fresh, acquired_s)
        sender_notes = [Note.SENDERS] if self.duplicate_senders.at(acquired_s) else []
        notes: list[str] = list(batch.notes)
        decided = None
        if follower is None:
            for sample, moment in zip(fresh, moments, strict=True):
                self.channels_out.add(sample.acquired_unix_us, _bad(batch.channels, sample), moment.passed_s)
                yield
        else:
            received.model = follower.model
            taken_us = [round(moment.taken_s * 1e6) for moment in moments]
            decisions = follower.follow(batch, fresh, taken_us, sender_notes)
            for decision, moment in zip(decisions, moments, strict=True):
                self._note_decision(decision, moment)
                received.decisions.append(decision)
                decided = follower.model, decision
                yield
            notes += [Note.NOISE] if follower.estimator.contradicts else []
            notes += [Note.DEGRADED] if self.channels_out.any else []
            notes += sender_notes
        self.newest = Newest(batch.boot_id, batch.channels, fresh[-1], acquired_s, notes, decided)
        self.moves.tell(self)

    def _note_decision(self, decision: Decision, moment: Moment) -> None:
        self.channels_out.add(decision.estimate.sample.acquired_unix_us, decision.estimate.bad, moment.passed_s)
        self.unexplained.add(decision, moment.passed_s)
        for zone in decision.zones.entered:
            self.zone_entries[zone] += 1

    def answer(self, now_s: float) -> Answer | Problem:
        """Return the newest sample with its decision at `now_s` [s, monotonic], or why there is none."""
        if self.model is None:
            return problems.no_model(self.name, self.model_error)
        newest = self.newest
        other_beam = self._other_beam(self.sender_beam) if now_s - self._sender_s <= SENDER_GONE_S else None
        if other_beam and (newest is None or self.is_stale(now_s)):
            return other_beam
        if newest is None:
            return problems.no_samples(self.name)
        if self.is_stale(now_s):
            return problems.stale(self.name, newest.age_ms(now_s), self.stale_ms)
        # A model that came after the newest sample has not seen it.
        if newest.decided is None:
            return problems.no_samples(self.name)
        model, decision = newest.decided
        return decision.problem or Answer(newest, model, decision)

    def contact(self, now_s: float) -> Contact:
        """Return the contact as of `now_s` [s, monotonic].

        Raises
        ------
        ProblemError
            There is none: no model, no samples, a stale sample, too few channels, or no usable estimate.
        """
        answer = self.answer(now_s)
        if isinstance(answer, Problem):
            # A new exception each time: one that is raised again collects tracebacks.
            raise ProblemError(answer)
        newest, decision, degraded = answer.newest, answer.decision, list(answer.newest.bad)
        return Contact(
            surface=self.name,
            state=answer.state,
            **decision.figures._asdict(),
            age_ms=newest.age_ms(now_s),
            sampled_at=rfc3339(newest.sample.acquired_unix_us),
            sequence=newest.sample.sequence,
            readings=newest.sample.readings,
            misfit=answer.misfit[0],
            quality=ContactQuality.DEGRADED if degraded else ContactQuality.GOOD,
            degraded_channels=degraded,
            notes=answer.notes,
            model=answer.model.identity,
            zones=decision.zones.answers,
        )

    def standing(self, now_s: float) -> State | Kind:
        """Return the state at `now_s` [s, monotonic], or the kind of the problem that prevents a contact."""
        answer = self.answer(now_s)
        return answer.kind if isinstance(answer, Problem) else answer.state

    def is_stale(self, now_s: float) -> bool:
        """Return whether the newest sample is too old at `now_s` [s, monotonic]; False before the first."""
        # Compared before rounding, so that the limit is exact.
        return self.newest is not None and (now_s - self.newest.acquired_s) * 1e3 > self.stale_ms

    def unready(self, now_s: float, *, healthy: bool = False) -> Problem | None:
        """Return why this surface has no contact at `now_s` [s, monotonic], or None if it has one.

        If `healthy`, whatever a technician must come for is a reason, too: a channel that is out or has changed for
        certain, zeros that have moved, and a long unexplained stretch.
        """
        answer = self.answer(now_s)
        if isinstance(answer, Problem):
            return answer
        if healthy and self.channels_out.any:
            return problems.channels_out(self.name, self.channels_out.now)
        if healthy and Note.ZEROS in answer.notes:
            return problems.zeros_moved(self.name)
        if healthy and self.unexplained.is_overdue:
            return problems.unexplained(self.name, self.unexplained.after_s, answer.decision.suspect)
        changed = [name for name, one in (self.channel_health or {}).items() if one.changed] if healthy else []
        return problems.changed_channels(self.name, changed) if changed else None

    @property
    def channel_health(self) -> dict[str, ChannelHealth] | None:
        """Channel -> how it has changed; None if nothing can be said with the model in use."""
        health = self.health
        return health.channels if health and self.model and health.model == self.model.identity else None

    @property
    def qualities(self) -> dict[str, Quality]:
        """The channels of the model, or without one of the sender, with their quality in the newest sample."""
        newest = self.newest
        if newest is None:
            return {}
        sent = dict(zip(newest.channels, newest.sample.quality, strict=True))
        names = self.model.channels if self.model else newest.channels
        return {name: newest.bad.get(name) or sent.get(name, Quality.MISSING) for name in names}

    def _other_beam(self, stated: str | None) -> Problem | None:
        """Return the problem of samples that state a beam, if it is another one than that of the model."""
        if self.model is None or stated in {None, self.model.metadata.beam}:
            return None
        return problems.other_beam(self.name, self.model.metadata, stated)


def _bad(channels: list[str], sample: Sample) -> dict[str, Quality]:
    """Return the channels of a sample that are not good."""
    each = zip(channels, sample.quality, strict=True)
    return {name: quality for name, quality in each if quality is not Quality.GOOD}
