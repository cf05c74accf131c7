"""The check of a scene before its effects are priced, its sensors placed or its model built, the same for all commands.

The same scene is refused for the same reason by each of them.
"""

from beamtouch_models.building.sensor_rules import sensor_of, sensor_rules
from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import check_small_angles
from beamtouch_models.placement.problem import equal_layout
from beamtouch_models.pricing.noise import check_errors, noise_of
from beamtouch_models.scene import Scene


def check_scene(scene: Scene, chosen: FilterChoice, count: int | None = None) -> None:
    """Refuse a scene of which no surface can be built.

    Parameters
    ----------
    scene, chosen : the scene, and the filter of its model
    count : number of sensors; None: as the scene states. If the scene leaves it open, one possible number is enough.

    Raises
    ------
    SceneError
        The beam deflects too far for small-angle theory or for the sensors' range, the noise is 0, the noise or the
        drift of zeros is out of proportion to the deflection, or no layout keeps the rules of sensors.
    """
    check_small_angles(scene)
    noise_mm = noise_of(scene, chosen).sample_mm
    if noise_mm == 0:
        message = "sensors: with a noise of 0 there are no intervals; state the noise of a reading"
        raise SceneError(message)
    check_errors(scene, chosen)
    sensor_of(scene)
    fewest = min(scene.sensors.fewest, scene.sensors.count_range[1])
    equal_layout(sensor_rules(scene), scene.beam.length_mm, count or fewest)
