"""Placement of the sensors."""

from beamtouch_models.placement.aims import LEAST_ERROR, Aim, place_as
from beamtouch_models.placement.counting import fewest_sensors, recommended_count
from beamtouch_models.placement.placing import Placement, place, place_by_position_error, score_positions

__all__ = [
    "LEAST_ERROR",
    "Aim",
    "Placement",
    "fewest_sensors",
    "place",
    "place_as",
    "place_by_position_error",
    "recommended_count",
    "score_positions",
]
