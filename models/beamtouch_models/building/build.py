"""The build of a model: filter, physics, layout, estimator, measured accuracy, golden answers."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.building.drawing import drawn_of
from beamtouch_models.building.failing import placed_of
from beamtouch_models.building.limit_check import check_at_limit
from beamtouch_models.building.measured import Measured, measured
from beamtouch_models.building.placed import PlacedSensors, placed
from beamtouch_models.building.sensor_rules import sensor_of
from beamtouch_models.estimators.estimator import NAMES, Estimator, Name, estimator_of
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import Channel, Metadata, Ranges
from beamtouch_models.physics.beam import max_deflection_mm
from beamtouch_models.placement import DEFAULT_AIM, Aim, Placement
from beamtouch_models.pricing.effects import Physics
from beamtouch_models.pricing.noise import choose_filter
from beamtouch_models.progress import Progress
from beamtouch_models.scene import Scene, identity_of


@dataclass(frozen=True)
class Choices:
    """Choices of a build that the scene does not make."""

    estimator: Name = NAMES[0]
    aim: Aim = DEFAULT_AIM
    """Criterion of the layout."""
    kept_mm: tuple[float, ...] = ()
    """Positions of sensors that are mounted already, placed with this aim; none: the sensors are placed."""


DEFAULTS = Choices()


@dataclass(frozen=True)
class Built:
    """A finished build."""

    content: bytes
    metadata: Metadata
    placement: Placement
    physics: Physics
    """The physics that the model was built with, and the price of each effect."""
    aim: Aim = DEFAULT_AIM


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
    chosen = choose_filter(scene)
    sensors = placed(
        scene,
        chosen,
        count=count,
        seed=seed,
        aim=choices.aim,
        kept_mm=choices.kept_mm,
        progress=lambda _, done: progress("placing the sensors", 0.3 * done),
    )
    physics, prior = sensors.physics, sensors.prior
    made = estimator_of(
        choices.estimator,
        prior,
        min_noise_mm=physics.filter.min_noise_mm(physics.noise),
        with_force=scene.wants_force,
        seed=seed,
        progress=lambda done: progress("making the estimator", 0.3 + 0.5 * done),
    )
    progress("measuring the accuracy against the limit", 0.8)
    check_at_limit(made, prior, seed + 4)
    found = measured(made, prior, scene, np.array(sensors.placement.positions_mm), physics.filter, seed)
    metadata = _metadata(scene, name, text, sensors, choices.aim, made, found, seed)
    return Built(to_bytes(made.graph, metadata), metadata, sensors.placement, physics, choices.aim)


def _metadata(
    stated: Scene, name: str, text: str, sensors: PlacedSensors, aim: Aim, made: Estimator, found: Measured, seed: int
) -> Metadata:
    """Return the metadata of an estimator of a surface, with the scene as stated and its TOML text."""
    physics, scene = sensors.physics, sensors.physics.scene
    layout = [Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(sensors.placement.positions_mm, start=1)]
    return Metadata(
        name=name,
        beam=identity_of(stated.beam, {channel.name: channel.position_mm for channel in layout}),
        estimator=made.name,
        length_mm=scene.beam.length_mm,
        layout=layout,
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
        placed=placed_of(sensors.prior, aim.criterion, aim.spare, seed),
        seed=seed,
        accuracy=found.accuracy,
        golden=found.golden,
        scene=text,
    )
