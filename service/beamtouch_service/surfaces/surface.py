"""One surface: takes batches, and gives a view of what their newest sample shows.

No I/O and no clock: the caller gives the time, in seconds of the service's monotonic clock.
"""

import math
from asyncio import Lock
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from beamtouch_common.outline import BEAM_AXES, kind_of
from beamtouch_models.runtime import ModelFile
from beamtouch_service.problems import Problem, ProblemError
from beamtouch_service.samples import Batch, Note, Quality, Sample
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces import surface_problems
from beamtouch_service.surfaces.channels import ChannelHealth, ChannelsOut, SurfaceHealth
from beamtouch_service.surfaces.contact import rfc3339
from beamtouch_service.surfaces.estimate import Estimate
from beamtouch_service.surfaces.follower import Decision, Follower
from beamtouch_service.surfaces.freshness import Moment, SampleClock, Transit
from beamtouch_service.surfaces.listeners import Listeners
from beamtouch_service.surfaces.order import DuplicateSenders, Order, SampleCounts
from beamtouch_service.surfaces.shadow import Shadow
from beamtouch_service.surfaces.unexplained import UnexplainedTracker
from beamtouch_service.surfaces.view import Newest, Totals, View

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


class Surface:
    """One surface: takes batches, gives views."""

    def __init__(self, name: str, model: ModelFile | None = None, section: SurfaceSection = _DEFAULTS) -> None:
        self.name, self.section = name, section
        self.stale_ms = section.stale_ms
        self.model_error: str | None = None
        """Reason not to use the newest model file."""
        self.shadow: Shadow | None = None
        """The candidate that runs beside the model; None without one."""
        self.candidate_error: str | None = None
        """Reason not to run the candidate beside the model."""
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
        self.zone_entries: Mapping[str, int] = dict.fromkeys(section.zones, 0)
        """Zone -> times that a contact came to be inside it since the start."""
        self._totals = Totals(self.zone_entries, {}, self.unexplained.now)
        """What these three say at the newest sample. Within a batch they are ahead of it."""
        self.health: SurfaceHealth | None = None
        """Health of the sensors, as the recorder finds it in the events so far."""
        self.moves = Listeners[Surface]()
        """Told after each batch that moved the answer."""
        self.runs = Listeners[float]()
        """Told the time of each run of the graph [s]."""
        self.arrivals = Listeners[float]()
        """Told the age of the newest sample of each batch that moves the answer, at its arrival [s]."""
        self._follower = self._follow(model) if model else None
        self._former: Follower | None = None
        """The follower of the model before, until the one in use goes on from it."""

    def _follow(self, model: ModelFile) -> Follower:
        return Follower(model, self.name, self.section, self.runs.tell)

    @property
    def model(self) -> ModelFile | None:
        """The model in use."""
        return self._follower.model if self._follower else None

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes of the model in use; without one, those of a beam."""
        return tuple(self.model.metadata.axes) if self.model else BEAM_AXES

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
        """Use this model from the next batch on. The contact so far stays with the model that gave it.

        A model of the same beam and channels goes on from the state that the one before it leaves.
        """
        former, self._former, self.shadow = self._former or self._follower, None, None
        self._follower = self._follow(model)
        if former and (former.model.metadata.beam, former.model.channels) == (model.metadata.beam, model.channels):
            self._former = former  # a batch may still be moving it
            return
        self.channels_out.forget()
        self._totals = self._totals._replace(channels_out={})

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
            raise ProblemError(surface_problems.missing_channels(self.name, missing))

    def _advance(self, batch: Batch, fresh: list[Sample], acquired_s: float, received: Received) -> Iterator[None]:
        """Move the contact to new samples, one after another."""
        follower, moments = self._follower, self._clock.tell(fresh, acquired_s)
        sender_notes = [Note.SENDERS] if self.duplicate_senders.at(acquired_s) else []
        notes: list[str] = list(batch.notes)
        decided, shadow = None, self.shadow
        if follower is None:
            for sample, moment in zip(fresh, moments, strict=True):
                self.channels_out.add(sample.acquired_unix_us, _bad(batch.channels, sample), moment.passed_s)
                yield
        else:
            received.model = follower.model
            if self._former:
                follower.go_on_from(self._former)
                self._former = None
            if shadow:
                shadow.begin(follower)
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
        # Together: the loop turns between two steps, and a view shows one sample.
        self._totals = Totals(self.zone_entries, self.channels_out.now, self.unexplained.now)
        self.newest = Newest(batch.boot_id, batch.channels, fresh[-1], acquired_s, notes, decided)
        self.moves.tell(self)
        if shadow:
            yield from shadow.follow(batch, fresh, moments, sender_notes, received.decisions)

    def _note_decision(self, decision: Decision, moment: Moment) -> None:
        self.channels_out.add(decision.estimate.sample.acquired_unix_us, decision.estimate.bad, moment.passed_s)
        self.unexplained.add(decision, moment.passed_s)
        for zone in decision.zones.entered:
            # Replaced as a whole, because views have it.
            self.zone_entries = {**self.zone_entries, zone: self.zone_entries[zone] + 1}

    def view(self, now_s: float) -> View:
        """Return this surface as of `now_s` [s, monotonic]."""
        newest, model = self.newest, self.model
        # Compared before rounding, so that the limit is exact.
        is_current = newest is not None and (now_s - newest.acquired_s) * 1e3 <= self.stale_ms
        problem = self._find_problem(model, newest, now_s, is_current=is_current)
        decided = newest.decided if newest and problem is None else None
        by, decision = decided or (None, None)
        return View(self.name, now_s, model, newest, is_current, problem, by, decision, self._totals)

    def _find_problem(
        self, model: ModelFile | None, newest: Newest | None, now_s: float, *, is_current: bool
    ) -> Problem | None:
        """Return the problem that prevents a contact at `now_s` [s, monotonic]; None if there is none."""
        if model is None:
            return surface_problems.no_model(self.name, self.model_error)
        other_beam = self._other_beam(self.sender_beam) if now_s - self._sender_s <= SENDER_GONE_S else None
        if other_beam and not is_current:
            return other_beam
        if newest is None:
            return surface_problems.no_samples(self.name)
        if not is_current:
            since = rfc3339(newest.sample.acquired_unix_us)
            return surface_problems.stale(self.name, newest.age_ms(now_s), self.stale_ms, since)
        # A model that came after the newest sample has not seen it.
        return newest.decided[1].problem if newest.decided else surface_problems.no_samples(self.name)

    def find_fault(self, now_s: float) -> Problem | None:
        """Return the first reason for which a technician must come at `now_s` [s, monotonic]; None without one.

        It is the problem that prevents a contact, a channel that is out or has changed for certain, zeros that have
        moved, or a long unexplained stretch.
        """
        view = self.view(now_s)
        if view.decision is None:
            return view.problem
        if view.totals.channels_out:
            return surface_problems.channels_out(self.name, view.totals.channels_out)
        if Note.ZEROS in view.notes:
            return surface_problems.zeros_moved(self.name)
        if view.totals.unexplained.is_overdue:
            since_us, after_s = view.totals.unexplained.since_us, self.unexplained.after_s
            suspect = view.decision.suspect
            return surface_problems.unexplained(self.name, kind_of(self.axes), after_s, since_us, suspect)
        changed = {name: one for name, one in (self.channel_health or {}).items() if one.changed}
        return surface_problems.changed_channels(self.name, changed) if changed else None

    @property
    def channel_health(self) -> dict[str, ChannelHealth] | None:
        """Channel -> how it has changed; None if nothing can be said with the model in use."""
        health = self.health
        return health.channels if health and self.model and health.model == self.model.identity else None

    def _other_beam(self, stated: str | None) -> Problem | None:
        """Return the problem of samples that state a beam, if it is another one than that of the model."""
        if self.model is None or stated in {None, self.model.metadata.beam}:
            return None
        return surface_problems.other_beam(self.name, self.model.metadata, stated)


def _bad(channels: list[str], sample: Sample) -> dict[str, Quality]:
    """Return the channels of a sample that are not good."""
    each = zip(channels, sample.quality, strict=True)
    return {name: quality for name, quality in each if quality is not Quality.GOOD}
