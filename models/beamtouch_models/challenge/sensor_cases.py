"""Contacts measured while all sensors are in error: gains, zeros, positions, and noise that the model does not expect.

Such noise is correlated, or the ADC's steps hide it; the user has measured it, or the model ignores it.
"""

from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np

from beamtouch_models.challenge.play import Case, Play, drawn, settled
from beamtouch_models.challenge.surface import SimulatedSurface, Stated
from beamtouch_models.physics.beam import influence
from beamtouch_models.pricing.noise import rounding_of

COLOURED = 0.7
"""Correlation of the noise of consecutive readings."""
COARSE = 3.0
"""Step of a coarse ADC over the noise."""
HIDDEN = 0.02
"""Noise that `beamtouch-daemon noise` states where the steps hide it, in steps: `HIDDEN` of its module `noise`."""
TARED = 100
"""Readings of a tare."""


def coloured(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, measured: bool) -> Play:
    """Return contacts with noise that is correlated in time; `measured`: the user states it as `noise` prints it."""
    position, force = drawn(surface, draws, rng)
    metadata = surface.metadata
    stated = Stated(
        noise_mm=metadata.noise.reading_mm * coloured_times(COLOURED, metadata.filter.max_readings),
        zero_mm=max(metadata.floor.zero_mm),
        step_mm=metadata.sensor.gain_mm_per_count,
    )
    play = settled(
        surface, _measured(f"noise correlated by {COLOURED:g}", measured), surface.world.under(position, force),
        replace(surface.honest(draws, rng), correlation=COLOURED), truth_mm=position, faulty=surface.perfect(draws),
    )  # fmt: skip
    return replace(play, stated=stated if measured else None)


def coloured_times(correlation: float, window: int) -> float:
    """Return the noise of a mean of `window` readings of AR(1) noise, over that of white noise.

    Readings that are k apart have the correlation r^k, and the mean holds window - k such pairs.
    """
    apart = np.arange(1, window)
    return float(np.sqrt(1 + 2 * np.sum((1 - apart / window) * correlation**apart)))


def coarse(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, measured: bool) -> Play:
    """Return contacts measured with an ADC that is coarser than the noise; `measured` as above.

    The noise is hidden by the steps, so that `noise` states hardly any, and all of the rounding. The gaps at rest have
    any place between two counts, and the tare is rounded as well.
    """
    position, force = drawn(surface, draws, rng)
    noise_mm, honest = surface.metadata.noise.reading_mm, surface.honest(draws, rng)
    step_mm = COARSE * noise_mm
    place_mm = rng.uniform(-0.5, 0.5, honest.gain.shape) * step_mm
    bare = replace(surface.perfect(draws), step_mm=step_mm, zero_mm=place_mm)
    rest = surface.world.readings(np.zeros((draws, TARED, surface.channels)), bare, rng)
    errors = replace(honest, step_mm=step_mm, zero_mm=honest.zero_mm + place_mm, tare_mm=rest.mean(axis=1))
    stated = Stated(
        noise_mm=float(np.hypot(HIDDEN * step_mm, step_mm / np.sqrt(12))),
        zero_mm=float(np.hypot(max(surface.metadata.floor.zero_mm), rounding_of(HIDDEN * step_mm, step_mm))),
        step_mm=step_mm,
    )
    play = settled(
        surface, _measured(f"ADC steps of {COARSE:g} noises", measured), surface.world.under(position, force), errors,
        truth_mm=position, faulty=surface.perfect(draws),
    )  # fmt: skip
    return replace(play, stated=stated if measured else None)


def _measured(name: str, measured: bool) -> str:
    return name if measured else f"{name}, not stated"


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
        surface, name, surface.world.under(position, force), replace(honest, **off),
        truth_mm=position, faulty=replace(perfect, **off), as_assumed=True,
    )  # fmt: skip


def places_off(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return contacts on sensors that are mounted beside their positions."""
    position, force = drawn(surface, draws, rng)
    clean = np.empty((draws, surface.channels))
    for index, (load_mm, load_n) in enumerate(zip(position, force, strict=True)):
        true_mm = surface.world.sensor_mm + OFF_MM * rng.normal(size=surface.channels)
        sensor_mm = np.clip(true_mm, 0.0, surface.world.beam.length_mm)
        clean[index] = load_n * influence(surface.world.beam, sensor_mm, load_mm, surface.scene.contact.width_mm)[0]
    return settled(
        surface, f"positions {OFF_MM:g} mm off", clean, surface.honest(draws, rng), truth_mm=position,
        faulty=surface.perfect(draws),
    )  # fmt: skip
