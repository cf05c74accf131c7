"""The checks of a scene before and after its sensors are placed; `placed` makes them for all commands."""

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.touch_thresholds import (
    PLACES,
    directions,
    noise_at_rest,
    rate_per_sample,
    shapes_at_rest,
    smallest_force_n,
    touch_threshold,
)
from beamtouch_models.building.sensor_rules import sensor_of, sensor_rules
from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import check_small_angles
from beamtouch_models.placement.layout import equal_layout
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


def check_seen(prior: Prior, scene: Scene, chosen: FilterChoice, seed: int) -> None:
    """Raise SceneError if no contact of a scene is seen by a model with this prior, filter and seed."""
    rate = rate_per_sample(scene.requirements.false_contacts_per_day, scene.sensors.rate_hz, chosen.window)
    threshold = touch_threshold(directions(shapes_at_rest(prior)), noise_at_rest(prior), rate, seed + 1)
    least = float(smallest_force_n(prior, threshold, np.linspace(*prior.position_mm, PLACES)).min())
    if least > prior.force_n[1]:
        message = (
            f"sensors: no contact of the scene is seen, as at least {digits(least, 3)} N is needed and contact.force_n "
            f"ends at {prior.force_n[1]:g} N; state less noise or zero_drift_mm, or allow more false_contacts_per_day"
        )
        raise SceneError(message)
