"""One contact, honestly measured: touches, ringing, motion, forces beyond the range, sensors as the scene states.

Some readings may be lost: in a gap, at random, or because whoever reads the sensors is late.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.challenge.play import Case, Make, Play, drawn, lateness, settled
from beamtouch_models.challenge.sensor_cases import coarse, coloured
from beamtouch_models.challenge.surface import SimulatedSurface

SINCE_MS = (20, 50, 100, 200, 500)
"""Times after the beginning of a load at which a beam that rings is judged."""
RAMP_S = 0.03
SPEEDS_MM_PER_S = (10, 30, 100, 300, 1000)
STEPS = 8
"""Steps per reading in which a moving load is followed: in one of them it hardly moves."""
GAPS = (1, 5, 20)
"""Lengths of gaps, in readings."""
AFTER = (1, 2, 3, 5, 10)
"""Readings after a gap that are judged."""
RINGING_S = 0.1
"""Time from a sudden force to a gap while the beam rings."""
LOSSES = (0.01, 0.1, 0.3)
"""Shares of readings that are lost at random."""
LATE = 0.3
"""Mean lateness of readings, in periods; a reading that is late by a period is lost."""
LOST_MM_PER_S = 100.0
"""Speed of a load some of whose readings are lost."""


@dataclass(frozen=True)
class Motion:
    """When a load that moves is judged."""

    name: str
    longest_s: float
    """Time that it moves, unless the way is shorter."""
    way: float
    """Longest way, over the range of contacts."""
    parts: tuple[float, ...]
    """Parts of that time at which it is judged."""


BEGINS = Motion("moves", 0.2, 0.5, (0.2, 0.4, 0.6, 0.8, 1.0))
KEEPS = Motion("keeps moving", 0.5, 0.75, (0.6, 0.7, 0.8, 0.9, 1.0))


def honest_cases(surface: SimulatedSurface) -> list[Case]:
    """Return the cases that the scene allows."""
    makes: list[Make] = [touched, rested]
    if surface.world.modes is not None:
        makes += [partial(rings, weighs=False), partial(rings, weighs=True), partial(rings, lasting_s=RAMP_S), lifts]
    makes += [
        partial(moves, speed_mm_per_s=float(speed), motion=motion)
        for motion in (BEGINS, KEEPS)
        for speed in SPEEDS_MM_PER_S
        if has_way(surface, speed, motion)
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


def touched(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, least: int = 0) -> Play:
    """Return a touch that the beam follows at once, between two readings; at least so many readings follow it."""
    position, force = drawn(surface, draws, rng)
    before = surface.look_back
    there = np.arange(before + max(before, least)) >= before
    return Play(
        deflection_mm=surface.world.under(position, force)[:, None] * there[:, None],
        truth_mm=np.where(there, position[:, None], np.nan),
        errors=surface.honest(draws, rng),
        rows=tuple((f"touch, reading {number}", before + number - 1) for number in (1, 2, 3)),
    )


def rested(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, least: int = 0) -> Play:
    """Return contacts that have settled; so many readings follow those that the filter looks back at."""
    position, force = drawn(surface, draws, rng)
    errors = surface.honest(draws, rng)
    clean = surface.world.under(position, force)
    play = settled(surface, "touch, settled", clean, errors, truth_mm=position, as_assumed=True)
    return replace(
        play,
        quiet=True,
        deflection_mm=np.pad(play.deflection_mm, ((0, 0), (0, least), (0, 0)), "edge"),
        truth_mm=np.pad(play.truth_mm, ((0, 0), (0, least)), "edge"),
        rows=tuple((name, reading + least) for name, reading in play.rows),
    )


def rings(
    surface: SimulatedSurface,
    draws: int,
    rng: np.random.Generator,
    *,
    weighs: bool = False,
    lasting_s: float = 0.0,
    late: float = 0.0,
    least: int = 0,
) -> Play:
    """Return loads that set the beam ringing: a force, or a weight that swings with it, at once or growing evenly.

    `late` is the mean lateness of the readings, in periods. At least so many of them follow the change of load.
    """
    position, force = drawn(surface, draws, rng)
    before, readings, seconds = _since(surface, draws, rng, least)
    periods, lost = lateness(draws, seconds.shape[1], late, rng, [before + reading for reading in readings])
    seconds = seconds + periods / surface.metadata.sensor.rate_hz
    grown = np.clip(seconds / lasting_s, 0.0, 1.0) if lasting_s else (seconds >= 0).astype(np.float64)
    kind = "weight laid on" if weighs else f"force in {1e3 * lasting_s:.0f} ms" if lasting_s else "sudden force"
    ringing = surface.world.ringing_mm(position, force, seconds, weighs=weighs, lasting_s=lasting_s)
    return Play(
        deflection_mm=surface.world.under(position, force)[:, None] * grown[:, :, None] + ringing,
        truth_mm=np.where(seconds >= 0, position[:, None], np.nan),
        errors=surface.honest(draws, rng),
        rows=tuple((f"{kind}, {ms} ms", before + reading) for ms, reading in zip(SINCE_MS, readings, strict=True)),
        lost=lost,
    )


def lifts(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return forces that end at once: the beam rings, and nothing touches it once the filter has had its time."""
    position, force = drawn(surface, draws, rng)
    before, readings, seconds = _since(surface, draws, rng)
    still = surface.world.under(position, force)[:, None] * (seconds < 0)[:, :, None]
    ringing = surface.world.ringing_mm(position, force, seconds)
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


