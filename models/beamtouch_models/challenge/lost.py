"""Contacts of which some readings are lost: in a gap, at random, or because whoever reads the sensors is late."""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.challenge.honest import rested, rings, touched
from beamtouch_models.challenge.motion import KEEPS, moves
from beamtouch_models.challenge.play import Case, Make, Play
from beamtouch_models.challenge.surface import SimulatedSurface

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
SPEED_MM_PER_S = 100.0


def lossy_cases(surface: SimulatedSurface) -> list[Case]:
    """Return the cases that the scene allows."""
    moving = partial(moves, speed_mm_per_s=SPEED_MM_PER_S, motion=KEEPS)
    ringing = () if surface.modes is None else (rings,)
    found: list[Make] = []
    for gap in GAPS:
        found += [
            partial(interrupted, make=rested, when="at rest", gap=gap),
            partial(interrupted, make=touched, when="at a touch", gap=gap, since_s=0.0),
            *(partial(interrupted, make=make, when="at a sudden force", gap=gap, since_s=0.0) for make in ringing),
            *(partial(interrupted, make=make, when="while it rings", gap=gap, since_s=RINGING_S) for make in ringing),
            partial(interrupted, make=moving, when="while the load moves", gap=gap),
        ]
    for share in LOSSES:
        found += [partial(lossy, make=make, share=share) for make in (rested, touched, *ringing, moving)]
    found += [partial(late, make=partial(make, late=LATE)) for make in (*ringing, moving)]
    return [Case(True, make) for make in found]


def interrupted(
    surface: SimulatedSurface,
    draws: int,
    rng: np.random.Generator,
    *,
    make: Make,
    when: str,
    gap: int,
    since_s: float | None = None,
) -> Play:
    """Return a course with a gap.

    Parameters
    ----------
    surface, draws, rng : as for all courses
    make, when : makes the course, and what happens in it
    gap : number of readings that are lost in a row
    since_s : from the change of the load to the gap; None: the gap is as late as the course allows
    """
    play = make(surface, draws, rng)
    length = play.deflection_mm.shape[1]
    begins = length - gap - AFTER[-1]
    if since_s is not None:
        begins = min(begins, surface.look_back + round(since_s * surface.metadata.sensor.rate_hz))
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
