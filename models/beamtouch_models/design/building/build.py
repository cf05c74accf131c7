"""The build of a model: filter, physics, layout, estimator, measured accuracy and golden answers; and its files."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.design.building.measure import measure
from beamtouch_models.design.building.sensors import place_sensors
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim, Placement
from beamtouch_models.design.scene import Scene, identity_of
from beamtouch_models.design.surface import Surface
from beamtouch_models.design.sweeps import Progress
from beamtouch_models.names import ESTIMATORS, EstimatorName
from beamtouch_models.runtime.metadata import BeamDrawing, Channel, DrawnSupport, Metadata, Ranges

POINTS, LOADS = 41, 33
"""Positions along the drawn beam and of its contact; a page interpolates between them."""
DIGITS = 4
"""Significant digits of a drawn deflection."""


@dataclass(frozen=True)
class Choices:
    """Choices of a build that the scene does not make."""

    estimator: EstimatorName = ESTIMATORS[0]
    aim: Aim = DEFAULT_AIM
    """Criterion of the layout, and the effort of search and measurements."""
    kept_mm: tuple[float, ...] = ()
    """Positions of sensors that are mounted already, placed with this aim; none: the sensors are placed."""


DEFAULTS = Choices()


@dataclass(frozen=True)
class Built:
    """A finished build."""

    content: bytes
    metadata: Metadata
    placement: Placement
    surface: Surface
    """The surface that the model was built for, with the price of each effect."""
    aim: Aim = DEFAULT_AIM


def build_model(
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
    sensors = place_sensors(
        Surface.of(scene),
        count=count,
        seed=seed,
        aim=choices.aim,
        kept_mm=choices.kept_mm,
        progress=lambda _, done: progress("placing the sensors", 0.3 * done),
    )
    surface, prior = sensors.surface, sensors.prior
    made = sensors.make_estimator(
        choices.estimator,
        seed,
        lambda done: progress("making the estimator", 0.3 + 0.5 * done),
        choices.aim.effort,
    )
    progress("measuring the accuracy against the limit", 0.8)
    fields = measure(made, prior, surface, sensors.world, seed, choices.aim)
    modelled, placement = surface.scene, sensors.placement
    layout = [Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(placement.positions_mm, start=1)]
    metadata = Metadata(
        name=name,
        beam=identity_of(surface.stated.beam, {channel.name: channel.position_mm for channel in layout}),
        estimator=made.name,
        length_mm=modelled.beam.length_mm,
        layout=layout,
        ranges=Ranges(position_mm=modelled.contact.position_mm, force_n=modelled.contact.force_range_n),
        max_deflection_mm=surface.modelled_travel.largest_mm,
        noise=surface.noise,
        filter=surface.filter,
        sensor=surface.sensor,
        drawn=draw_beam(modelled),
        seed=seed,
        scene=text,
        **vars(fields),
    )
    return Built(to_bytes(made.graph, metadata), metadata, placement, surface, choices.aim)


def draw_beam(scene: Scene) -> BeamDrawing:
    """Return the beam of a scene as the service's page draws it: supports, and its shape under a contact."""
    at = np.linspace(0.0, scene.beam.length_mm, POINTS)
    load = np.linspace(*scene.contact.position_mm, LOADS)
    shape = influence(scene.beam, at, load, scene.contact.width_mm)
    return BeamDrawing(
        supports=[
            DrawnSupport(at_mm=one.at_mm, kind=one.kind, slides=not one.holds_lengthwise)
            for one in scene.beam.support_list
        ],
        at_mm=at.tolist(),
        load_mm=load.tolist(),
        deflection_mm_per_n=[[float(f"{value:.{DIGITS}g}") for value in row] for row in shape],
        sensor_mm=scene.sensors.size_mm,
    )
