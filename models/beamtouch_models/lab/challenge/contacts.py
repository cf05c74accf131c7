"""One contact, honestly measured: touches, ringing, motion, forces beyond the range, sensors as the scene states.

Some readings may be lost, in a gap or at random.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.lab.challenge.play import Case, DrawnContacts, Make, Play, SimulatedSurface
from beamtouch_models.lab.challenge.ringing import ringing_plays, rings
from beamtouch_models.places import as_stated

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
LOST_MM_PER_S = 100.0
"""Speed of a load some of whose readings are lost."""


@dataclass(frozen=True)
class Motion:
    """When a load that moves is judged."""

    name: str
    longest_s: float
    """Time that it moves, unless the way is shorter."""
    way: float
    """Longest way, over the range of contacts; on a plate, over the shorter one."""
    parts: tuple[float, ...]
    """Parts of that time at which it is judged."""

    def readings(self, surface: SimulatedSurface, speed_mm_per_s: float, least: int = 0) -> int:
        """Return the number of readings of the motion, at least so many."""
        rate_hz = surface.metadata.sensor.rate_hz
        moving_s = min(self.longest_s, self.way * float(surface.extent.size_mm.min()) / speed_mm_per_s)
        return max(len(self.parts), least, round(moving_s * rate_hz))

    def fits(self, surface: SimulatedSurface, speed_mm_per_s: float, least: int = 0) -> bool:
        """Return whether the range of contacts is long enough for it."""
        rate_hz, shortest_mm = surface.metadata.sensor.rate_hz, float(surface.extent.size_mm.min())
        return speed_mm_per_s * self.readings(surface, speed_mm_per_s, least) / rate_hz <= shortest_mm


BEGINS = Motion("moves", 0.2, 0.5, (0.2, 0.4, 0.6, 0.8, 1.0))
KEEPS = Motion("keeps moving", 0.5, 0.75, (0.6, 0.7, 0.8, 0.9, 1.0))


def honest_cases(surface: SimulatedSurface) -> list[Case]:
    """Return the cases that the scene allows."""
    makes: list[Make] = [touched, rested]
    if surface.world.modes is not None:
        makes += ringing_plays()
    makes += [
        partial(moves, speed_mm_per_s=float(speed), motion=motion)
        for motion in (BEGINS, KEEPS)
        for speed in SPEEDS_MM_PER_S
        if motion.fits(surface, speed)
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
    return [Case(True, make) for make in makes]


def touched(at: DrawnContacts, *, least: int = 0) -> Play:
    """Return a touch that the beam follows at once, between two readings; at least so many readings follow it."""
    before = at.surface.look_back
    there = np.arange(before + max(before, least)) >= before
    return Play(
        deflection_mm=at.deflection_mm[:, None] * there[:, None],
        truth_mm=at.where(np.broadcast_to(there, (at.draws, len(there)))),
        errors=at.honest,
        rows=tuple((f"touch, reading {number}", before + number - 1) for number in (1, 2, 3)),
    )


def rested(at: DrawnContacts, *, least: int = 0) -> Play:
    """Return contacts that have settled; so many readings follow those that the filter looks back at."""
    play = at.settle("touch, settled")
    return replace(
        play,
        quiet=True,
        deflection_mm=np.pad(play.deflection_mm, ((0, 0), (0, least), (0, 0)), "edge"),
        truth_mm=np.pad(play.truth_mm, ((0, 0), (0, least), (0, 0)), "edge"),
        rows=tuple((name, reading + least) for name, reading in play.rows),
    )


def moves(at: DrawnContacts, *, speed_mm_per_s: float, motion: Motion = BEGINS, least: int = 0) -> Play:
    """Return loads that lie still and then move, for at least so many readings; the beam follows with its inertia.

    On a plate, they move straight in any direction.
    """
    surface, extent = at.surface, at.surface.extent
    moving, before = motion.readings(surface, speed_mm_per_s, least), surface.look_back
    step_s = 1 / surface.metadata.sensor.rate_hz / STEPS
    way = speed_mm_per_s * step_s * np.arange(moving * STEPS + 1)[:, None] * at.directions()[:, None]
    path = at.rng.uniform(extent.low_mm, extent.high_mm - way[:, -1], size=(at.draws, extent.axes))[:, None] + way
    mirrored = extent.low_mm + extent.high_mm - path
    path = np.where(at.rng.random((at.draws, extent.axes))[:, None] < 0.5, path, mirrored)
    there = path[:, ::STEPS]
    deflection = surface.under(there, at.force_n[:, None])
    deflection += surface.world.inertia_mm(as_stated(path), at.force_n, step_s)[:, ::STEPS]
    still = np.repeat(deflection[:, :1], before, axis=1)
    judged = [before + round(part * moving) - 1 for part in motion.parts]
    return Play(
        deflection_mm=np.concatenate([still, deflection[:, 1:]], axis=1),
        truth_mm=np.concatenate([np.repeat(there[:, :1], before, axis=1), there[:, 1:]], axis=1),
        errors=at.honest,
        rows=tuple((f"{motion.name} at {speed_mm_per_s:.0f} mm/s", reading) for reading in judged),
        crosses=_crosses(surface, path),
    )


def _crosses(surface: SimulatedSurface, path_mm: Floats) -> Bools:
    """Return which paths (draws, steps, axes) cross a support of a beam, (draws,); on a plate none does."""
    held_mm, along_mm = np.array(surface.world.structure.held_mm)[:, None], path_mm[..., 0]
    crossed: Bools = ((along_mm.min(axis=1) < held_mm) & (held_mm < along_mm.max(axis=1))).any(axis=0)
    return crossed


def pressed(at: DrawnContacts, *, times: float, force_n: float) -> Play:
    """Return contacts of some times an end of the stated range of forces."""
    name = f"force {times:g} times the {'smallest' if times < 1 else 'largest'}"
    return at.settle(name, at.surface.under(at.place_mm, np.full(at.draws, times * force_n)))


def without(at: DrawnContacts, *, missing: int) -> Play:
    """Return contacts while some channels, any of them, are missing."""
    order = at.rng.permuted(np.tile(np.arange(at.surface.channels), (at.draws, 1)), axis=1)
    name = "one channel missing" if missing == 1 else "two channels missing"
    return at.settle(name, errors=replace(at.honest, missing=order < missing))


def lossy_cases(surface: SimulatedSurface) -> list[Case]:
    """Return the cases with lost readings that the scene allows."""
    moving = partial(moves, speed_mm_per_s=LOST_MM_PER_S, motion=KEEPS)
    moving_ones = (moving,) if KEEPS.fits(surface, LOST_MM_PER_S) else ()
    ringing = () if surface.world.modes is None else (rings,)
    makes: list[Make] = []
    for gap in GAPS:
        makes += [
            partial(interrupted, make=rested, when="at rest", gap=gap),
            partial(interrupted, make=touched, when="at a touch", gap=gap, since_s=0.0),
            *(partial(interrupted, make=make, when="at a sudden force", gap=gap, since_s=0.0) for make in ringing),
            *(partial(interrupted, make=make, when="while it rings", gap=gap, since_s=RINGING_S) for make in ringing),
        ]
        if KEEPS.fits(surface, LOST_MM_PER_S, gap + AFTER[-1]):
            makes.append(partial(interrupted, make=moving, when="while the load moves", gap=gap))
    for share in LOSSES:
        makes += [partial(lossy, make=make, share=share) for make in (rested, touched, *ringing, *moving_ones)]
    return [Case(True, make) for make in makes]


def interrupted(
    at: DrawnContacts, *, make: Callable[..., Play], when: str, gap: int, since_s: float | None = None
) -> Play:
    """Return a play with a gap.

    Parameters
    ----------
    at : as for all plays
    make, when : makes the play, of at least so many readings since the change of load, and what happens in it
    gap : number of readings that are lost in a row
    since_s : from the change of the load to the gap; None: the gap is as late as the play allows
    """
    since = round((since_s or 0.0) * at.surface.metadata.sensor.rate_hz)
    play = make(at, least=since + gap + AFTER[-1])
    length = play.deflection_mm.shape[1]
    begins = length - gap - AFTER[-1] if since_s is None else at.surface.look_back + since
    lost = np.zeros((at.draws, length), dtype=np.bool_)
    lost[:, begins : begins + gap] = True
    rows = tuple((f"gap of {gap} {when}", begins + gap + number - 1) for number in AFTER)
    return replace(play, quiet=False, lost=lost, rows=rows)  # until it is known again, whether the beam rests


def lossy(at: DrawnContacts, *, make: Make, share: float) -> Play:
    """Return a play of which a share of the readings is lost at random, and none that is judged.

    It has one row for all that is judged.
    """
    play = make(at)
    lost = at.rng.random(play.deflection_mm.shape[:2]) < share
    lost[:, [reading for _, reading in play.rows]] = False
    name, *others = {name for name, _ in play.rows}
    subject = name.partition(",")[0] if others else name
    rows = tuple((f"{subject}, {share:.0%} lost", reading) for _, reading in play.rows)
    return replace(play, rows=rows, lost=lost)
