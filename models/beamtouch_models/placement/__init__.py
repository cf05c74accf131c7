"""Placement of the sensors."""

from beamtouch_models.placement.counting import fewest_sensors, recommended_count
from beamtouch_models.placement.placing import Placement, place, place_by_position_error, score_positions

__all__ = ["Placement", "fewest_sensors", "place", "place_by_position_error", "recommended_count", "score_positions"]
