"""Placement of the sensors."""

from beamtouch_models.placement.bound import largest_gap
from beamtouch_models.placement.counting import fewest_sensors, recommended_count
from beamtouch_models.placement.placing import (
    DEFAULT_AIM,
    Aim,
    Criterion,
    Placement,
    place,
    place_as,
    place_by_position_error,
    score_positions,
)

__all__ = [
    "DEFAULT_AIM",
    "Aim",
    "Criterion",
    "Placement",
    "fewest_sensors",
    "largest_gap",
    "place",
    "place_as",
    "place_by_position_error",
    "recommended_count",
    "score_positions",
]
