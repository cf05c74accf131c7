"""The build of a model, from a scene to its files: layout, estimator, measured accuracy; configuration and report."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from beamtouch_common.files import require_writable, write_atomically
from beamtouch_models.building.daemon_config import daemon_config as daemon_config_of
from beamtouch_models.building.measure import Measured, measure
from beamtouch_models.building.sensors import PlacedSensors, count_of, layout_errors, place_sensors
from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.estimator import NAMES, Estimator, Name, estimator_of
from beamtouch_models.estimators.onnx_graph import to_bytes
from beamtouch_models.metadata import Channel, Drawn, DrawnSupport, Metadata, Ranges
from beamtouch_models.metadata.fields import NAME
from beamtouch_models.numbers import require, whole
from beamtouch_models.physics.beam import influence
from beamtouch_models.placement.placing import DEFAULT_AIM, Aim, Criterion, Placement
from beamtouch_models.progress import Progress, silent
from beamtouch_models.scene import Scene, format_scene, identity_of, load_scene, read_scene
from beamtouch_models.scene.scene import path_of
from beamtouch_models.surface import Surface

POINTS, LOADS = 41, 33
"""Positions along the drawn beam and of its contact; a page interpolates between them."""
DIGITS = 4
"""Significant digits of a drawn deflection."""


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
    made = estimator_of(
        choices.estimator,
        prior,
        min_noise_mm=surface.filter.min_noise_mm(surface.noise),
        with_force=scene.wants_force,
        seed=seed,
        progress=lambda done: progress("making the estimator", 0.3 + 0.5 * done),
    )
    progress("measuring the accuracy against the limit", 0.8)
    fields = measure(made, prior, surface, sensors.world, seed)
    metadata = _metadata(name, text, sensors, choices.aim, made, fields, seed)
    return Built(to_bytes(made.graph, metadata), metadata, sensors.placement, surface, choices.aim)


def _metadata(
    name: str, text: str, sensors: PlacedSensors, aim: Aim, made: Estimator, fields: Measured, seed: int
) -> Metadata:
    """Return the metadata of an estimator of a surface, with the TOML text of its scene."""
    surface, scene = sensors.surface, sensors.surface.scene
    layout = [Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(sensors.placement.positions_mm, start=1)]
    return Metadata(
        name=name,
        beam=identity_of(surface.stated.beam, {channel.name: channel.position_mm for channel in layout}),
        estimator=made.name,
        length_mm=scene.beam.length_mm,
        layout=layout,
        min_channels=made.min_channels,
        ranges=Ranges(position_mm=scene.contact.position_mm, force_n=scene.contact.force_range_n),
        max_deflection_mm=surface.modelled_travel.largest_mm,
        noise=surface.noise,
        filter=surface.filter,
        sensor=surface.sensor,
        floor=fields.floor,
        thresholds=fields.thresholds,
        smallest_force=fields.smallest_force,
        drawn=draw_beam(scene),
        influence=fields.influence,
        placed=layout_errors(sensors.prior, fields.accuracy, aim.criterion, aim.spare, seed),
        seed=seed,
        accuracy=fields.accuracy,
        golden=fields.golden,
        scene=text,
    )


def draw_beam(scene: Scene) -> Drawn:
    """Return the beam of a scene as the service's page draws it: supports, and its shape under a contact."""
    at = np.linspace(0.0, scene.beam.length_mm, POINTS)
    load = np.linspace(*scene.contact.position_mm, LOADS)
    shape = influence(scene.beam, at, load, scene.contact.width_mm)
    return Drawn(
        supports=[
            DrawnSupport(at_mm=one.at_mm, kind=one.kind, slides=not one.holds_lengthwise)
            for one in scene.beam.support_list
        ],
        at_mm=at.tolist(),
        load_mm=load.tolist(),
        deflection_mm_per_n=[[float(f"{value:.{DIGITS}g}") for value in row] for row in shape],
        sensor_mm=scene.sensors.size_mm,
    )


def build(  # noqa: PLR0913  # one for each option of the command
    scene: Path | str | Scene,
    name: str = "surface",
    *,
    sensors: int | None = None,
    criterion: Criterion = DEFAULT_AIM.criterion,
    spare: Literal[0, 1] = 0,
    estimator: Name = NAMES[0],
    daemon_config: Path | str | None = None,
    report: Path | str | None = None,
    seed: int = 0,
) -> bytes:
    """Build the model of a scene, as `design-sensors build` does.

    Parameters
    ----------
    scene : path of a TOML file, TOML text, or a scene; as that of `read_scene`
    name : name of the surface
    sensors : number of sensors; default: as the scene states
    criterion, spare : as those of `place`
    estimator : "posterior", "small-network" or "paper-network"
    daemon_config, report : files to write beside: a configuration for the daemon (TOML), and a report (HTML)
    seed : seed of all random numbers; the same seed gives the same bytes

    Returns
    -------
    The content of the model file.

    Raises
    ------
    InputError
        It is not a scene, or a file cannot be written.
    SceneError
        The scene cannot be built; the message says why.
    NotGoodEnoughError
        The model misses the accuracy limit.
    """
    stated, text = _stated(scene)
    require(name, str, "name", "text")
    if not re.fullmatch(NAME, name):
        message = f"name = {name!r} must have 1 to 64 letters, digits, '_', '.' or '-'"
        raise SceneError(message)
    if estimator not in NAMES:
        message = f"estimator = {estimator!r} must be one of {', '.join(NAMES)}"
        raise SceneError(message)
    config_file, report_file = (None if one is None else Path(one) for one in (daemon_config, report))
    require_writable((config_file, report_file), () if isinstance(scene, Scene) else (path_of(scene),))
    built = build_model(
        stated,
        text,
        name,
        count=count_of(sensors),
        seed=whole(seed, "seed", 0),
        progress=silent,
        choices=Choices(estimator=estimator, aim=Aim(criterion, spare)),
    )
    write_products(stated, built, config=config_file, report=report_file)
    return built.content


def write_products(
    scene: Scene,
    built: Built,
    *,
    model: Path | None = None,
    config: Path | None = None,
    report: Path | None = None,
    progress: Progress = silent,
) -> None:
    """Write the model, the daemon's configuration and the report of a build, each where a file is given for it."""
    # The report is measured before anything is written: a build that is interrupted leaves no file.
    text = None if report is None else _report(scene, built, progress)
    for path, content in (
        (model, built.content),
        (report, None if text is None else text.encode()),
        (config, None if config is None else daemon_config_of(built.metadata).encode()),
    ):
        if path is not None and content is not None:
            write_atomically(path, content)


def _report(scene: Scene, built: Built, progress: Progress) -> str:
    # Most builds write none, and its drawings and its template are a tenth of what a build would import.
    from beamtouch_models.building.report.facts import gather  # noqa: PLC0415
    from beamtouch_models.building.report.page import page  # noqa: PLC0415

    return page(gather(scene, built, progress))


def _stated(scene: Path | str | Scene) -> tuple[Scene, str]:
    """Return a scene and its TOML text."""
    if isinstance(scene, Scene):
        return scene, format_scene(scene)
    path = path_of(scene)
    return (read_scene(scene), str(scene)) if path is None else load_scene(path)
