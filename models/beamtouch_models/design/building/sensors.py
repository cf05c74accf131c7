"""The sensors of a scene, placed or kept, and how they fare with one of them failed."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.limit import MeanError, limits_without
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import (
    PLACES,
    directions,
    noise_at_rest,
    shapes_at_rest,
    smallest_force_n,
    touch_threshold,
)
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.estimators.estimator import Estimator, estimator_of
from beamtouch_models.design.physics.influence import InfluenceFunction
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim, Placement, fewest_sensors, score_positions
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.surface import Surface
from beamtouch_models.design.sweeps import Fraction, Progress, silent
from beamtouch_models.design.world import World
from beamtouch_models.errors import SceneError, require
from beamtouch_models.names import Criterion, EstimatorName
from beamtouch_models.numbers import number, whole

FAILED_DRAWS, LEAST_DRAWS = 1_024, 64
"""Usual and smallest number of contacts that the limits with each sensor failed share; only their ratios to the limit
are used."""


@dataclass(frozen=True)
class PlacedSensors:
    """The sensors of a surface."""

    surface: Surface
    placement: Placement

    @property
    def positions_mm(self) -> Floats:
        """(sensors,) from the left end."""
        return np.array(self.placement.positions_mm)

    @cached_property
    def prior(self) -> Prior:
        """Everything that estimator and accuracy know: physics ends here."""
        return self.surface.prior(self.positions_mm)

    @cached_property
    def world(self) -> World:
        """The simulated surface with these sensors."""
        surface = self.surface
        return World.of(surface.stated, surface.sensor, self.positions_mm, surface.modelled_readings.sensor_mm)

    def make_estimator(
        self, name: EstimatorName, seed: int, progress: Fraction = silent, effort: Effort = USUAL
    ) -> Estimator:
        """Make an estimator for the samples of these sensors; `progress` is called with the fraction done."""
        surface = self.surface
        return estimator_of(
            name,
            self.prior,
            min_noise_mm=surface.filter.min_noise_mm(surface.noise),
            with_force=surface.scene.wants_force,
            seed=seed,
            progress=progress,
            effort=effort,
        )


def place_sensors(
    surface: Surface,
    *,
    count: int | None = None,
    seed: int = 0,
    aim: Aim = DEFAULT_AIM,
    kept_mm: tuple[float, ...] = (),
    progress: Progress = silent,
) -> PlacedSensors:
    """Check a surface and place its sensors.

    Parameters
    ----------
    surface : the surface of a scene
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
    surface.check(count or len(kept_mm) or None)
    if kept_mm:
        placement = Placement(kept_mm, score_positions(surface.influence, np.array(kept_mm)), 0)
    else:
        placement = fewest_sensors(
            surface.influence,
            surface.rules,
            (count, count) if count else surface.stated.sensors.count_range,
            wanted_mm=surface.stated.requirements.position_error_mm,
            errors=surface.errors,
            seed=seed,
            aim=aim,
            progress=progress,
        )
    surface.check_spacing(placement.positions_mm)
    sensors = PlacedSensors(surface, placement)
    prior = sensors.prior
    threshold = touch_threshold(directions(shapes_at_rest(prior)), noise_at_rest(prior), surface.touch_rate)
    least = float(smallest_force_n(prior, threshold, np.linspace(*prior.position_mm, PLACES)).min())
    if least > prior.force_n[1]:
        raise SceneError(
            f"sensors: no contact of the scene is seen, as at least {digits(least, 3)} N is needed and contact.force_n "
            f"ends at {prior.force_n[1]:g} N; state less noise or zero_drift_mm, or allow more false_contacts_per_day"
        )
    return sensors


def place(
    scene: Scene,
    sensors: int | None = None,
    *,
    criterion: Criterion = DEFAULT_AIM.criterion,
    spare: Literal[0, 1] = 0,
    seed: int = 0,
    influence: InfluenceFunction | None = None,
    effort: float = 1.0,
) -> Floats:
    """Place sensors under a beam, as `design-sensors place` does.

    Parameters
    ----------
    scene : the scene; its rules for the sensors hold
    sensors : number of sensors; default: as the scene states
    criterion : "position-error" makes the accuracy limit least, among the layouts that detect two contacts and
        distributed loads as often as that of "eigenvalue-product", the paper's
    spare : 1 makes the error least when the worst single sensor has failed; only with "position-error"
    seed : seed of the search; the same seed gives the same layout
    influence : an influence function of your own; default: that of the scene's beam
    effort : share of the usual work, from 0.01 to 100; less is quicker, and may miss the best layout

    Returns
    -------
    (sensors,) positions in mm from the left end, ascending.

    Raises
    ------
    SceneError
        No surface can be built of the scene, or its rules allow no layout with this number of sensors.
    """
    require(scene, Scene, "scene", "what read_scene returns")
    count, seed, aim = (
        count_of(sensors),
        whole(seed, "seed", 0),
        Aim(criterion, spare, effort=Effort(number(effort, "effort"))),
    )
    surface = Surface.of(scene, own_influence=influence)
    return place_sensors(surface, count=count, seed=seed, aim=aim).positions_mm


def count_of(sensors: object) -> int | None:
    """Return a number of sensors as a script gives it; SceneError unless it is None, or a whole number of 1 or more."""
    return None if sensors is None else whole(sensors, "sensors", 1)


def limits_with_one_failed(prior: Prior, limit: MeanError, seed: int, effort: Effort = USUAL) -> list[MeanError]:
    """Return the accuracy limits with each sensor failed, from that with all of them; none for a single sensor.

    Their ratios to it come from contacts that they share.
    """
    if prior.channels == 1:
        return []
    found, draws = [], effort.of(FAILED_DRAWS, LEAST_DRAWS)
    for one in limits_without(prior, [(index,) for index in range(prior.channels)], draws, seed):
        scatter = math.hypot(one.ratio.standard_error * limit.percent, one.ratio.value * limit.standard_error)
        found.append(MeanError(one.ratio.value * limit.percent, scatter))
    return found
