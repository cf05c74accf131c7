"""Surfaces that differ from their scenes, and known loads on them: the rig's formulas without its line."""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibrated import depart
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.design.physics.structure import influence_of
from beamtouch_models.design.scene import parse_scene
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.places import grid_of, in_rows, on_axis
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.metadata import Metadata

POSITIONS, FORCES = np.linspace(20.0, 380.0, 10), np.full(10, 12.0)
"""Of ten loads on a beam of 400 mm."""
SAMPLES = 200
"""Samples of each load."""
MISTAKES = ("20 mm", "40 mm", "60 mm", "2 x force", "10 x force")
FORCE_PER_MM = 0.01
"""Relative deviation of a force per mm by which its load is misplaced: hands are as good with both."""
SESSION_MIN = 10.0
"""Time in which the loads of a recording follow each other."""


def random_imperfections(metadata: Metadata, rng: np.random.Generator) -> Imperfections:
    """Departures that a fit can find, from a fifth of to all that is plausible."""
    size = rng.uniform(0.2, 1.0)
    sensors = metadata.layout_mm
    if len(metadata.axes) > 1:
        return _random_plate(metadata, size, rng)
    moved = np.clip(sensors + np.clip(size * rng.normal(size=len(sensors)), -2, 2), 0, metadata.length_mm) - sensors
    beam = parse_scene(metadata.scene, metadata.name).beam
    fixity = rng.permutation([size * rng.uniform(0, 0.1), 0.0]) if beam.supports == "simply-supported" else (0.0, 0.0)
    return Imperfections(
        position_offset_mm=tuple(moved.tolist()),
        gain=tuple((1 + size * rng.normal(scale=0.03, size=len(sensors))).tolist()),
        curve_per_mm=float(size * rng.uniform(-0.015, 0.015) / metadata.max_deflection_mm),
        fixity=(float(fixity[0]), float(fixity[1])),
        rigidity=float(1 + size * rng.uniform(-0.05, 0.05)),
    )


def _random_plate(metadata: Metadata, size: float, rng: np.random.Generator) -> Imperfections:
    sensors, channels = metadata.layout_mm, len(metadata.layout)
    moved = np.clip(sensors + np.clip(size * rng.normal(size=sensors.shape), -2, 2), 0, metadata.size_mm) - sensors
    supports = parse_scene(metadata.scene, metadata.name).solid.support_list
    return Imperfections(
        x_offset_mm=tuple(moved[:, 0].tolist()),
        y_offset_mm=tuple(moved[:, 1].tolist()),
        gain=tuple((1 + size * rng.normal(scale=0.03, size=channels)).tolist()),
        curve_per_mm=float(size * rng.uniform(-0.015, 0.015) / metadata.max_deflection_mm),
        rigidity=float(1 + size * rng.uniform(-0.05, 0.05)),
        spring_stiffness=tuple((1 + size * np.clip(rng.normal(scale=0.1, size=len(supports)), -0.25, 0.25)).tolist()),
    )


def true_prior(metadata: Metadata, real: Imperfections) -> Prior:
    """Return what an estimator would know that knew everything of the real surface."""
    scene, layout_mm = parse_scene(metadata.scene, metadata.name), metadata.layout_mm
    sensors_mm, of_plate = in_rows(layout_mm, len(metadata.axes)), len(metadata.axes) > 1
    prior = Prior.of(influence_of(scene), sensors_mm, Errors(metadata.noise.sample_mm))
    departures = real.departures(len(layout_mm), of_plate=of_plate)
    return depart(prior, scene.solid, scene.contact.width_mm, layout_mm, departures)


def recorded(
    metadata: Metadata,
    real: Imperfections,
    rng: np.random.Generator,
    *,
    count: int = 10,
    hand_mm: float = 0.0,
    anywhere: bool = False,
) -> Loads:
    """Loads as `read_loads` has them, of the middle force and evenly over the beam, or anywhere within all ranges.

    On a plate, `count` is the number along each axis of a grid over it.

    `hand_mm` is the standard deviation of their true positions from the stated ones.
    """
    extent = metadata.extent
    said = grid_of(
        [np.linspace(0.95 * low + 0.05 * high, 0.05 * low + 0.95 * high, count) for low, high in extent.ranges_mm]
    )
    count = len(said)
    force = np.full(count, np.mean(metadata.ranges.force_n))
    if anywhere:
        said = np.sort(rng.uniform(extent.low_mm, extent.high_mm, (count, extent.axes)), axis=0)
        force = rng.uniform(*metadata.ranges.force_n, count)
    true = np.clip(said + hand_mm * rng.normal(size=said.shape), extent.low_mm, extent.high_mm)
    pressed = force * (1 + FORCE_PER_MM * hand_mm * rng.normal(size=count))
    prior = true_prior(metadata, real)
    clean = prior.measured(pressed[:, None] * prior.influence_at(true))
    deviation = metadata.noise.reading_mm / np.sqrt(SAMPLES)
    first = np.arange(count) * SAMPLES + 2
    return Loads(
        number=np.arange(1, count + 1),
        place_mm=said,
        force_n=force,
        measured_mm=clean + rng.normal(scale=deviation, size=clean.shape),
        deviation_mm=np.full(clean.shape, deviation),
        lines=np.stack([first, first + SAMPLES - 1], axis=1),
        minutes=np.linspace(0.0, SESSION_MIN, count),
    )


def with_mistake(
    mistake: str, loads: Loads, range_mm: tuple[float, float], rng: np.random.Generator
) -> tuple[Floats, Floats, int]:
    """Places and forces of which one is mistyped, and which; a place is so along the first axis."""
    place, force = loads.place_mm.copy(), loads.force_n.copy()
    position = place[:, 0]
    size = float(mistake.split(maxsplit=1)[0])
    row = int(rng.integers(len(position)))
    if mistake.endswith("force"):
        force[row] *= size
        return place, force, row
    moved = position[row] + size * rng.choice([-1, 1])
    position[row] = moved if range_mm[0] <= moved <= range_mm[1] else 2 * position[row] - moved
    return place, force, row


def deflections_on(
    metadata: Metadata, real: Imperfections, position_mm: Floats = POSITIONS, force_n: Floats = FORCES
) -> Floats:
    """Return what the sensors of a real surface measure of loads, without noise: (loads, channels) in mm."""
    prior = true_prior(metadata, real)
    measured_mm: Floats = prior.measured(force_n[:, None] * prior.influence_at(on_axis(position_mm)))
    return measured_mm
