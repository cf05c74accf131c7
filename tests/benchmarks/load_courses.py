"""Courses of loads that move on a simulated surface, and the deflections of the beam that follows them."""

from collections.abc import Callable
from functools import partial

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.challenge.motion import inertia_mm
from beamtouch_models.challenge.play import drawn
from beamtouch_models.challenge.surface import SimulatedSurface

SPEEDS_MM_PER_S = (3, 10, 30, 100, 300, 1000)
LYING_S = 0.4
"""Time that a load lies still before it moves."""
MOVES_S = 0.6
STEPS = 8
"""Steps per reading in which the inertia of the beam is followed."""
FOLLOWED = ("moves", "slide", "swings")
"""Beginnings of the names of courses whose inertia counts."""
Course = Callable[[SimulatedSurface, int, np.random.Generator], tuple[Floats, Floats, Bools]]
"""Position and force at each reading of each draw, NaN without a contact, and which readings are judged."""


def courses() -> dict[str, Course]:
    """Return the courses of moving loads."""
    found: dict[str, Course] = {f"moves at {speed} mm/s": partial(slides, speed=speed) for speed in SPEEDS_MM_PER_S}
    found |= {"slide and stop": partial(slides, speed=100, stops=True), "swings": swings, "steps of force": force_steps}
    return found | {"chatters": chatters, "rests after a period": rests}


def slides(
    surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, speed: float, stops: bool = False
) -> tuple[Floats, Floats, Bools]:
    """Return loads that lie still, move, and stop."""
    low, high = surface.metadata.ranges.position_mm
    rate_hz = surface.metadata.sensor.rate_hz
    lying = round(LYING_S * rate_hz)
    moving = max(2, round(min(MOVES_S / (2 if stops else 1), 0.5 * (high - low) / speed) * rate_hz))
    after = round(MOVES_S * rate_hz) if stops else 0
    way = np.clip(np.arange(lying + moving + after) - lying + 1, 0, moving) * speed / rate_hz
    path = rng.uniform(low, high - way[-1], size=draws)[:, None] + way
    path = np.where(rng.random((draws, 1)) < 0.5, path, low + high - path)
    force = np.repeat(drawn(surface, draws, rng)[1][:, None], len(way), axis=1)
    judged = np.arange(len(way)) >= (lying + moving if stops else lying)
    return path, force, judged


def swings(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
    """Return loads that swing to and fro."""
    low, high = surface.metadata.ranges.position_mm
    rate_hz, amplitude = surface.metadata.sensor.rate_hz, 0.025 * (high - low)
    time = np.arange(round(1.4 * rate_hz)) / rate_hz
    phase = 2 * np.pi * (time * rng.uniform(0.5, 2, size=(draws, 1)) + rng.uniform(size=(draws, 1)))
    path = rng.uniform(low + amplitude, high - amplitude, size=(draws, 1)) + amplitude * np.sin(phase)
    return path, np.repeat(drawn(surface, draws, rng)[1][:, None], len(time), axis=1), time >= LYING_S


def force_steps(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
    """Return loads at one place whose force changes every 0.1 s."""
    rate_hz = surface.metadata.sensor.rate_hz
    each, count = round(0.1 * rate_hz), 12
    path = np.repeat(drawn(surface, draws, rng)[0][:, None], each * count, axis=1)
    force = np.repeat(rng.uniform(*surface.metadata.ranges.force_n, size=(draws, count)), each, axis=1)
    return path, force, np.arange(each * count) >= 2 * each


def chatters(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
    """Return loads that come and go, for 20 to 120 ms each."""
    rate_hz = surface.metadata.sensor.rate_hz
    readings = round(1.4 * rate_hz)
    lasting = rng.uniform(0.02, 0.12, size=(draws, 100)).cumsum(axis=1)
    time = np.arange(readings) / rate_hz
    there = np.array([np.searchsorted(one, time) % 2 == 1 for one in lasting])
    position, force = drawn(surface, draws, rng)
    return np.where(there, position[:, None], np.nan), np.where(there, force[:, None], 0.0), time >= LYING_S


def rests(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Bools]:
    """Return loads that have rested for the slowest period of the beam."""
    position, force = drawn(surface, draws, rng)
    rate_hz = surface.metadata.sensor.rate_hz
    readings, begin = round(1.2 * rate_hz), 20
    there = np.arange(readings) >= begin
    judged = np.arange(readings) >= begin + max(surface.slowest_period, 10)
    return np.where(there, position[:, None], np.nan), there * force[:, None], judged


def followed(surface: SimulatedSurface, path: Floats, force: Floats) -> Floats:
    """Return deflections of the beam that follows a load with its inertia."""
    deflection = surface.under(path, force)
    if surface.modes is None or surface.mode_shapes is None:
        return deflection
    readings = np.arange(path.shape[1])
    fine = np.linspace(0, path.shape[1] - 1, (path.shape[1] - 1) * STEPS + 1)
    fine_path = np.array([np.interp(fine, readings, one) for one in path])
    target = surface.mode_shapes(fine_path) * force[:, :1, None]
    step_s = 1 / surface.metadata.sensor.rate_hz / STEPS
    inertia: Floats = inertia_mm(surface.modes, surface.sensor_mm, target, step_s)
    deflection[:, -inertia.shape[1] :] += inertia
    return deflection
