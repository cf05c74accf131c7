"""The prior of the force: what the scene states, with tails, because what is improbable is not impossible."""

from dataclasses import dataclass

TAIL = 0.01
"""Share of forces that an estimator expects outside the range of its scene, half of them below and half above it."""
HIGHEST = 10.0
"""Largest force that an estimator considers, over the largest of its scene."""


@dataclass(frozen=True)
class Piece:
    """A share of all forces, spread evenly over a range; equal ends: one known force."""

    low_n: float
    high_n: float
    share: float


Forces = tuple[Piece, ...]
"""Pieces side by side, whose shares sum to 1."""


def forces_of(force_n: tuple[float, float], tail: float = TAIL) -> Forces:
    """Return the prior of a scene's force: its range, and `tail` of the mass from 0 to HIGHEST times its largest."""
    low, high = force_n
    core = Piece(low, high, 1.0 - tail)
    if not tail:
        return (core,)
    return Piece(0.0, low, tail / 2), core, Piece(high, HIGHEST * high, tail / 2)
