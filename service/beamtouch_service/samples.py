"""The published batch: what a daemon sends to `POST /surfaces/{name}/samples`.

The service receives it, so the service owns its format. The daemon imports this module and nothing else of the
service. It depends on pydantic only, so a gateway needs no web framework and no onnxruntime.
"""

from enum import StrEnum
from operator import le
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, JsonValue, model_validator

from beamtouch_common.names import Name

MAX_CHANNELS = 64
MAX_SAMPLES = 2000
"""Limit for a batch. The next batch of its surface waits until its samples are estimated; long ones of others, too."""
MAX_READINGS = 1_000_000
"""Limit for a sample."""
MAX_AGE_MS = 1e12
"""Largest age of a batch, about 30 years. A sender whose clock began in 1970 states this instead of more."""
MAX_NOISE_MM = 1e4
"""Largest standard deviation of a channel. Beyond it, figures overflow."""
_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)

MAX_EARLIER = 64
"""Limit of past boots that a batch names."""

BootId = Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{8,64}$")]
ChannelName = Name
Noise = Annotated[FiniteFloat, Field(gt=0, le=MAX_NOISE_MM)]
Deviation = Annotated[FiniteFloat, Field(ge=0, le=MAX_NOISE_MM)]
Covariance = Annotated[FiniteFloat, Field(ge=-(MAX_NOISE_MM**2), le=MAX_NOISE_MM**2)]
BeamIdentity = Name
SurfaceName = Name


class Quality(StrEnum):
    """Quality of one channel in one sample. Only `good` channels reach the model."""

    GOOD = "good"
    OUT_OF_RANGE = "out-of-range"
    """The gap lies outside the linear range of the sensor."""
    SATURATED = "saturated"
    """The counts stand at the end of the ADC."""
    STUCK = "stuck"
    """The counts have not changed for longer than noise makes plausible."""
    MISSING = "missing"
    """No reading of this channel, or too few for the filter so far."""


class Note(StrEnum):
    """All notes on an answer: word, bit of the Modbus register `notes`, meaning. `check-NAME` is not in this list.

    Controllers are programmed against the bits: a note keeps its bit for good.
    """

    bit: int
    meaning: str

    def __new__(cls, word: str, bit: int, meaning: str) -> Self:
        """Return the note of this word."""
        note = str.__new__(cls, word)
        note._value_ = word
        note.bit, note.meaning = bit, meaning
        return note

    OVERLOAD = "overload", 0, "the force is beyond the range of the scene"
    UNSTEADY = "unsteady", 1, "the surface moves, or one sample does not settle the state"
    UNCHECKED = "unchecked", 2, "too few channels work to tell a single contact from anything else"
    RATE = "rate", 3, "the device does not keep its rate"
    NOISE = "noise", 4, "the daemon states another noise than the model was made for"
    DEGRADED = "degraded", 5, "a channel has been out for longer than `degraded_after_s`"
    SENDERS = "senders", 6, "two daemons send samples of the surface"
    ZEROS = (
        "zeros",
        7,
        "zeros moved together as in warmth, nearly as far as is followed, or too fast: wait, then tare",
    )


