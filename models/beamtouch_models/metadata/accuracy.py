"""The measured accuracy of a model, and its golden answers."""

from pydantic import Field, FiniteFloat

from beamtouch_models.metadata.fields import MetadataPart


class Accuracy(MetadataPart):
    """Mean |position error| in percent of the length (eq. 5 of the paper), over the scene's ranges."""

    error_percent: float
    error_standard_error: float
    limit_percent: float
    limit_standard_error: float
    ratio_standard_error: float
    """Standard error of `ratio`, whose terms share their contacts."""

    @property
    def ratio(self) -> float:
        """Error over the accuracy limit; no estimator gets below 1."""
        return self.error_percent / self.limit_percent if self.limit_percent else float("nan")


class Golden(MetadataPart):
    """Inputs with the answers that the graph gave when it was built."""

    deflection_mm: list[list[FiniteFloat]] = Field(min_length=1)
    whitening_per_mm: list[list[list[FiniteFloat]]] = Field(min_length=1)
    answers: dict[str, list[FiniteFloat]]
