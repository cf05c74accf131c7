"""The build of a model: filter, physics, layout, estimator, measured accuracy, golden answers."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import onnx

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.building.checks import check_scene
from beamtouch_models.building.drawing import drawn_of
from beamtouch_models.building.held_limit import check_held
from beamtouch_models.building.measured import Measured, check_seen, measured
from beamtouch_models.building.sensor_rules import check_spacing, sample_errors, sensor_of, sensor_rules
from beamtouch_models.estimators.estimator import NAMES, Estimator, Name, estimator_of
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import Channel, FilterChoice, Metadata, Ranges
from beamtouch_models.physics.beam import influence_of, max_deflection_mm
from beamtouch_models.placement import Placement, fewest_sensors
from beamtouch_models.pricing.effects import Physics, required
from beamtouch_models.pricing.noise import choose_filter
from beamtouch_models.progress import Progress
from beamtouch_models.scene import Scene


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
    chosen = choices.filter or choose_filter(scene)
    check_scene(scene, chosen, count)
    physics = required(scene, chosen)
    progress("placing the sensors", 0.0)
    placement, prior = _placed(physics, count, seed)
    made = estimator_of(
        choices.estimator,
        prior,
        least_noise_mm=physics.filter.least_noise_mm(physics.noise),
        with_force=scene.wants_force,
        seed=seed,
        progress=lambda done: progress("making the estimator", 0.05 + 0.75 * done),
    )
    made = replace(made, graph=choices.finish(made.graph))
    progress("measuring the accuracy against the limit", 0.8)
    check_held(made, prior, seed + 4)
    found = measured(made, prior, scene, physics.filter, seed)
    metadata = _metadata(name, text, physics, placement, made, found, seed)
    return Built(to_bytes(made.graph, metadata), metadata, placement, physics)


def _metadata(
    name: str, text: str, physics: Physics, placement: Placement, made: Estimator, found: Measured, seed: int
) -> Metadata:
    """Return the metadata of an estimator of a surface, with the scene's TOML text."""
    scene = physics.scene
    return Metadata(
        name=name,
        estimator=made.name,
        length_mm=scene.beam.length_mm,
        layout=[Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(placement.positions_mm, start=1)],
        min_channels=made.min_channels,
        ranges=Ranges(position_mm=scene.contact.position_mm, force_n=scene.contact.force_range_n),
        max_deflection_mm=max_deflection_mm(scene),
        noise=physics.noise,
        filter=physics.filter,
        sensor=sensor_of(scene),
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


def _placed(physics: Physics, count: int | None, seed: int) -> tuple[Placement, Prior]:
    """Place the sensors. Physics ends here: estimator and accuracy know only the influence matrix in the prior."""
    scene = physics.scene
    influence, errors = influence_of(scene), sample_errors(scene, physics.noise.sample_mm)
    placement = fewest_sensors(
        influence,
        sensor_rules(scene),
        (count, count) if count else scene.sensors.count_range,
        wanted_mm=scene.requirements.position_error_mm,
        errors=errors,
        seed=seed,
    )
    check_spacing(scene, placement.positions_mm)
    prior = Prior.real(influence, np.array(placement.positions_mm), errors)
    check_seen(prior, scene, physics.filter, seed)
    return placement, prior
