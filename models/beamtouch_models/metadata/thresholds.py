"""The thresholds of a model, and the smallest force that passes them."""

from typing import Annotated, Self

from pydantic import Field, FiniteFloat, PositiveFloat, model_validator

from beamtouch_models.metadata.fields import MetadataPart

MAX_FALSE = 0.01
"""Largest share of samples at rest that may be taken for a contact; above it, nothing tells a contact from rest."""
SECONDS_PER_DAY = 86_400

_OfSquares = Annotated[float, Field(ge=1, le=1e6)]
"""Rest exceeds 1 in most samples, whatever the scene allows."""
_OfOdds = Annotated[float, Field(ge=0, le=1e6)]
"""The log odds are never below 0. Rest hardly exceeds that where zeros drift far more than readings scatter."""


def max_false_per_day(rate_hz: float) -> float:
    """Return the largest number of false contacts per day that a threshold can be chosen for."""
    return MAX_FALSE * SECONDS_PER_DAY * rate_hz


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
            message = f"{len(self.position_mm)} positions with {len(self.force_n)} forces"
            raise ValueError(message)
        return self
