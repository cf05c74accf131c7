"""Files for `calibrate`, as `record` and the service write them."""

import csv
from pathlib import Path

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime import ModelFile
from support.surfaces.real_surfaces import FORCES, POSITIONS, SAMPLES


def write_readings(
    path: Path, model: ModelFile, deflection_mm: Floats, position_mm: Floats = POSITIONS, force_n: Floats = FORCES
) -> Path:
    """Write samples of loads with these deflections (loads, channels) and the noise of a reading; returns the path."""
    rng, noise_mm = np.random.default_rng(1), model.metadata.noise.reading_mm
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = [f"{name}_{end}" for name in model.channels for end in ("counts", "deflection_mm", "quality")]
        writer.writerow(["unix_time_s", "load", "position_mm", "force_n", *columns])
        for load, (position, force, row) in enumerate(zip(position_mm, force_n, deflection_mm, strict=True), start=1):
            for _ in range(SAMPLES):
                noisy = row + rng.normal(scale=noise_mm, size=row.shape)
                cells = [cell for value in noisy for cell in (1000, f"{value:.7g}", "good")]
                writer.writerow([0.0, load, position, force, *cells])
    return path


def write_contacts(path: Path, model: ModelFile, measured_mm: Floats, deviation_mm: Floats) -> Path:
    """Write contacts (contacts, channels) of unknown place and force, one per second; returns the path."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        columns = [f"{name}_{end}" for end in ("mm", "sd_mm") for name in model.channels]
        writer.writerow(["event", "time", "model", "characteristic", "readings", *columns])
        for number, row in enumerate(np.concatenate([measured_mm, deviation_mm], axis=1), start=1):
            time = f"2026-11-22T{number // 3600:02}:{number // 60 % 60:02}:{number % 60:02}.000Z"
            writer.writerow([number, time, model.identity, "a1", 4, *(f"{value:.9f}" for value in row)])
    return path
