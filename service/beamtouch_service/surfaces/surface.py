"""The state of one surface: its newest sample and the contact that its model finds in it.

No I/O and no clock: the caller gives the time, in seconds of the service's monotonic clock.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from beamtouch_models.modelfile import ModelFile, State
from beamtouch_service.limits import DEGRADED_AFTER_S, STALE_MS, UNEXPLAINED_AFTER_S
from beamtouch_service.problems import Kind, Problem, ProblemBody, ProblemError
from beamtouch_service.samples import Batch, Note, Quality, Sample
from beamtouch_service.surfaces import refusals
from beamtouch_service.surfaces.channels_out import ChannelsOut
from beamtouch_service.surfaces.contact import Contact, Decision
from beamtouch_service.surfaces.estimates import Estimated
from beamtouch_service.surfaces.follower import Seen
from beamtouch_service.surfaces.freshness import Transit
from beamtouch_service.surfaces.health import ChannelHealth, SurfaceHealth
from beamtouch_service.surfaces.intake import Intake
from beamtouch_service.surfaces.newest import Decided, Newest
from beamtouch_service.surfaces.senders import Rivals
from beamtouch_service.surfaces.served_model import ServedModel
from beamtouch_service.surfaces.stretches import Stretches
from beamtouch_service.surfaces.summary import SampleCounts, SurfaceSummary
from beamtouch_service.surfaces.timings import Timings

SENDER_GONE_S = 10.0
"""A daemon whose samples are refused tries again sooner than this; after it, samples are what is missing."""


class Received(NamedTuple):
    """What became of a batch."""

    accepted: int
    """Samples that were new."""
    repeated: int
    weighed: dict[int, Estimated]
    """Those that moved the answer, by number."""


class Surface:
    """One surface: takes batches, gives the contact."""

    def __init__(
        self,
        name: str,
        model: ModelFile | None = None,
        stale_ms: float = STALE_MS,
        unexplained_after_s: float = UNEXPLAINED_AFTER_S,
        degraded_after_s: float = DEGRADED_AFTER_S,
    ) -> None:
        self.name = name
        self.model_error: str | None = None
        """Reason not to use the newest model file."""
        self.offered: list[str] | None = None
        """Channels of the newest batch, accepted or not."""
        self.sender_beam: str | None = None
        """Identity of the beam that the newest samples state, accepted or not; None if they state none."""
        self._sender_s = -math.inf
        """When they came."""
        self.stale_ms = stale_ms
        self.stretches = Stretches(unexplained_after_s)
        """The unexplained stretches in the samples that moved the answer."""
        self.channels_out = ChannelsOut(degraded_after_s, stale_ms / 1e3)
        """The channels that were not good for too long in these samples."""
        self.rivals = Rivals(stale_ms)
        """Notices that two daemons send samples."""
        self.newest: Newest | None = None
        """The newest sample; None before the first."""
        self._intake = Intake(stale_ms)
        self._served = ServedModel(model) if model else None
        self.transit = Transit()
        """Tells when a batch arrived."""
        self.timings = Timings()
        self.on_fresh: Callable[[Surface], None] = lambda _surface: None
        """Called after each batch that moved the answer."""
        self.health: SurfaceHealth | None = None
        """Health of the sensors, as the recorder finds it in the events so far."""

    @property
    def model(self) -> ModelFile | None:
        """The model in use."""
        return self._served.file if self._served else None

    @property
    def wiring(self) -> str | None:
        """Cables that seem to be swapped, or a sensor that seems to be inverted, in words; None if there is none."""
        return self._served.wiring if self._served else None

    @property
    def counts(self) -> SampleCounts:
        """Counts of samples since the start."""
        return self._intake.counts

    def adopt(self, model: ModelFile) -> None:
        """Use this model from the next sample on. The contact so far stays with the model that gave it."""
        self._served = ServedModel(model)
        self.channels_out.forget()

    def receive(self, batch: Batch, arrival_s: float, address: str = "unknown") -> Received:
        """Take a batch that arrived at `arrival_s` [s, monotonic] from this address.

        Every sample after the newest one moves the contact, in order. Others never do, nor does a backlog.

        Raises
        ------
        ProblemError
            The model is of another beam, or channels of it are missing. The batch changed nothing.
        """
        if not batch.backlog:
            self.offered = batch.channels
        # Samples of a former beam say nothing about the beam that is there.
        if self._intake.moves_answer(batch, arrival_s):
            self.sender_beam, self._sender_s = batch.beam, arrival_s
        self._require_beam(batch.beam)
        self._require_channels(batch.channels)
        taken = self._intake.take(batch, arrival_s)
        if batch.samples and not batch.backlog:
            self.rivals.hear(batch.boot_id, address, taken.acquired_s)
        seen = list[Seen]()
        if taken.fresh:
            self.timings.arrival_age_s.observe((batch.newest_age_ms or 0.0) / 1e3)
            seen = self._advance(batch, taken.fresh, taken.acquired_s)
            self.on_fresh(self)
        weighed = {one.estimated.sequence: one.estimated for one in seen}
        return Received(taken.accepted, taken.repeated, weighed)

    def contact(self, now_s: float) -> Contact:
        """Return the contact as of `now_s` [s, monotonic].

        Raises
        ------
        ProblemError
            There is none: no model, no samples, a stale sample, too few channels, or no usable estimate.
        """
        found = self._decided(now_s)
        if isinstance(found, Problem):
            # A new exception each time: one that is raised again collects tracebacks.
            raise ProblemError(found)
        return found.contact(self.name, now_s)

    @property
    def sender_changes(self) -> int:
        """Number of changes of the sender of the newest sample."""
        return self._intake.senders.changes

    def is_stale(self, now_s: float) -> bool:
        """Return whether the newest sample is too old at `now_s` [s, monotonic]; False before the first."""
        # Compared before rounding, so that the limit is exact.
        return self.newest is not None and (now_s - self.newest.acquired_s) * 1e3 > self.stale_ms

    def unready(self, now_s: float, *, healthy: bool = False) -> Problem | None:
        """Return why this surface has no contact at `now_s` [s, monotonic], or None if it has one.

        If `healthy`, a channel that is out, or has changed for certain, is a reason, too.
        """
        found = self._decided(now_s)
        if isinstance(found, Problem):
            return found
        if healthy and self.channels_out.any:
            return refusals.channels_out(self.name, self.channels_out.now)
        changed = [name for name, one in (self._channel_health() or {}).items() if one.changed] if healthy else []
        return refusals.changed_channels(self.name, changed) if changed else None

    def standing(self, now_s: float) -> State | Kind:
        """Return the state at `now_s` [s, monotonic], or the kind of the problem that prevents a contact."""
        found = self._decided(now_s)
        return found.kind if isinstance(found, Problem) else found.decision.state

    def misfit_limit(self, now_s: float) -> float | None:
        """Return the scale of the misfit of the contact at `now_s` [s, monotonic]; None without a contact."""
        found = self._decided(now_s)
        return None if isinstance(found, Problem) else round(found.decision.misfit_limit, 2)

    def summary(self, now_s: float) -> SurfaceSummary:
        """Return the summary of this surface at `now_s` [s, monotonic]."""
        newest, found = self.newest, self._decided(now_s)
        problem = found if isinstance(found, Problem) else None
        decided = None if isinstance(found, Problem) else found
        return SurfaceSummary(
            name=self.name,
            model=self.model.identity if self.model else None,
            beam=self.model.metadata.beam if self.model else None,
            channels=self.model.channels if self.model else [],
            stale_ms=self.stale_ms,
            age_ms=newest.age_ms(now_s) if newest else None,
            state=decided.decision.state if decided else None,
            problem=problem and ProblemBody.model_validate(problem.body()),
            notes=decided.all_notes if decided else [],
            misfit=round(decided.decision.misfit, 2) if decided else None,
            misfit_limit=self.misfit_limit(now_s),
            channels_out=self.channels_out.now,
            model_error=self.model_error,
            wiring=self.wiring,
            samples=self.counts.model_copy(),
            health=self._channel_health(),
        )

    @property
    def qualities(self) -> dict[str, Quality]:
        """The channels of the model, or without one of the sender, with their quality in the newest sample."""
        newest = self.newest
        if newest is None:
            return {}
        sent = dict(zip(newest.channels, newest.sample.quality, strict=True))
        names = self.model.channels if self.model else newest.channels
        bad = newest.seen.estimated.bad if newest.seen else {}
        return {name: bad.get(name) or sent.get(name, Quality.MISSING) for name in names}

    def _channel_health(self) -> dict[str, ChannelHealth] | None:
        found = self.health
        return found.channels if found and self.model and found.model == self.model.identity else None

    def _require_beam(self, stated: str | None) -> None:
        problem = self._other_beam(stated)
        if problem:
            raise ProblemError(problem)

    def _other_beam(self, stated: str | None) -> Problem | None:
        """Return the problem of samples that state a beam, if it is another one than that of the model."""
        if self.model is None or stated in {None, self.model.metadata.beam}:
            return None
        return refusals.other_beam(self.name, self.model.metadata, stated)

    def _require_channels(self, offered: list[str]) -> None:
        missing = [name for name in self.model.channels if name not in offered] if self.model else []
        if missing:
            raise ProblemError(refusals.missing_channels(self.name, missing))

    def _decided(self, now_s: float) -> Decided | Problem:
        """Return the newest sample with its decision at `now_s` [s, monotonic], or why there is none."""
        if self.model is None:
            return refusals.no_model(self.name, self.model_error)
        newest = self.newest
        other_beam = self._other_beam(self.sender_beam) if now_s - self._sender_s <= SENDER_GONE_S else None
        if other_beam and (newest is None or self.is_stale(now_s)):
            return other_beam
        if newest is None:
            return refusals.no_samples(self.name)
        if self.is_stale(now_s):
            return refusals.stale(self.name, newest.age_ms(now_s), self.stale_ms)
        # A model that came after the newest sample has not seen it.
        if newest.seen is None:
            return refusals.no_samples(self.name)
        outcome = newest.seen.outcome
        return Decided(newest, newest.seen, outcome) if isinstance(outcome, Decision) else outcome

    def _advance(self, batch: Batch, fresh: list[Sample], acquired_s: float) -> list[Seen]:
        served = self._served
        if served is None:
            self.channels_out.add([(one.acquired_unix_us, _bad(batch.channels, one)) for one in fresh], acquired_s)
            self.newest = Newest(batch.boot_id, batch.channels, fresh[-1], acquired_s, list(batch.notes))
            return []
        model, boot_id, arrangement = served.file, batch.boot_id, served.arrangement(batch)
        seen = served.follow(self.name, self.stale_ms, batch, fresh, self.timings)
        self.stretches.add(seen, acquired_s)
        self.channels_out.add([(one.estimated.acquired_unix_us, one.estimated.bad) for one in seen], acquired_s)
        notes: list[str] = [*batch.notes]
        for note, applies in (
            (Note.NOISE, arrangement.contradicts),
            (Note.DEGRADED, self.channels_out.any),
            (Note.SENDERS, self.rivals.at(acquired_s) is not None),
        ):
            notes += [note] if applies else []
        self.newest = Newest(boot_id, batch.channels, fresh[-1], acquired_s, notes, seen[-1], model.identity)
        return seen


def _bad(channels: list[str], sample: Sample) -> dict[str, Quality]:
    """Return the channels of a sample that are not good."""
    each = zip(channels, sample.quality, strict=True)
    return {name: quality for name, quality in each if quality is not Quality.GOOD}
