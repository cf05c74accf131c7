"""Error against time since touch: one curve per number of sensors, with the exact Bayes filter as its limit."""

import math
from dataclasses import dataclass, replace

import numpy as np

from beamtouch_models.accuracy.limit import draw_evenly
from beamtouch_models.accuracy.posterior import posterior_quantiles
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import Measurement, mean_of
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.building.since_touch import FIRST, Course, Touches
from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.posterior.cells import design_for
from beamtouch_models.estimators.posterior.graph import posterior_graph
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement import place
from beamtouch_models.pricing.effects import required
from beamtouch_models.pricing.noise import (
    SPIKE_SIGMAS,
    choose_filter,
    longest_mean,
    noise_of,
    reading_noise_mm,
)
from beamtouch_models.scene import Scene
from beamtouch_models.session import runner

CONTACTS = 256
"""Most contacts of a curve; each runs through the filters reading by reading."""


@dataclass(frozen=True)
class Curve:
    """Mean |position error| in percent of the length, by the time since the first reading of a touch."""

    sensors: int
    readings: tuple[int, ...]
    """Number of readings since the touch."""
    since_ms: tuple[float, ...]
    error_percent: tuple[Measurement, ...]
    """Error behind the growing mean."""
    limit_percent: tuple[Measurement, ...]
    """Error of the exact posterior of all readings since the touch, whose time it knows."""


@dataclass(frozen=True)
class CurveTask:
    """A curve to measure, as a task that can be sent."""

    scene: Scene
    sensors: int
    draws: int
    seed: int


def curve(task: CurveTask) -> Curve | SceneError:
    """Measure a curve; the beam follows each touch at once.

    An error is returned: a layout cannot be found, or the noise is too large or too small for a model.
    """
    try:
        return _curve(task.scene, task.sensors, task.draws, task.seed)
    except SceneError as error:
        return error


def growths(longest: int) -> tuple[int, ...]:
    """Return the numbers of readings at which a curve is measured."""
    doubling = [FIRST * 2**power for power in range(longest.bit_length())]
    return tuple(sorted({min(FIRST, longest), *(number for number in doubling if number < longest), longest}))


def _curve(scene: Scene, count: int, draws: int, seed: int) -> Curve:
    physics = required(scene, choose_filter(scene))
    influence = influence_of(physics.scene)
    errors = sample_errors(physics.scene, noise_of(scene, physics.filter).sample_mm)
    layout = np.array(place(influence, sensor_rules(physics.scene), count, seed).positions_mm)
    prior = Prior.real(influence, layout, errors)
    rate_hz, reading_mm = scene.sensors.rate_hz, reading_noise_mm(scene)
    readings = growths(longest_mean(scene, physics.filter.window))
    number = min(draws, CONTACTS)
    scale = 100 / prior.length_mm
    return Curve(
        count,
        readings,
        tuple((one - 1) * 1e3 / rate_hz for one in readings),
        tuple(one.scaled(scale) for one in _errors(scene, prior, readings, number, seed)),
        tuple(
            _limit(replace(prior, noise_mm=reading_mm / math.sqrt(one)), number, seed).scaled(scale) for one in readings
        ),
    )


def _limit(prior: Prior, draws: int, seed: int) -> Measurement:
    """Return the mean error of the exact posterior in mm."""
    drawn = draw_evenly(prior, draws, seed + 1)
    deviation = posterior_quantiles(prior, drawn.deflection_mm, np.full((len(drawn.position_mm), 1), 0.5))[1]
    return mean_of(deviation, np.broadcast_to(drawn.weight, len(deviation)))


def _errors(scene: Scene, prior: Prior, readings: tuple[int, ...], draws: int, seed: int) -> list[Measurement]:
    """Return the mean errors in mm after each number of readings, behind the filter that `build` writes."""
    reading_mm, window, longest = reading_noise_mm(scene), choose_filter(scene).window, readings[-1]
    chosen = FilterChoice(
        kind="growing-mean", window=window, longest=longest, spike_mm=SPIKE_SIGMAS * reading_mm or None
    )
    design = design_for(replace(prior, noise_mm=reading_mm / math.sqrt(longest)))
    run = runner(posterior_graph(prior, with_force=False, design=design).SerializeToString())
    touches = Touches.draw(prior, reading_mm, draws, seed + 1)
    errors_mm = Course.draw(touches, scene, chosen, longest, seed).errors_mm(run, readings)
    return [mean_of(one, touches.weight) for one in errors_mm]
