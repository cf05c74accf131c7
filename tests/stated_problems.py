"""The placement problems that scenes state."""

from beamtouch_models.building.sensor_rules import sensor_rules
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.scene import Scene


def problem_in(scene: Scene) -> tuple[InfluenceFunction, Candidates]:
    """Influence function of a scene, and its rules for sensors."""
    return influence_of(scene), sensor_rules(scene)