def _since(
    surface: SimulatedSurface, draws: int, rng: np.random.Generator, least: int = 0
) -> tuple[int, list[int], Floats]:
    """Return the readings before a change of load, those after it that are judged, and all times since it in s.

    At least so many readings follow the change.
    """
    rate_hz, before = surface.metadata.sensor.rate_hz, surface.look_back
    readings = [max(0, round(ms * 1e-3 * rate_hz - 0.5)) for ms in SINCE_MS]
    return before, readings, (np.arange(-before, max(readings[-1] + 1, least)) + rng.uniform(size=(draws, 1))) / rate_hz


def moves(
    surface: SimulatedSurface,
    draws: int,
    rng: np.random.Generator,
    *,
    speed_mm_per_s: float,
    motion: Motion = BEGINS,
    late: float = 0.0,
    least: int = 0,
) -> Play:
    """Return loads that lie still and then move; the beam follows with its inertia.

    `late` is the mean lateness of the readings of the motion, in periods. There are at least so many of them.
    """
    low, high = surface.metadata.ranges.position_mm
    rate_hz, before = surface.metadata.sensor.rate_hz, surface.look_back
    moving = _readings_of(surface, speed_mm_per_s, motion, least)
    step_s = 1 / rate_hz / STEPS
    way = speed_mm_per_s * step_s * np.arange(moving * STEPS + 1)
    start = rng.uniform(low, high - way[-1], size=draws)
    path = start[:, None] + way
    path = np.where(rng.random((draws, 1)) < 0.5, path, low + high - path)
    force = drawn(surface, draws, rng)[1]
    judged = [round(part * moving) for part in motion.parts]
    periods, lost = lateness(draws, moving + 1, late, rng, judged)
    steps = np.minimum(STEPS * np.arange(moving + 1) + np.floor(STEPS * periods).astype(np.intp), STEPS * moving)
    there = np.take_along_axis(path, np.broadcast_to(steps, (draws, moving + 1)), axis=1)
    moved = surface.world.under(path, np.broadcast_to(force[:, None], path.shape))
    moved += surface.world.inertia_mm(path, force, step_s)
    deflection = np.take_along_axis(moved, steps[:, :, None], axis=1)
    still = np.repeat(deflection[:, :1], before, axis=1)
    return Play(
        deflection_mm=np.concatenate([still, deflection[:, 1:]], axis=1),
        truth_mm=np.concatenate([np.repeat(path[:, :1], before, axis=1), there[:, 1:]], axis=1),
        errors=surface.honest(draws, rng),
        rows=tuple((f"{motion.name} at {speed_mm_per_s:.0f} mm/s", before + number - 1) for number in judged),
        crosses=_crosses(surface, path),
        lost=None if lost is None else np.pad(lost[:, 1:], ((0, 0), (before, 0))),
    )


def has_way(surface: SimulatedSurface, speed_mm_per_s: float, motion: Motion, least: int = 0) -> bool:
    """Return whether the range of contacts is as long as a motion of so many readings at least."""
    low, high = surface.metadata.ranges.position_mm
    moving_s = _readings_of(surface, speed_mm_per_s, motion, least) / surface.metadata.sensor.rate_hz
    return speed_mm_per_s * moving_s <= high - low


