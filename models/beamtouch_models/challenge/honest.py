"""One contact, honestly measured: touches, ringing, motion, forces beyond the range, sensors as the scene states."""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.challenge.motion import BEGINS, KEEPS, SPEEDS_MM_PER_S, moves
from beamtouch_models.challenge.play import Case, Make, Play, drawn, lateness, settled
from beamtouch_models.challenge.sensor_cases import coarse, coloured
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.physics.motion import GRAVITY, Swings, damping_of, swings

SINCE_MS = (20, 50, 100, 200, 500)
"""Times after the beginning of a load at which a beam that rings is judged."""
RAMP_S = 0.03


def honest_cases(surface: SimulatedSurface) -> list[Case]:
    """Return the cases that the scene allows."""
    makes: list[Make] = [touched, rested]
    if surface.modes is not None:
        makes += [partial(rings, weighs=False), partial(rings, weighs=True), partial(rings, lasting_s=RAMP_S), lifts]
    makes += [
        partial(moves, speed_mm_per_s=float(speed), motion=motion)
        for motion in (BEGINS, KEEPS)
        for speed in SPEEDS_MM_PER_S
    ]
    low, high = surface.metadata.ranges.force_n
    makes += [
        partial(pressed, times=times, force_n=force) for times, force in ((0.3, low), (1.1, high), (2, high), (5, high))
    ]
    makes += [
        partial(without, missing=number)
        for number in (1, 2)
        if surface.channels - number >= surface.metadata.min_channels
    ]
    makes += [partial(coloured, measured=True), partial(coarse, measured=True)]
    return [Case(True, make) for make in makes]


def touched(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return a touch that the beam follows at once, between two readings."""
    position, force = drawn(surface, draws, rng)
    before = surface.look_back
    there = np.arange(2 * before) >= before
    return Play(
        deflection_mm=surface.under(position, force)[:, None] * there[:, None],
        truth_mm=np.where(there, position[:, None], np.nan),
        errors=surface.honest(draws, rng),
        rows=tuple((f"touch, reading {number}", before + number - 1) for number in (1, 2, 3)),
    )


def rested(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return contacts that have settled."""
    position, force = drawn(surface, draws, rng)
    errors = surface.honest(draws, rng)
    clean = surface.under(position, force)
    play = settled(surface, "touch, settled", clean, errors, truth_mm=position, as_assumed=True)
    return replace(play, quiet=True)


def rings(
    surface: SimulatedSurface,
    draws: int,
    rng: np.random.Generator,
    *,
    weighs: bool = False,
    lasting_s: float = 0.0,
    late: float = 0.0,
) -> Play:
    """Return loads that set the beam ringing: a force, or a weight that swings with it, at once or growing evenly.

    `late` is the mean lateness of the readings, in periods.
    """
    position, force = drawn(surface, draws, rng)
    before, readings, seconds = _since(surface, draws, rng)
    periods, lost = lateness(draws, seconds.shape[1], late, rng, [before + reading for reading in readings])
    seconds = seconds + periods / surface.metadata.sensor.rate_hz
    grown = np.clip(seconds / lasting_s, 0.0, 1.0) if lasting_s else (seconds >= 0).astype(np.float64)
    kind = "weight laid on" if weighs else f"force in {1e3 * lasting_s:.0f} ms" if lasting_s else "sudden force"
    ringing = _swings(surface, position, force, weighs=weighs).ringing_mm(seconds, damping_of(surface.beam), lasting_s)
    return Play(
        deflection_mm=surface.under(position, force)[:, None] * grown[:, :, None] + ringing,
        truth_mm=np.where(seconds >= 0, position[:, None], np.nan),
        errors=surface.honest(draws, rng),
        rows=tuple((f"{kind}, {ms} ms", before + reading) for ms, reading in zip(SINCE_MS, readings, strict=True)),
        lost=lost,
    )


def lifts(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return forces that end at once: the beam rings, and nothing touches it once the filter has had its time."""
    position, force = drawn(surface, draws, rng)
    before, readings, seconds = _since(surface, draws, rng)
    still = surface.under(position, force)[:, None] * (seconds < 0)[:, :, None]
    ringing = _swings(surface, position, force, weighs=False).ringing_mm(seconds, damping_of(surface.beam))
    # The scene allows the filter its time.
    told = seconds < surface.metadata.filter.settling_ms * 1e-3
    return Play(
        deflection_mm=still - ringing,
        truth_mm=np.where(told, position[:, None], np.nan),
        errors=surface.honest(draws, rng),
        rows=tuple(
            (f"after a lift, {ms} ms", before + reading) for ms, reading in zip(SINCE_MS, readings, strict=True)
        ),
    )


def _since(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> tuple[int, list[int], Floats]:
    """Return the readings before a change of load, those after it that are judged, and all times since it in s."""
    rate_hz, before = surface.metadata.sensor.rate_hz, surface.look_back
    readings = [max(0, round(ms * 1e-3 * rate_hz - 0.5)) for ms in SINCE_MS]
    return before, readings, (np.arange(-before, readings[-1] + 1) + rng.uniform(size=(draws, 1))) / rate_hz


def _swings(surface: SimulatedSurface, position_mm: Floats, force_n: Floats, *, weighs: bool) -> Swings:
    """Return the oscillators of the beam under loads."""
    modes = surface.modes
    if modes is None:
        message = "a beam without a mass does not ring"
        raise ValueError(message)
    weight_kg = force_n / GRAVITY * weighs
    return swings(modes.at(surface.sensor_mm), modes.under(position_mm), modes.square_s2, force_n, weight_kg)


def pressed(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, times: float, force_n: float) -> Play:
    """Return contacts of some times an end of the stated range of forces."""
    position, _ = drawn(surface, draws, rng)
    clean = surface.under(position, np.full(draws, times * force_n))
    name = f"force {times:g} times the {'smallest' if times < 1 else 'largest'}"
    play = settled(surface, name, clean, surface.honest(draws, rng), truth_mm=position, as_assumed=True)
    return replace(play, any_force=True)


def without(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, missing: int) -> Play:
    """Return contacts while some channels, any of them, are missing."""
    position, force = drawn(surface, draws, rng)
    errors = surface.honest(draws, rng)
    order = rng.permuted(np.tile(np.arange(surface.channels), (draws, 1)), axis=1)
    errors = replace(errors, missing=order < missing)
    name = "one channel missing" if missing == 1 else "two channels missing"
    return settled(surface, name, surface.under(position, force), errors, truth_mm=position, as_assumed=True)
