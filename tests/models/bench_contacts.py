"""Contacts on the surface of the bench, drawn for the plays of `design-sensors challenge`."""

import numpy as np

from beamtouch_models.lab.challenge.play import DrawnContacts, Play, SimulatedSurface

RATE_HZ, LOW_MM, HIGH_MM = 200, 1.0, 399.0
"""Readings and range of contacts of the bench."""


def drawn(surface: SimulatedSurface, draws: int = 6, seed: int = 3) -> DrawnContacts:
    """Draw contacts; the same seed gives the same ones."""
    return DrawnContacts.of(surface, draws, np.random.default_rng(seed))


def names_in(play: Play) -> list[str]:
    """Return the names of the rows of a play."""
    return list(dict.fromkeys(name for name, _ in play.rows))