class Sample(BaseModel):
    """One filtered deflection per channel, with its covariance, its quality and its time."""

    model_config = _STRICT

    sequence: int = Field(ge=1, lt=2**53)
    """Counts the samples since the sender started, from 1 on. A gap is a loss."""
    acquired_unix_us: int = Field(ge=0, lt=2**53)
    """Time of its newest reading by the sender's clock; for the record, never for freshness."""
    deflection_mm: list[FiniteFloat | None] = Field(min_length=1, max_length=MAX_CHANNELS)
    """One value per channel, positive in the direction of the load; null for a missing channel."""
    quality: Annotated[list[Annotated[Quality, Field(strict=False)]], Field(max_length=MAX_CHANNELS)]
    """One quality per channel."""
    readings: int | None = Field(default=None, ge=1, le=MAX_READINGS)
    """Number of readings in it. Null: the sender states no noise, and the sample counts as a settled one."""
    covariance_mm2: list[Covariance] | None = Field(default=None, max_length=MAX_CHANNELS * (MAX_CHANNELS + 1) // 2)
    """Covariance of the deflections [mm^2]: the lower triangle by rows, 0 for a channel that is not good.

    Null: the noise of a reading squared over `readings` on the diagonal, and nothing else.
    """
    zero_mm: list[Deviation] | None = Field(default=None, min_length=2, max_length=2)
    """How far zeros may have drifted since the last rest, beyond what the model allows for: all channels together, and
    each by itself, as standard deviations [mm]. The service adds it to the covariance. Null: no further."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.quality) != len(self.deflection_mm):
            raise ValueError(f"{len(self.deflection_mm)} deflections with {len(self.quality)} qualities")
        if None in self.deflection_mm and (None, Quality.GOOD) in zip(self.deflection_mm, self.quality, strict=True):
            raise ValueError("a channel without a deflection cannot be good")
        if self.covariance_mm2 is not None:
            self._require_shape(self.covariance_mm2)
        return self

    def _require_shape(self, covariance_mm2: list[float]) -> None:
        """Raise ValueError unless this has the size of the covariance of the deflections.

        Whether its values can be one, the service looks at (`surfaces.covariances`): here there is no numpy.
        """
        channels = len(self.deflection_mm)
        if self.readings is None:
            raise ValueError("covariance_mm2 needs readings")
        if len(covariance_mm2) != channels * (channels + 1) // 2:
            message = (
                f"covariance_mm2 must hold {channels * (channels + 1) // 2} values, the lower triangle of {channels} "
                f"channels, not {len(covariance_mm2)}"
            )
            raise ValueError(message)


_EXAMPLE: dict[str, JsonValue] = {
    "boot_id": "6f1d2c84-0b7e-4a53",
    "channels": ["s1", "s2", "s3"],
    "newest_age_ms": 3.2,
    "samples": [
        {
            "sequence": 4711,
            "acquired_unix_us": 1795218046123000,
            "deflection_mm": [0.112, 0.243, None],
            "quality": ["good", "good", "missing"],
            "readings": 40,
        }
    ],
}


TARED_AT = r"^[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}(Z|\+00:00)$"


class Batch(BaseModel):
    """Samples of one surface in the order they were taken."""

    model_config = ConfigDict(**_STRICT, json_schema_extra={"examples": [_EXAMPLE]})

    boot_id: BootId
    """New at every start of the sender. With the sequence number, it identifies a sample for good."""
    channels: list[ChannelName] = Field(min_length=1, max_length=MAX_CHANNELS)
    """The channel names, in the order of the values in each sample."""
    newest_age_ms: FiniteFloat | None = Field(default=None, ge=0, le=MAX_AGE_MS)
    """Age of the last sample at sending, by the sender's monotonic clock. Freshness depends on nothing else. Null in a
    backlog, which never moves the answer."""
    sent_us: int | None = Field(default=None, ge=0, lt=2**53)
    """When `newest_age_ms` was true, by a clock of the sender that never jumps, with any origin. From two batches the
    service sees which one waited on the way, and counts that to the age. Null: the sender has no such clock."""
    samples: list[Sample] = Field(max_length=MAX_SAMPLES)
    """The samples, in the order in which they were taken. None: the sender only asks how far the record is."""
    backlog: bool = False
    """True if these are read from the sender's log for the record only: they never touch the answer."""
    oldest: int | None = Field(default=None, ge=1, lt=2**53)
    """Number of the oldest sample of this boot that the sender's log still holds; the number of its next sample if it
    holds none. What is before it and not in the record is lost. Null: the sender keeps nothing."""
    earlier: list[BootId] = Field(default=[], max_length=MAX_EARLIER)
    """The past boots that the sender's log still holds samples of."""
    notes: list[Literal["rate", "zeros"]] = Field(default=[], max_length=2)
    """Notes of the sender while it took these samples."""
    noise_mm: list[Noise] | None = Field(default=None, max_length=MAX_CHANNELS)
    """Standard deviation of one reading of each channel, as the sender assumes it. Null: the sender does not say."""
    characteristic: str | None = Field(default=None, pattern=r"^[A-Za-z0-9-]{1,64}$")
    """Identity of the sender's characteristics and rest gaps; it changes with either."""
    tared_at: str | None = Field(default=None, pattern=TARED_AT)
    """When the sender's rest gaps were measured, in UTC. Null: never, or the sender does not say."""
    beam: BeamIdentity | None = None
    """Identity of the beam and layout that the sender is configured for. A service whose model is of another beam
    refuses the batch. Null: the sender does not say, and nothing is compared."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.channels)) != len(self.channels):
            raise ValueError("a channel name occurs twice")
        if self.newest_age_ms is None and self.samples and not self.backlog:
            raise ValueError("newest_age_ms is missing; only a backlog has no age")
        if self.backlog and self.newest_age_ms is not None:
            raise ValueError("a backlog has no newest_age_ms")
        if not {len(sample.deflection_mm) for sample in self.samples} <= {len(self.channels)}:
            raise ValueError(f"every sample must hold {len(self.channels)} values, one per channel")
        if self.noise_mm is not None and len(self.noise_mm) != len(self.channels):
            raise ValueError(f"noise_mm must hold {len(self.channels)} values, one per channel")
        sequences = [sample.sequence for sample in self.samples]
        if any(map(le, sequences[1:], sequences)):
            raise ValueError("sequence numbers must increase")
        return self


class Receipt(BaseModel):
    """The answer to a batch."""

    accepted: int = Field(ge=0)
    """Samples that were new."""
    repeated: int = Field(ge=0)
    """Samples that had been received before; they changed nothing."""
    durable: int | None = None
    """Number of the last sample of this boot that is durable in the record, 0 for none: the sender can forget all up to
    it. Null while the record cannot be read."""
    expected: int | None = None
    """Number of the sample that the record takes next. Null while the record cannot be read."""
    stale_ms: float
    """From this age on, samples are too old for an answer [ms]."""
