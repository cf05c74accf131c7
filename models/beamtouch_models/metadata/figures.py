"""The figures of a model: its thresholds, the smallest force that passes them, accuracy, layout and golden answers."""

from typing import Annotated, Self

from pydantic import Field, FiniteFloat, NonNegativeFloat, PositiveFloat, model_validator

from beamtouch_models.metadata.fields import MetadataPart
from beamtouch_models.names import Criterion

_OfSquares = Annotated[float, Field(ge=1, le=1e6)]
"""Rest exceeds 1 in most samples, whatever the scene allows."""
_OfOdds = Annotated[float, Field(ge=0, le=1e6)]
"""The log odds are never below 0. Rest hardly exceeds that where zeros drift far more than readings scatter."""


class Thresholds(MetadataPart):
    """Thresholds for any covariance, by the number of valid channels; the first entries are for one channel."""

    touch: list[_OfOdds]
    """A sample is a contact if `contact_log_odds` exceeds this."""
    rest: list[_OfSquares]
    """Rest does not explain a sample if the sum of squares of the whitened sample exceeds this."""
    misfit: list[_OfSquares]
    """No single contact explains a sample if `misfit` exceeds this."""
    false_contacts_per_day: PositiveFloat
    """Contacts per day at rest that `touch` was chosen for."""


class SmallestForce(MetadataPart):
    """The smallest force that a settled sample shows along the beam, with all channels."""

    position_mm: Annotated[list[FiniteFloat], Field(min_length=1)]
    """Evenly spaced from end to end of the range, and the supports within it."""
    force_n: list[PositiveFloat | None]
    """95 of 100 settled samples at this force are a contact; null: nothing is seen, as at a support."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.force_n) != len(self.position_mm):
            raise ValueError(f"{len(self.position_mm)} positions with {len(self.force_n)} forces")
        return self


class SinceTouch(MetadataPart):
    """The error of an answer by the time since a touch, behind the filter of the model."""

    since_ms: float
    """Time in which this many readings of the touch have come."""
    readings: int
    error_percent: float
    """Mean |position error| in percent of the length if the beam follows the touch at once."""
    error_standard_error: float
    ringing_percent: float | None = None
    """The same after a sudden force, which rings; None if the scene does not state the beam's mass."""
    ringing_standard_error: float | None = None


class Accuracy(MetadataPart):
    """Mean |position error| in percent of the length (eq. 5 of the paper), over the scene's ranges."""

    error_percent: float
    error_standard_error: float
    limit_percent: float
    limit_standard_error: float
    ratio_standard_error: float
    """Standard error of `ratio`, whose terms share their contacts."""
    since_touch: list[SinceTouch]
    """From the first answer to the longest mean; all figures above are those of a mean of `filter.window` readings."""

    @property
    def ratio(self) -> float:
        """Error over the accuracy limit; no estimator gets below 1."""
        return self.error_percent / self.limit_percent if self.limit_percent else float("nan")


class Golden(MetadataPart):
    """Inputs with the answers that the graph gave when it was built."""

    deflection_mm: list[list[FiniteFloat]] = Field(min_length=1)
    whitening_per_mm: list[list[list[FiniteFloat]]] = Field(min_length=1)
    answers: dict[str, list[FiniteFloat]]


class LayoutErrors(MetadataPart):
    """The placement of a layout; errors are accuracy limits in percent of the length."""

    criterion: Criterion
    spare: int = Field(ge=0, le=1)
    """1: placed so that the largest error with one sensor failed is least."""
    limit_without_percent: list[NonNegativeFloat]
    """With each sensor failed, in the order of the layout; empty for a single sensor. That with all is
    `Accuracy.limit_percent`."""
    limit_without_standard_error: list[NonNegativeFloat]
