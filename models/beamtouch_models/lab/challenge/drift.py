"""Zeros that drift during a contact: all together as a hall warms, or one by itself, and the rest after the lift."""

from functools import partial

import numpy as np

from beamtouch_models.lab.challenge.play import Case, DrawnContacts, Play, SimulatedSurface

HELD_S, MOST_READINGS = 10.0, 1000
"""Time of a contact, and the most readings that are played of it, for time and memory."""
FASTEST = 2.0
"""Largest rate, over the standard deviation that the scene states; it is even up to there, either way."""


def drift_cases(surface: SimulatedSurface) -> list[Case]:
    """Return the cases of a surface whose zeros drift."""
    if surface.walk is None:
        return []
    return [Case(True, partial(drifts, together=together)) for together in (True, False)]


def drifts(at: DrawnContacts, *, together: bool) -> Play:
    """Return contacts of some seconds on sensors whose zeros drift evenly since before the touch."""
    surface = at.surface
    assert surface.walk is not None  # noqa: S101  # there is no such case without one
    rate_hz, look_back = surface.metadata.sensor.rate_hz, surface.look_back
    held = min(max(look_back, round(HELD_S * rate_hz)), MOST_READINGS)
    readings = np.arange(look_back + held + look_back)
    touched = (readings >= look_back) & (readings < look_back + held)
    rate_mm_per_s = FASTEST * surface.walk.rate_mm_per_min / 60 * at.rng.uniform(-1, 1, size=(at.draws, 1))
    moved = rate_mm_per_s * (np.ones(surface.channels) if together else at.one)
    who = "together" if together else "one by itself"
    return Play(
        deflection_mm=at.deflection_mm[:, None] * touched[:, None] + moved[:, None] * readings[:, None] / rate_hz,
        truth_mm=at.where(touched),
        errors=at.honest,
        rows=(
            (f"zeros drift {who}, contact", look_back + held - 1),
            (f"zeros drift {who}, lifted", len(readings) - 1),
        ),
    )
