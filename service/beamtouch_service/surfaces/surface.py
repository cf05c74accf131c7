"""The state of one surface: its newest sample, and what its model makes of it.

No I/O and no clock: instants come in as seconds of the service's monotonic clock.
"""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.modelfile import Answers, ModelFile
from beamtouch_service.defaults import STALE_MS
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Batch, Note, Receipt, Sample
from beamtouch_service.surfaces.contact import Contact, ContactQuality, Decision, rfc3339
from beamtouch_service.surfaces.estimates import estimate
from beamtouch_service.surfaces.inference import Inference
from beamtouch_service.surfaces.observer import Witness
from beamtouch_service.surfaces.senders import Senders
from beamtouch_service.surfaces.sequence_log import SequenceLog
from beamtouch_service.surfaces.summary import SampleCounts, SurfaceSummary
from beamtouch_service.surfaces.timings import Timings
from beamtouch_service.surfaces.touch import Follower, Levels, Seen, levels


@dataclass(frozen=True, slots=True)
class Newest:
    """The newest sample and what follows from it."""

    boot_id: str
    channels: list[str]
    """The names of the values in the sample."""
    sample: Sample
    acquired_s: float
    notes: list[Note]
    """What its sender has found of the surface."""
    seen: Seen | None = None
    """None without a model."""
    model: str = ""
    """Identity of the model that answered."""

    def age_ms(self, now_s: float) -> float:
        """Return the age at `now_s` [s, monotonic], rounded."""
        return round((now_s - self.acquired_s) * 1e3, 1)


