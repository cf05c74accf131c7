"""The way in which a layout was placed, and how it fares with one sensor failed."""

from typing import Literal

from pydantic import Field, NonNegativeFloat

from beamtouch_models.metadata.fields import MetadataPart


class LayoutErrors(MetadataPart):
    """The placement of a layout; errors are accuracy limits in percent of the length."""

    criterion: Literal["position-error", "eigenvalue-product"]
    spare: int = Field(ge=0, le=1)
    """1: placed so that the largest error with one sensor failed is least."""
    limit_percent: NonNegativeFloat
    """With all sensors."""
    limit_without_percent: list[NonNegativeFloat]
    """With each sensor failed, in the order of the layout; empty for a single sensor."""
