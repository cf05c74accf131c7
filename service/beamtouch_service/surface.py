"""The state of one surface: its newest sample, and what its model makes of it.

No I/O and no clock: instants come in as seconds of the service's monotonic clock.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel

from beamtouch_models.modelfile import ModelFile
from beamtouch_service.contact import Contact, ContactQuality, Decision, UnusableEstimateError, decide, rfc3339
from beamtouch_service.inference import Durations, Inference
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Batch, Quality, Receipt, Sample
from beamtouch_service.sequences import SequenceLog

DEFAULT_STALE_MS = 500.0
_FLOAT32_MAX = float(np.finfo(np.float32).max)


class SampleCounts(BaseModel):
    """Counts of samples since the service started."""

    accepted: int = 0
    repeated: int = 0
    """Received before; they changed nothing."""
    lost: int = 0
    """Gaps in the sequence numbers."""


class SurfaceSummary(BaseModel):
    """What the service knows of one surface."""

    name: str
    model: str | None
    """Name and fingerprint of the model; null without one."""
    channels: list[str]
    """The channels that a batch must contain, in the order of the model; empty without one."""
    stale_ms: float
    """No contact is served from a sample older than this."""
    age_ms: float | None
    """Age of the newest sample; null before the first."""
    model_error: str | None
    """Why the newest model file is not used; null if it is."""
    samples: SampleCounts


@dataclass(frozen=True)
class _Present:
    """The newest sample and what follows from it."""

    sample: Sample
    acquired_s: float
    degraded: list[str]
    outcome: Decision | Problem | None
    """None without a model."""
    model: ModelFile | None
    """The one that the outcome is of, whichever is asked next."""

    def age_ms(self, now_s: float) -> float:
        return round((now_s - self.acquired_s) * 1e3, 1)


class Surface:
    """One surface: takes batches, gives the contact."""

    def __init__(self, name: str, model: ModelFile | None = None, stale_ms: float = DEFAULT_STALE_MS) -> None:
        self.name = name
        self.model: ModelFile | None = None
        self.model_error: str | None = None
        """Why the newest model file is not used."""
        self.offered: list[str] | None = None
        """The channels of the newest batch, taken or not."""
        self.stale_ms = stale_ms
        self.inference_s = Durations()
        self._sequences = SequenceLog()
        self._counts = SampleCounts()
        self._present: _Present | None = None
        self._inference: Inference | None = None
        if model is not None:
            self.adopt(model)

    @property
    def basis(self) -> _Present | None:
        """What the contact follows from; it is the same as long as this is the same object."""
        return self._present

    @property
    def counts(self) -> SampleCounts:
        """Counts of samples since the start."""
        return self._counts

    def adopt(self, model: ModelFile) -> None:
        """Estimate from the next sample on with this model; the contact so far stays that of the model it is of."""
        inference = Inference(model, self.inference_s)
        self.model, self._inference = model, inference

    def receive(self, batch: Batch, arrival_s: float) -> Receipt:
        """Take a batch that arrived at `arrival_s` [s, monotonic].

        Only its last sample is estimated: the contact is about the present.

        Raises
        ------
        ProblemError
            Channels of the model are missing; the batch changed nothing.
        """
        self.offered = batch.channels
        self._require_channels(batch.channels)
        admission = self._sequences.admit(batch.boot_id, [sample.sequence for sample in batch.samples])
        self._counts.accepted += admission.accepted
        self._counts.repeated += admission.repeated
        self._counts.lost += admission.lost
        if admission.accepted:
            self._advance(batch, arrival_s - batch.newest_age_ms / 1e3)
        return Receipt(accepted=admission.accepted, repeated=admission.repeated)

    def contact(self, now_s: float) -> Contact:
        """Return the contact as of `now_s` [s, monotonic].

        Raises
        ------
        ProblemError
            There is none to give: no model, no samples, too old, too few channels, or no usable estimate.
        """
        present = self._require_fresh(now_s)
        if present.model is None or not isinstance(present.outcome, Decision):
            # A new exception each time: one raised again and again would collect its tracebacks.
            raise ProblemError(present.outcome if isinstance(present.outcome, Problem) else self._no_model())
        return Contact(
            surface=self.name,
            state=present.outcome.state,
            **present.outcome.figures.model_dump(),
            age_ms=present.age_ms(now_s),
            sampled_at=rfc3339(present.sample.acquired_unix_us),
            sequence=present.sample.sequence,
            quality=ContactQuality.DEGRADED if present.degraded else ContactQuality.GOOD,
            degraded_channels=present.degraded,
            model=present.model.identity,
        )

    def unready(self, now_s: float) -> Problem | None:
        """Say why this surface is not ready at `now_s` [s, monotonic]: no model or no fresh samples; None if ready."""
        try:
            self._require_fresh(now_s)
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

    def _require_fresh(self, now_s: float) -> _Present:
        if self.model is None:
            raise ProblemError(self._no_model())
        if self._present is None:
            detail = "No sample has arrived since the service started; start the daemon, or look at what it reports."
            raise ProblemError(Problem(Kind.NO_SAMPLES, detail, self.name))
        # Compared before rounding, so that the limit is exact.
        if (now_s - self._present.acquired_s) * 1e3 > self.stale_ms:
            age_ms = self._present.age_ms(now_s)
            detail = (
                f"The newest sample is {age_ms:.1f} ms old, the limit is {self.stale_ms:g} ms; "
                "see whether the daemon runs and reaches the device."
            )
            members = {"age_ms": age_ms, "stale_ms": self.stale_ms}
            raise ProblemError(Problem(Kind.STALE, detail, self.name, members))
        return self._present

    def _no_model(self) -> Problem:
        detail = "Samples are accepted, but there is no model to estimate from; give one with --model or in the config."
        return Problem(Kind.NO_MODEL, detail, self.name)

    def _advance(self, batch: Batch, acquired_s: float) -> None:
        """Let the last sample of the batch be the present, unless it was taken before the one that is."""
        if self._present is not None and acquired_s < self._present.acquired_s:
            return
        sample = batch.samples[-1]
        if self.model is None or self._inference is None:
            self._present = _Present(sample, acquired_s, [], None, None)
            return
        values, bad = _arrange(self.model.channels, batch.channels, sample)
        outcome = self._estimate(self.model, self._inference, values, bad)
        self._present = _Present(sample, acquired_s, list(bad), outcome, self.model)

    def _estimate(
        self, model: ModelFile, inference: Inference, values: list[float], bad: dict[str, Quality]
    ) -> Decision | Problem:
        working = len(values) - len(bad)
        if working < model.metadata.min_channels:
            named = ", ".join(f"{name} ({quality.value})" for name, quality in bad.items())
            detail = f"{working} work, the model needs {model.metadata.min_channels}; repair {named}."
            return Problem(Kind.TOO_FEW_CHANNELS, detail, self.name, {"bad_channels": dict(bad)})
        estimate = inference.estimate(values, [name not in bad for name in model.channels])
        try:
            return decide(estimate, model.metadata.contact_threshold, model.metadata.length_mm)
        except UnusableEstimateError as error:
            detail = f"For the newest sample {error}; check calibration and tare of the sensors, then the model."
            return Problem(Kind.UNUSABLE_ESTIMATE, detail, self.name)


def _arrange(wanted: list[str], offered: list[str], sample: Sample) -> tuple[list[float], dict[str, Quality]]:
    """Return the deflections in the order of the model, and the quality of those channels that are not good."""
    index = {name: position for position, name in enumerate(offered)}
    values: list[float] = []
    bad: dict[str, Quality] = {}
    for name in wanted:
        value, quality = sample.deflection_mm[index[name]], sample.quality[index[name]]
        if value is None or quality is not Quality.GOOD:
            bad[name] = quality
        elif abs(value) > _FLOAT32_MAX:
            # Finite as sent, infinite to the model, whose answer to that could look like any other.
            bad[name] = Quality.OUT_OF_RANGE
        values.append(0.0 if value is None or name in bad else value)
    return values, bad
