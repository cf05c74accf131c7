"""The measured accuracy of a model, and its golden answers."""

from pydantic import Field, FiniteFloat

from beamtouch_models.metadata.fields import MetadataPart


class SinceTouch(MetadataPart):
    """The error of an answer by the time since a touch, behind the filter of the model."""

    since_ms: float
    """Time in which this many readings of the touch have come."""
    readings: int
    error_percent: float
    """Mean |position error| in percent of the length if the beam follows the touch at once."""
    error_standard_error: float | None = None
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
    since_touch: list[SinceTouch] = Field(default_factory=list)
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
