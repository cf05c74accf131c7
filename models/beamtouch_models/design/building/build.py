"""The build of a model from a layout: estimator, measured accuracy, golden answers, and the content of its file."""

import re
from dataclasses import dataclass

import numpy as np

from beamtouch_common.names import NAME, RULE
from beamtouch_models.design.building.measure import measure
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.layout import Layout
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.scene import Scene, format_scene, identity_of
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.sweeps import Progress, silent
from beamtouch_models.errors import SceneError, require
from beamtouch_models.names import ESTIMATORS, EstimatorName
from beamtouch_models.runtime.metadata import Metadata
from beamtouch_models.runtime.metadata_parts import BeamDrawing, Channel, DrawnSupport, Ranges

POINTS, LOADS = 41, 33
"""Positions along the drawn beam and of its contact; a page interpolates between them."""
DIGITS = 4
"""Significant digits of a drawn deflection."""


@dataclass(frozen=True)
class Built:
    """A finished build."""

    content: bytes
    metadata: Metadata
    layout: Layout
    """Whose model it is, with the surface and the price of each effect."""


def build_model(
    layout: Layout,
    name: str,
    *,
    text: str | None = None,
    estimator: EstimatorName = ESTIMATORS[0],
    seed: int = 0,
    progress: Progress = silent,
) -> Built:
    """Build the model of a layout.

    Parameters
    ----------
    layout : the sensors; their `aim` has the effort of the measurements
    name : name of the surface
    text : TOML text of the scene for the model file; None: its keys, without comments
    estimator : name of the estimator
    seed : seed of all random numbers; the same seed gives the same bytes
    progress : called with the current step and the fraction done

    Raises
    ------
    SceneError
        The scene cannot be built, or an argument is not as its line says; the message says why.
    NotGoodEnoughError
        The model misses the accuracy limit, or its intervals hold too few of the true positions.
    """
    require(name, str, "name", "text")
    if not re.fullmatch(NAME, name):
        raise SceneError(f"name = {name!r} must {RULE}")
    if estimator not in ESTIMATORS:
        raise SceneError(f"estimator = {estimator!r} must be one of {', '.join(ESTIMATORS)}")
    if not layout.surface.scene.is_computed and layout.surface.scene.measured is None:
        raise SceneError(
            "influence: a model file holds the scene's beam, not an influence function of your own; its layouts have "
            "limits, but no model; name a table of it in [measured], and build that"
        )
    surface, prior, scene = layout.surface, layout.prior, layout.surface.scene
    made = layout.make_estimator(estimator, seed, lambda done: progress("making the estimator", 0.3 + 0.5 * done))
    progress("measuring the accuracy against the limit", 0.8)
    along_mm, *across_mm = scene.contact.ranges_mm
    fields = measure(made, prior, surface, layout.world, seed, layout.aim)
    rows = [(name, *np.atleast_1d(place).tolist(), None) for name, place in layout.channels.items()]
    channels = [Channel(name=name, position_mm=x, across_mm=across, unit=scene.unit) for name, x, across, *_ in rows]
    metadata = Metadata(
        name=name,
        beam=identity_of(scene, layout.channels),
        estimator=made.name,
        length_mm=scene.length_mm,
        axes=list(prior.axes),
        width_mm=scene.size_mm[1] if len(scene.size_mm) > 1 else None,
        layout=channels,
        ranges=Ranges(position_mm=along_mm, across_mm=next(iter(across_mm), None), force_n=scene.contact.force_range_n),
        max_deflection_mm=surface.travel.largest_mm,
        noise=surface.noise,
        filter=surface.filter,
        sensor=surface.sensor,
        drawn=draw_beam(scene),
        seed=seed,
        scene=format_scene(scene) if text is None else text,
        **vars(fields),
    )
    return Built(to_bytes(made.graph, metadata), metadata, layout)


def draw_beam(scene: Scene) -> BeamDrawing:
    """Return the beam of a scene as the service's page draws it: supports, and its shape under a contact.

    How a measured structure is held and bends between its sensors is not known: it is a straight line. A plate is drawn
    from above, without its shape.
    """
    if not scene.has_beam:
        return BeamDrawing(
            supports=[] if scene.plate is None else _draw_supports(scene.plate),
            at_mm=[0.0, scene.length_mm],
            load_mm=[scene.contact.ranges_mm[0][0]],
            deflection_mm_per_n=[[0.0, 0.0]],
            sensor_mm=scene.sensors.size_mm,
        )
    position_mm = np.linspace(0.0, scene.beam.length_mm, POINTS)
    load = np.linspace(*scene.contact.position_mm, LOADS)
    shape = influence(scene.beam, position_mm, load, scene.contact.width_mm)
    return BeamDrawing(
        supports=[
            DrawnSupport(at_mm=support.at_mm, kind=support.kind, slides=not support.holds_lengthwise)
            for support in scene.beam.support_list
        ],
        at_mm=position_mm.tolist(),
        load_mm=load.tolist(),
        deflection_mm_per_n=[[float(f"{value:.{DIGITS}g}") for value in row] for row in shape],
        sensor_mm=scene.sensors.size_mm,
    )


def _draw_supports(plate: Plate) -> list[DrawnSupport]:
    """Return the supports of a plate: a line without one of its coordinates goes across the whole plate."""
    drawn = []
    for support in plate.support_list:
        end_mm = tuple(
            length if at_mm is None else at_mm
            for at_mm, length in zip((support.x_mm, support.y_mm), plate.size_mm, strict=True)
        )
        drawn.append(
            DrawnSupport(
                at_mm=support.x_mm or 0.0,
                across_mm=support.y_mm or 0.0,
                end_mm=(end_mm[0], end_mm[1]) if support.is_line else None,
                kind="simple" if support.stiffness_n_per_mm is None else "spring",
                slides=False,
            )
        )
    return sorted(drawn, key=lambda one: (one.at_mm, one.across_mm))
