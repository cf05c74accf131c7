"""Layouts and their accuracy limits, for scripts."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.posterior import posterior_quantiles
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.accuracy.unexplained_thresholds import windows_of
from beamtouch_models.api.numbers import number, numbers, places_in, require, whole
from beamtouch_models.arrays import Floats
from beamtouch_models.building.checks import check_scene
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import influence_of, max_deflection_mm
from beamtouch_models.placement import DEFAULT_AIM, Aim, Criterion, place_as
from beamtouch_models.pricing.effects import required
from beamtouch_models.pricing.noise import check_scale, choose_filter
from beamtouch_models.scene import Scene


@dataclass(frozen=True)
class Limit:
    """The accuracy limit of a layout: the mean position error that no estimator can beat."""

    mean_mm: float
    """Mean error in mm."""
    standard_error_mm: float
    """Standard error of that mean, as contacts are drawn at random."""
    percent: float
    """Mean error in percent of the beam's length."""


def place(
    scene: Scene, sensors: int, *, criterion: Criterion = DEFAULT_AIM.criterion, spare: Literal[0, 1] = 0, seed: int = 0
) -> Floats:
    """Place sensors under a beam.

    Parameters
    ----------
    scene : the scene; its rules for the sensors hold
    sensors : number of sensors
    criterion : "position-error" makes the accuracy limit least, among the layouts that notice two contacts and spread
        loads as often as that of "eigenvalue-product", the paper's
    spare : 1 makes the error least when the worst single sensor has failed; only with "position-error"
    seed : seed of the search; the same seed gives the same layout

    Returns
    -------
    (sensors,) positions in mm from the left end, ascending.

    Raises
    ------
    SceneError
        No surface can be built of the scene, or its rules allow no layout with this number of sensors.
    """
    sensors, seed = whole(sensors, "sensors", 1), whole(seed, "seed", 0)
    if criterion not in get_args(Criterion):
        message = f"criterion = {criterion!r} must be one of {', '.join(get_args(Criterion))}"
        raise SceneError(message)
    if spare not in (0, 1) or (spare and (criterion != "position-error" or sensors == 1)):
        message = f"spare = {spare}: give 0, or 1 with two or more sensors and the criterion position-error"
        raise SceneError(message)
    built, errors = _checked(scene, sensors)
    found = place_as(Aim(criterion, spare), influence_of(built), sensor_rules(built), sensors, seed, errors)
    return np.array(found.positions_mm)


def accuracy_limit(
    scene: Scene, sensor_mm: ArrayLike, *, noise_mm: float | None = None, draws: int = 10_000, seed: int = 0
) -> Limit:
    """Return the accuracy limit of a layout, over all contacts of the scene.

    Parameters
    ----------
    scene, sensor_mm : the scene, and (sensors,) positions in mm from the left end
    noise_mm : standard deviation of a sample; default: that of the scene behind its filter
    draws : number of simulated contacts
    seed : seed of the contacts

    Raises
    ------
    SceneError
        No surface can be built of the scene, or the noise is 0.
    """
    draws, seed = whole(draws, "draws", 1), whole(seed, "seed", 0)
    prior = _prior(scene, sensor_mm, noise_mm)
    found = limit.accuracy_limit(prior, draws, seed)
    mm = prior.length_mm / 100
    return Limit(found.percent * mm, found.standard_error * mm, found.percent)


def error_along_mm(
    scene: Scene, sensor_mm: ArrayLike, position_mm: ArrayLike, *, draws: int = 64, seed: int = 0
) -> Floats:
    """Return the accuracy limit along the beam: the mean error of contacts at each position.

    Parameters
    ----------
    scene, sensor_mm : the scene, and (sensors,) positions in mm from the left end
    position_mm : (positions,) places of contacts, in the range of the scene
    draws, seed : number of contacts at each position, of all forces of the scene, and their seed

    Returns
    -------
    (positions,) in mm. Errors as `accuracy_limit`.
    """
    draws, seed = whole(draws, "draws", 1), whole(seed, "seed", 0)
    prior, rng = _prior(scene, sensor_mm, None), np.random.default_rng(seed)
    low, high = scene.contact.position_mm
    places = np.repeat(numbers(position_mm, "position_mm", least=low, most=high), draws)
    clean, deviation = prior.sampled(places, rng.uniform(*prior.force_n, size=len(places)))
    distance = posterior_quantiles(prior, clean + rng.normal(size=clean.shape) * deviation)[1]
    mean: Floats = distance.reshape(-1, draws).mean(axis=1)
    return mean


def _checked(scene: Scene, sensors: int) -> tuple[Scene, SampleErrors]:
    """Return the scene with the physics that it requires, and the errors of its samples."""
    require(scene, Scene, "scene", "what read_scene returns")
    chosen = choose_filter(scene)
    check_scene(scene, chosen, sensors)
    physics = required(scene, chosen)
    min_noise_mm = chosen.min_noise_mm(physics.noise)
    errors = sample_errors(physics.scene, physics.noise.sample_mm, min_noise_mm, windows_of(chosen))
    return physics.scene, errors


def _prior(scene: Scene, sensor_mm: ArrayLike, noise_mm: float | None) -> Prior:
    require(scene, Scene, "scene", "what read_scene returns")
    sensors = places_in(sensor_mm, "sensor_mm", scene.beam.length_mm)
    built, errors = _checked(scene, len(sensors))
    if noise_mm is not None:
        stated_mm = number(noise_mm, "noise_mm")
        if stated_mm <= 0:
            message = f"noise_mm = {stated_mm:g}: must be more than 0; without noise there is no accuracy limit"
            raise SceneError(message)
        check_scale(stated_mm, max_deflection_mm(built))
        errors = sample_errors(built, stated_mm)
    return Prior.real(influence_of(built), sensors, errors)