class Surface:
    """One surface: takes batches, gives the contact."""

    def __init__(self, name: str, model: ModelFile | None = None, stale_ms: float = STALE_MS) -> None:
        self.name = name
        self.model: ModelFile | None = None
        self.model_error: str | None = None
        """Why the newest model file is not used."""
        self.offered: list[str] | None = None
        """The channels of the newest batch, taken or not."""
        self.stale_ms = stale_ms
        self.witness: Witness | None = None
        self._sequences = SequenceLog()
        self._counts = SampleCounts()
        self._present: Newest | None = None
        self._senders = Senders(stale_ms)
        self._levels: tuple[ModelFile, Levels] | None = None
        self._follower: tuple[str, Follower] | None = None
        """For the sender of that boot id."""
        self._told_stale = False
        self.timings = Timings()
        self._inference: Inference | None = None
        if model is not None:
            self.adopt(model)

    @property
    def counts(self) -> SampleCounts:
        """Counts of samples since the start."""
        return self._counts

    def adopt(self, model: ModelFile) -> None:
        """Estimate from the next sample on with this model; the contact so far stays that of the model it is of."""
        inference = Inference(model, self.timings.inference_s)
        self.model, self._inference = model, inference

    def receive(self, batch: Batch, arrival_s: float) -> Receipt:
        """Take a batch that arrived at `arrival_s` [s, monotonic].

        Every sample after the present moves the contact, in order; those that come late never do.

        Raises
        ------
        ProblemError
            Channels of the model are missing, or all of it is late and there is no room; the batch changed nothing.
        """
        self.offered = batch.channels
        self._require_channels(batch.channels)
        self._require_room(batch, arrival_s)
        admission = self._sequences.admit(batch.boot_id, [sample.sequence for sample in batch.samples])
        self._counts.accepted += admission.accepted
        self._counts.repeated += admission.repeated
        self._counts.lost += admission.lost
        if admission.accepted:
            self._take(batch, set(admission.new), arrival_s)
        return Receipt(accepted=admission.accepted, repeated=admission.repeated)

    def contact(self, now_s: float) -> Contact:
        """Return the contact as of `now_s` [s, monotonic].

        Raises
        ------
        ProblemError
            There is none to give: no model, no samples, too old, too few channels, or no usable estimate.
        """
        present, seen, decision = self._require_decision(now_s)
        degraded = list(seen.estimated.bad)
        return Contact(
            surface=self.name,
            state=decision.state,
            **asdict(decision.figures),
            age_ms=present.age_ms(now_s),
            sampled_at=rfc3339(present.sample.acquired_unix_us),
            sequence=present.sample.sequence,
            quality=ContactQuality.DEGRADED if degraded else ContactQuality.GOOD,
            degraded_channels=degraded,
            notes=[note.value for note in present.notes],
            model=present.model,
        )

    def tell_if_stale(self, now_s: float) -> None:
        """Tell the witness, once, that the newest sample is too old at `now_s` [s, monotonic]."""
        if self.witness and self._present and not self._told_stale and self._is_stale(self._present, now_s):
            self._told_stale = True
            self.witness.stale(self)

    @property
    def sender_changes(self) -> int:
        """How often the present went from one sender to another."""
        return self._senders.changes

    @property
    def newest(self) -> Newest | None:
        """The newest sample; None before the first."""
        return self._present

    def unready(self, now_s: float) -> Problem | None:
        """Say why this surface has no contact to give at `now_s` [s, monotonic]; None if it has."""
        try:
            self._require_decision(now_s)
        except ProblemError as error:
            return error.problem
        return None

    def summary(self, now_s: float) -> SurfaceSummary:
        """Return what is known of this surface at `now_s` [s, monotonic]."""
        return SurfaceSummary(
            name=self.name,
            model=self.model.identity if self.model else None,
            channels=self.model.channels if self.model else [],
            stale_ms=self.stale_ms,
            age_ms=self._present.age_ms(now_s) if self._present else None,
            model_error=self.model_error,
            samples=self._counts.model_copy(),
        )

    def _require_channels(self, offered: list[str]) -> None:
        missing = [name for name in self.model.channels if name not in offered] if self.model else []
        if missing:
            detail = f"The batch lacks {', '.join(missing)}; send every channel of the model, a broken one as missing."
            raise ProblemError(Problem(Kind.MISSING_CHANNELS, detail, self.name, {"missing_channels": missing}))

    def _require_room(self, batch: Batch, arrival_s: float) -> None:
        if self.model is None or self.witness is None or self.witness.has_room(len(batch.samples)):
            return
        newest, acquired_s = batch.samples[-1].sequence, arrival_s - batch.newest_age_ms / 1e3
        # One that holds a present sample is taken whole: the present never waits for the past.
        if not self._senders.is_after_present(batch.boot_id, newest, acquired_s, arrival_s):
            detail = "Late samples come faster than they can be recorded; send the batch again."
            raise ProblemError(Problem(Kind.BUSY, detail, self.name), {"Retry-After": "1"})

    def _require_decision(self, now_s: float) -> tuple[Newest, Seen, Decision]:
        present = self._require_fresh(now_s)
        # A model that was given after the newest sample has not seen it.
        if present.seen is None:
            raise ProblemError(self._no_samples())
        if not isinstance(present.seen.outcome, Decision):
            # A new exception each time: one raised again and again would collect its tracebacks.
            raise ProblemError(present.seen.outcome)
        return present, present.seen, present.seen.outcome

    def _require_fresh(self, now_s: float) -> Newest:
        if self.model is None:
            raise ProblemError(self._no_model())
        if self._present is None:
            raise ProblemError(self._no_samples())
        if self._is_stale(self._present, now_s):
            age_ms = self._present.age_ms(now_s)
            detail = (
                f"The newest sample is {age_ms:.1f} ms old, the limit is {self.stale_ms:g} ms; "
                "see whether the daemon runs and reaches the device."
            )
            members = {"age_ms": age_ms, "stale_ms": self.stale_ms}
            raise ProblemError(Problem(Kind.STALE, detail, self.name, members))
        return self._present

    def _is_stale(self, newest: Newest, now_s: float) -> bool:
        # Compared before rounding, so that the limit is exact.
        return (now_s - newest.acquired_s) * 1e3 > self.stale_ms

    def _no_samples(self) -> Problem:
        detail = "No sample has arrived since the service started; start the daemon, or look at what it reports."
        return Problem(Kind.NO_SAMPLES, detail, self.name)

    def _no_model(self) -> Problem:
        detail = "Samples are accepted, but there is no model to estimate from; give one with --model or in the config."
        return Problem(Kind.NO_MODEL, detail, self.name)

    def _take(self, batch: Batch, new: set[int], arrival_s: float) -> None:
        """Take the new samples of a batch: those after the present move it, the others only complete the record."""
        acquired_s = arrival_s - batch.newest_age_ms / 1e3
        samples = [sample for sample in batch.samples if sample.sequence in new]
        # Increasing, and only the number differs between them: those after the present are the last ones.
        fresh = [
            sample
            for sample in samples
            if self._senders.is_after_present(batch.boot_id, sample.sequence, acquired_s, arrival_s)
        ]
        late = samples[: len(samples) - len(fresh)]
        if late and self.model and self.witness:
            self.witness.late(self, self.model, batch, late)
        if fresh:
            self._told_stale = False
            self.timings.arrival_age_s.add(batch.newest_age_ms / 1e3)
            self._senders.move(batch.boot_id, fresh[-1].sequence, acquired_s)
            self._advance(batch, fresh, acquired_s)

    def _advance(self, batch: Batch, fresh: list[Sample], acquired_s: float) -> None:
        model = self.model
        if model is None:
            self._present = Newest(batch.boot_id, batch.channels, fresh[-1], acquired_s, batch.notes)
            return
        follower = self._following(model, batch.boot_id)
        seen = [follower.step(estimated) for estimated in estimate(model, self.name, batch.channels, fresh, self._ask)]
        self._present = Newest(
            batch.boot_id, batch.channels, fresh[-1], acquired_s, batch.notes, seen[-1], model.identity
        )
        if self.witness:
            self.witness.present(self, model, batch.boot_id, seen)

    def _ask(self, deflection_mm: NDArray[np.float32], valid: NDArray[np.bool_]) -> Answers:
        if self._inference is None:
            message = "no model"
            raise AssertionError(message)
        return self._inference.ask(deflection_mm, valid)

    def _following(self, model: ModelFile, boot_id: str) -> Follower:
        if self._levels is None or self._levels[0] is not model:
            self._levels = model, levels(model)
            self._follower = None
        if self._follower is None or self._follower[0] != boot_id:
            self._follower = boot_id, Follower(self._levels[1], self.name, self.stale_ms)
        return self._follower[1]