def _readings_of(surface: SimulatedSurface, speed_mm_per_s: float, motion: Motion, least: int) -> int:
    """Return the number of readings of a motion."""
    low, high = surface.metadata.ranges.position_mm
    moving_s = min(motion.longest_s, motion.way * (high - low) / speed_mm_per_s)
    return max(len(motion.parts), least, round(moving_s * surface.metadata.sensor.rate_hz))


def _crosses(surface: SimulatedSurface, path_mm: Floats) -> Bools:
    """Return which paths (draws, steps) cross a support, (draws,)."""
    supports_mm = np.array([support.at_mm for support in surface.world.beam.support_list])[:, None]
    crossed: Bools = ((path_mm.min(axis=1) < supports_mm) & (supports_mm < path_mm.max(axis=1))).any(axis=0)
    return crossed


def pressed(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, times: float, force_n: float) -> Play:
    """Return contacts of some times an end of the stated range of forces."""
    position, _ = drawn(surface, draws, rng)
    clean = surface.world.under(position, np.full(draws, times * force_n))
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
    return settled(surface, name, surface.world.under(position, force), errors, truth_mm=position, as_assumed=True)


def lossy_cases(surface: SimulatedSurface) -> list[Case]:
    """Return the cases that the scene allows."""
    moving = partial(moves, speed_mm_per_s=LOST_MM_PER_S, motion=KEEPS)
    moving_ones = (moving,) if has_way(surface, LOST_MM_PER_S, KEEPS) else ()
    ringing = () if surface.world.modes is None else (rings,)
    found: list[Make] = []
    for gap in GAPS:
        found += [
            partial(interrupted, make=rested, when="at rest", gap=gap),
            partial(interrupted, make=touched, when="at a touch", gap=gap, since_s=0.0),
            *(partial(interrupted, make=make, when="at a sudden force", gap=gap, since_s=0.0) for make in ringing),
            *(partial(interrupted, make=make, when="while it rings", gap=gap, since_s=RINGING_S) for make in ringing),
        ]
        if has_way(surface, LOST_MM_PER_S, KEEPS, gap + AFTER[-1]):
            found.append(partial(interrupted, make=moving, when="while the load moves", gap=gap))
    for share in LOSSES:
        found += [partial(lossy, make=make, share=share) for make in (rested, touched, *ringing, *moving_ones)]
    found += [partial(late, make=partial(make, late=LATE)) for make in (*ringing, *moving_ones)]
    return [Case(True, make) for make in found]


def interrupted(
    surface: SimulatedSurface,
    draws: int,
    rng: np.random.Generator,
    *,
    make: Callable[..., Play],
    when: str,
    gap: int,
    since_s: float | None = None,
) -> Play:
    """Return a course with a gap.

    Parameters
    ----------
    surface, draws, rng : as for all courses
    make, when : makes the course, of at least so many readings since the change of load, and what happens in it
    gap : number of readings that are lost in a row
    since_s : from the change of the load to the gap; None: the gap is as late as the course allows
    """
    since = round((since_s or 0.0) * surface.metadata.sensor.rate_hz)
    play = make(surface, draws, rng, least=since + gap + AFTER[-1])
    length = play.deflection_mm.shape[1]
    begins = length - gap - AFTER[-1] if since_s is None else surface.look_back + since
    gone = np.zeros((draws, length), dtype=np.bool_)
    gone[:, begins : begins + gap] = True
    name = f"gap of {gap} {when}"
    longest = surface.metadata.filter.max_readings
    return replace(
        play,
        quiet=False,  # until it is known again, whether the beam rests
        lost=gone,
        came=max(1, longest - gap) / longest,
        rows=tuple((name, begins + gap + number - 1) for number in AFTER),
    )


def lossy(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, make: Make, share: float) -> Play:
    """Return a course of which a share of the readings is lost at random, and none that is judged."""
    play = make(surface, draws, rng)
    gone = rng.random(play.deflection_mm.shape[:2]) < share
    gone[:, [reading for _, reading in play.rows]] = False
    return replace(_renamed(play, f"{share:.0%} lost"), lost=gone, came=1 - share)


def late(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, make: Make) -> Play:
    """Return a course whose readings come late, as it is made."""
    return _renamed(make(surface, draws, rng), "readings late")


def _renamed(play: Play, how: str) -> Play:
    """Return a course with one row for all that is judged."""
    names = list(dict.fromkeys(name for name, _ in play.rows))
    subject = names[0] if len(names) == 1 else names[0].split(",")[0]
    return replace(play, rows=tuple((f"{subject}, {how}", reading) for _, reading in play.rows))
