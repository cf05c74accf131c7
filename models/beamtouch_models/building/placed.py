"""The placed sensors of a scene, which `place`, `explain` and `build` all find first.

So each refuses the same scenes for the same reason and with the same line.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.accuracy.unexplained_thresholds import windows_of
from beamtouch_models.building.checks import check_scene, check_seen
from beamtouch_models.building.sensor_rules import check_spacing, sample_errors, sensor_rules
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement import DEFAULT_AIM, Aim, Placement, fewest_sensors, score_positions
from beamtouch_models.pricing.effects import Physics, required
from beamtouch_models.progress import Progress, silent
from beamtouch_models.scene import Scene


@dataclass(frozen=True)
class PlacedSensors:
    """The sensors of a scene."""

    physics: Physics
    influence: InfluenceFunction
    errors: SampleErrors
    placement: Placement

    @property
    def prior(self) -> Prior:
        """Everything that estimator and accuracy know: physics ends here."""
        return Prior.real(self.influence, np.array(self.placement.positions_mm), self.errors)


def placed(
    scene: Scene,
    chosen: FilterChoice,
    *,
    count: int | None = None,
    seed: int = 0,
    aim: Aim = DEFAULT_AIM,
    kept_mm: tuple[float, ...] = (),
    progress: Progress = silent,
) -> PlacedSensors:
    """Check a scene and place its sensors.

    Parameters
    ----------
    scene, chosen : the scene, and the filter of its model
    count : number of sensors; None: as the scene states
    seed : seed of the search
    aim : criterion and search of the layout
    kept_mm : layout that is taken as it is, because its sensors are mounted; none: the sensors are placed
    progress : called with the current step and the fraction done

    Raises
    ------
    SceneError
        No surface can be built of the scene; the message says why.
    """
    check_scene(scene, chosen, count or len(kept_mm) or None)
    physics = required(scene, chosen)
    needed = physics.scene
    influence, min_noise_mm = influence_of(needed), physics.filter.min_noise_mm(physics.noise)
    errors = sample_errors(needed, physics.noise.sample_mm, min_noise_mm, windows_of(physics.filter))
    if kept_mm:
        placement = Placement(kept_mm, score_positions(influence, np.array(kept_mm)), 0, ())
    else:
        placement = fewest_sensors(
            influence,
            sensor_rules(needed),
            (count, count) if count else needed.sensors.count_range,
            wanted_mm=needed.requirements.position_error_mm,
            errors=errors,
            seed=seed,
            aim=aim,
            progress=progress,
        )
    check_spacing(needed, placement.positions_mm)
    found = PlacedSensors(physics, influence, errors, placement)
    check_seen(found.prior, needed, physics.filter, seed)
    return found
