"""Contacts measured while all sensors are in error: gains, zeros, positions, and noise that the model ignores."""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from beamtouch_models.challenge.noises import coarse, coloured
from beamtouch_models.challenge.play import Case, Play, drawn, settled
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.physics.beam import influence

GAINS_PERCENT = (0.3, 1.0, 3.0)
ZEROS = (0.2, 1.0, 3.0, 10.0)
"""Zeros over the noise of a reading."""
OFF_MM = 1.0
"""Standard deviation of the positions of the sensors."""


def error_cases(surface: SimulatedSurface) -> list[Case]:
    """Return contacts with errors of all sensors; honest where they are within what the model states."""
    gain, zero_mm = float(surface.gain.min()), float(surface.zero_mm.min())
    noise_mm = surface.metadata.noise.reading_mm
    found = [Case(percent / 100 <= gain + 1e-9, partial(gains_off, percent=percent)) for percent in GAINS_PERCENT]
    found += [Case(noises * noise_mm <= zero_mm + 1e-9, partial(zeros_off, noises=noises)) for noises in ZEROS]
    found += [Case(False, partial(make, measured=False)) for make in (coloured, coarse)]
    return [*found, Case(surface.scene.sensors.mounting_tolerance_mm >= OFF_MM, places_off)]


def gains_off(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, percent: float) -> Play:
    """Return contacts measured with gains that are off by some percent, as a standard deviation."""
    return _all_off(surface, f"gains {percent:g} % off", draws, rng, "gain", percent / 100)


def zeros_off(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, noises: float) -> Play:
    """Return contacts measured with zeros that are off by some noises of a reading, as a standard deviation."""
    deviation_mm = noises * surface.metadata.noise.reading_mm
    return _all_off(surface, f"zeros {noises:g} noises off", draws, rng, "zero_mm", deviation_mm)


def _all_off(
    surface: SimulatedSurface,
    name: str,
    draws: int,
    rng: np.random.Generator,
    kind: Literal["gain", "zero_mm"],
    deviation: float,
) -> Play:
    """Return settled contacts while one kind of error has another deviation in all sensors."""
    position, force = drawn(surface, draws, rng)
    honest, perfect = surface.honest(draws, rng), surface.perfect(draws)
    off = {kind: getattr(perfect, kind) + deviation * rng.normal(size=perfect.gain.shape)}
    return settled(
        surface, name, surface.under(position, force), replace(honest, **off),
        truth_mm=position, faulty=replace(perfect, **off), as_assumed=True,
    )  # fmt: skip


def places_off(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return contacts on sensors that are mounted beside their positions."""
    position, force = drawn(surface, draws, rng)
    clean = np.empty((draws, surface.channels))
    for index, (load_mm, load_n) in enumerate(zip(position, force, strict=True)):
        true_mm = surface.sensor_mm + OFF_MM * rng.normal(size=surface.channels)
        sensor_mm = np.clip(true_mm, 0.0, surface.beam.length_mm)
        clean[index] = load_n * influence(surface.beam, sensor_mm, load_mm, surface.scene.contact.width_mm)[0]
    return settled(
        surface, f"positions {OFF_MM:g} mm off", clean, surface.honest(draws, rng), truth_mm=position,
        faulty=surface.perfect(draws),
    )  # fmt: skip
