"""Surfaces that differ from their scenes, for tests of calibration: the rig's own formulas, without its line."""

import csv
from pathlib import Path

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.metadata import Metadata
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.rig.surface import Imperfections
from beamtouch_models.scene import parse_scene
from beamtouch_models.surface import depart

POSITIONS = np.linspace(20.0, 380.0, 10)
FORCES = np.full(10, 12.0)
SAMPLES = 200
"""Samples of each load in a recording."""


def imperfections(seed: int, metadata: Metadata) -> Imperfections:
    """Sensors 1 mm off, gains 3 % off, one end 5 % fixed, a characteristic that bends 1.5 % at full travel."""
    rng = np.random.default_rng(seed)
    channels = len(metadata.layout)
    return Imperfections(
        position_offset_mm=tuple(rng.choice([-1.0, 1.0], channels).tolist()),
        gain=tuple((1 + rng.choice([-0.03, 0.03], channels)).tolist()),
        curve_per_mm=float(rng.choice([-1, 1]) * 0.015 / metadata.max_deflection_mm),
        fixity=(0.05, 0.0) if rng.random() < 0.5 else (0.0, 0.05),
    )


def true_prior(metadata: Metadata, real: Imperfections) -> Prior:
    """What an estimator would know that knew everything of the real surface."""
    scene, layout_mm = parse_scene(metadata.scene, metadata.name), metadata.layout_mm
    prior = Prior.of(influence_of(scene), layout_mm, metadata.noise.sample_mm)
    return depart(prior, scene.beam, scene.contact.width_mm, layout_mm, real.departures(len(layout_mm)))


def write_readings(
    path: Path, metadata: Metadata, prior: Prior, position_mm: Floats, force_n: Floats, *, seed: int
) -> None:
    """Write what `record` would: samples of each load, with the noise of a reading in each."""
    rng = np.random.default_rng(seed)
    names = [channel.name for channel in metadata.layout]
    clean = prior.measured(force_n[:, None] * prior.influence_at(position_mm))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = ("counts", "deflection_mm", "quality")
        writer.writerow(
            ["unix_time_s", "load", "position_mm", "force_n", *(f"{n}_{column}" for n in names for column in columns)]
        )
        for load, (position, force, row) in enumerate(zip(position_mm, force_n, clean, strict=True), start=1):
            for _ in range(SAMPLES):
                noisy = row + rng.normal(scale=metadata.noise.reading_mm, size=row.shape)
                cells = [cell for value in noisy for cell in (1000, f"{value:.7g}", "good")]
                writer.writerow([0.0, load, position, force, *cells])


def readings(tmp_path: Path, model: ModelFile, real: Imperfections, *, seed: int = 1, **others: Floats) -> Path:
    """Write the recording of ten loads on a surface, by default evenly spaced with 12 N each, and return its file."""
    path = tmp_path / "loads.csv"
    position, force = others.get("position", POSITIONS), others.get("force", FORCES)
    write_readings(path, model.metadata, true_prior(model.metadata, real), position, force, seed=seed)
    return path
