"""Contacts with correlated noise, or with noise that the ADC's steps hide: measured by the user, or not."""

from dataclasses import replace

import numpy as np

from beamtouch_models.challenge.play import Play, drawn, settled
from beamtouch_models.challenge.sensors import Stated
from beamtouch_models.challenge.surface import SimulatedSurface
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
        surface, _measured(f"noise correlated by {COLOURED:g}", measured), surface.under(position, force),
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
    rest = surface.readings(np.zeros((draws, TARED, surface.channels)), bare, rng)
    errors = replace(honest, step_mm=step_mm, zero_mm=honest.zero_mm + place_mm, tare_mm=rest.mean(axis=1))
    stated = Stated(
        noise_mm=float(np.hypot(HIDDEN * step_mm, step_mm / np.sqrt(12))),
        zero_mm=float(np.hypot(max(surface.metadata.floor.zero_mm), rounding_of(HIDDEN * step_mm, step_mm))),
        step_mm=step_mm,
    )
    play = settled(
        surface, _measured(f"ADC steps of {COARSE:g} noises", measured), surface.under(position, force), errors,
        truth_mm=position, faulty=surface.perfect(draws),
    )  # fmt: skip
    return replace(play, stated=stated if measured else None)


def _measured(name: str, measured: bool) -> str:
    return name if measured else f"{name}, not stated"
