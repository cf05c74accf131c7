"""The build of a model: filter, physics, layout, estimator, measured accuracy, golden answers."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import onnx

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.building.drawing import drawn_of
from beamtouch_models.building.held_limit import check_held
from beamtouch_models.building.measured import measured
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.estimator import NAMES, Name, estimator_of
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import Channel, FilterChoice, Metadata, Ranges, Sensor
from beamtouch_models.physics.beam import check_small_angles, influence_of, max_deflection_mm, travel_mm
from beamtouch_models.placement import Placement, fewest_sensors
from beamtouch_models.pricing.effects import Physics, required
from beamtouch_models.pricing.noise import check_scale, choose_filter, noise_of, step_mm
from beamtouch_models.progress import Progress
from beamtouch_models.scene import Scene

DEFAULT_ADC_BITS = 16


@dataclass(frozen=True)
class Choices:
    """Choices of a build that the scene does not make."""

    estimator: Name = NAMES[0]
    filter: FilterChoice | None = None
    """None: the filter that uses all of the latency."""
    finish: Callable[[onnx.ModelProto], onnx.ModelProto] = lambda graph: graph
    """Applied to the estimator's graph before it is measured."""


DEFAULTS = Choices()


@dataclass(frozen=True)
class Built:
    """A finished build."""

    content: bytes
    metadata: Metadata
    placement: Placement
    physics: Physics
    """The physics that the model was built with, and the price of each effect."""


def build(
    scene: Scene,
    text: str,
    name: str,
    *,
    count: int | None,
    seed: int,
    progress: Progress,
    choices: Choices = DEFAULTS,
) -> Built:
    """Build the model of a scene.

    Parameters
    ----------
    scene, text, name : the scene, its TOML text, and the name of the surface
    count : number of sensors; None: as the scene states
    seed : seed of all random numbers; the same seed gives the same bytes
    progress : called with the current step
    choices : choices other than the default ones

    Raises
    ------
    SceneError
        The scene cannot be built; the message says why.
    NotGoodEnoughError
        The model misses the accuracy limit, or its intervals hold too few of the true positions.
    """
    check_small_angles(scene)
    physics = _physics_of(scene, choices.filter or choose_filter(scene))
    sensor = sensor_of(scene)
    progress("placing the sensors", 0.0)
    # Physics ends here: layout, estimator and accuracy know only the influence matrix.
    influence, errors = influence_of(physics.scene), sample_errors(physics.scene, physics.noise.sample_mm)
    placement = fewest_sensors(
        influence,
        sensor_rules(physics.scene),
        (count, count) if count else scene.sensors.count_range,
        wanted_mm=scene.requirements.position_error_mm,
        errors=errors,
        seed=seed,
    )
    prior = Prior.real(influence, np.array(placement.positions_mm), errors)
    made = estimator_of(
        choices.estimator,
        prior,
        with_force=scene.wants_force,
        seed=seed,
        progress=lambda done: progress("making the estimator", 0.05 + 0.75 * done),
    )
    made = replace(made, graph=choices.finish(made.graph))
    progress("measuring the accuracy against the limit", 0.8)
    check_held(made, prior, seed + 4)
    found = measured(made, prior, scene, physics.filter, seed)
    metadata = Metadata(
        name=name,
        estimator=made.name,
        length_mm=scene.beam.length_mm,
        layout=[Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(placement.positions_mm, start=1)],
        min_channels=made.min_channels,
        ranges=Ranges(position_mm=scene.contact.position_mm, force_n=scene.contact.force_range_n),
        max_deflection_mm=max_deflection_mm(scene),
        noise=physics.noise,
        filter=physics.filter,
        sensor=sensor,
        floor=found.floor,
        thresholds=found.thresholds,
        smallest_force=found.smallest_force,
        drawn=drawn_of(scene),
        influence=found.influence,
        seed=seed,
        accuracy=found.accuracy,
        golden=found.golden,
        scene=text,
    )
    return Built(to_bytes(made.graph, metadata), metadata, placement, physics)


def _physics_of(scene: Scene, chosen: FilterChoice) -> Physics:
    """Return the required physics; SceneError if no model can carry the noise or the deflection."""
    noise_mm = noise_of(scene, chosen).sample_mm
    if noise_mm == 0:
        message = "sensors: with a noise of 0 there are no intervals; state the noise of a reading"
        raise SceneError(message)
    check_scale(noise_mm, max_deflection_mm(scene))
    return required(scene, chosen)


def sensor_of(scene: Scene) -> Sensor:
    """Return sensor, ADC and stand-off of a scene; SceneError if the beam leaves the sensor's range."""
    low, high = scene.sensors.range_mm
    lift, travel = travel_mm(scene)
    standoff = scene.sensors.standoff_mm
    if standoff is None:
        standoff = (low + high) / 2 + (travel - lift) / 2
    if standoff - travel < low or standoff + lift > high:
        message = (
            f"the beam travels {travel + lift:.4g} mm and with a stand-off of {standoff:.4g} mm leaves "
            f"sensors.range_mm = [{low:g}, {high:g}]; make the beam stiffer, the force smaller, "
            "or use a sensor with a longer range"
        )
        raise SceneError(message)
    bits = scene.sensors.adc_bits or DEFAULT_ADC_BITS
    gain = step_mm(scene.sensors.range_mm, bits)
    return Sensor(
        rate_hz=scene.sensors.rate_hz,
        range_mm=scene.sensors.range_mm,
        standoff_mm=standoff,
        adc_bits=bits,
        gain_mm_per_count=gain,
        offset_mm=low - 0.1 * (2**bits - 1) * gain,
    )
