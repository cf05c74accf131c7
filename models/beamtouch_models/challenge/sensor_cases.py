"""Contacts measured while all sensors are in error: gains, zeros and positions."""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.challenge.play import Case, Drawn, Play
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
    cases = [Case(percent / 100 <= gain + 1e-9, partial(gains_off, percent=percent)) for percent in GAINS_PERCENT]
    cases += [Case(noises * noise_mm <= zero_mm + 1e-9, partial(zeros_off, noises=noises)) for noises in ZEROS]
    return [*cases, Case(surface.scene.sensors.mounting_tolerance_mm >= OFF_MM, places_off)]


def gains_off(at: Drawn, *, percent: float) -> Play:
    """Return contacts measured with gains that are off by some percent, as a standard deviation."""
    off = 1 + percent / 100 * _normal(at)
    errors, fault = replace(at.honest, gain=off), replace(at.perfect, gain=off)
    return at.settle(f"gains {percent:g} % off", errors=errors, fault=fault)


def zeros_off(at: Drawn, *, noises: float) -> Play:
    """Return contacts measured with zeros that are off by some noises of a reading, as a standard deviation."""
    off_mm = noises * at.surface.metadata.noise.reading_mm * _normal(at)
    errors, fault = replace(at.honest, zero_mm=off_mm), replace(at.perfect, zero_mm=off_mm)
    return at.settle(f"zeros {noises:g} noises off", errors=errors, fault=fault)


def _normal(at: Drawn) -> Floats:
    """Return a standard normal number for each channel of each draw."""
    return at.rng.normal(size=at.honest.gain.shape)


def places_off(at: Drawn) -> Play:
    """Return contacts on sensors that are mounted beside their positions."""
    world, width_mm = at.surface.world, at.surface.scene.contact.width_mm
    sensors_mm = np.clip(world.sensor_mm + OFF_MM * _normal(at), 0.0, world.beam.length_mm)
    each = zip(sensors_mm, at.position_mm, at.force_n, strict=True)
    clean = np.array([force * influence(world.beam, own, place, width_mm)[0] for own, place, force in each])
    return at.settle(f"positions {OFF_MM:g} mm off", clean, fault=at.perfect)
