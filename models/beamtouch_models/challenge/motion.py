"""Loads that lie still and then move."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.challenge.play import Play, drawn, lateness
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.physics.motion import M_PER_MM, Modes, beyond_rest, damping_of

SPEEDS_MM_PER_S = (10, 30, 100, 300, 1000)


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
STEPS = 8
"""Steps per reading in which a moving load is followed: in one of them it hardly moves."""


def moves(
    surface: SimulatedSurface,
    draws: int,
    rng: np.random.Generator,
    *,
    speed_mm_per_s: float,
    motion: Motion = BEGINS,
    late: float = 0.0,
) -> Play:
    """Return loads that lie still and then move; the beam follows with its inertia.

    `late` is the mean lateness of the readings of the motion, in periods.
    """
    low, high = surface.metadata.ranges.position_mm
    rate_hz, before = surface.metadata.sensor.rate_hz, surface.look_back
    moving_s = min(motion.longest_s, motion.way * (high - low) / speed_mm_per_s)
    moving = max(len(motion.parts), round(moving_s * rate_hz))
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
    deflection = surface.under(there, np.repeat(force[:, None], moving + 1, axis=1))
    if surface.modes is not None and surface.mode_shapes is not None:
        target = surface.mode_shapes(path) * force[:, None, None]
        deflection += inertia_mm(surface.modes, surface.sensor_mm, target, step_s, steps)
    still = np.repeat(deflection[:, :1], before, axis=1)
    return Play(
        deflection_mm=np.concatenate([still, deflection[:, 1:]], axis=1),
        truth_mm=np.concatenate([np.repeat(path[:, :1], before, axis=1), there[:, 1:]], axis=1),
        errors=surface.honest(draws, rng),
        rows=tuple((f"{motion.name} at {speed_mm_per_s:.0f} mm/s", before + number - 1) for number in judged),
        crosses=_crosses(surface, path),
        lost=None if lost is None else np.pad(lost[:, 1:], ((0, 0), (before, 0))),
    )


def _crosses(surface: SimulatedSurface, path_mm: Floats) -> Bools:
    """Return which paths (draws, steps) cross a support, (draws,)."""
    supports_mm = np.array([support.at_mm for support in surface.beam.support_list])[:, None]
    crossed: Bools = ((path_mm.min(axis=1) < supports_mm) & (supports_mm < path_mm.max(axis=1))).any(axis=0)
    return crossed


def inertia_mm(modes: Modes, sensor_mm: Floats, target: Floats, step_s: float, steps: Indices | None = None) -> Floats:
    """Return what inertia adds at each reading, (draws, readings, channels) in mm.

    The target (draws, steps, modes) is what the modes follow: the shapes at the load times its force. `steps` (draws,
    readings) are those of the readings; None: one in `STEPS`.
    """
    away = beyond_rest(target, step_s, 1 / np.sqrt(modes.square_s2), damping_of(modes.beam))
    share_mm = modes.at(sensor_mm) * modes.square_s2 / M_PER_MM
    taken = away[:, ::STEPS] if steps is None else np.take_along_axis(away, steps[:, :, None], axis=1)
    added: Floats = taken @ share_mm.T
    return added
