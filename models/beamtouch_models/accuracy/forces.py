"""The prior of the force: the range that the scene states, with tails for improbable forces beyond it."""

from dataclasses import dataclass

TAIL = 0.01
"""Share of forces that an estimator expects outside the range of its scene, half of them below and half above it."""
MAX_FORCE_RATIO = 10.0
"""Largest force that an estimator considers, over the largest of its scene."""
STEP = 3.0
"""Ratio of forces over which the density of `cautious_forces` changes beyond the range."""
BELOW, ABOVE = (4.0, 1.7), (0.5, 0.1)
"""Densities of `cautious_forces` below and above the range, over that within it, from the smallest force up; about one
over the force below, and one over its square above."""


@dataclass(frozen=True)
class Piece:
    """A share of all forces, spread evenly over a range; equal ends: one known force."""

    low_n: float
    high_n: float
    share: float


Forces = tuple[Piece, ...]
"""Pieces side by side, whose shares sum to 1."""


def forces_of(force_n: tuple[float, float], tail: float = TAIL) -> Forces:
    """Return a prior of the force: its range, and `tail` of the mass from 0 to MAX_FORCE_RATIO times its end."""
    low, high = force_n
    core = Piece(low, high, 1.0 - tail)
    if not tail:
        return (core,)
    return Piece(0.0, low, tail / 2), core, Piece(high, MAX_FORCE_RATIO * high, tail / 2)


def cautious_forces(force_n: tuple[float, float]) -> Forces:
    """Return a prior of an open force for intervals, which leans on neither end of the range.

    With `forces_of`, hardly any interval holds the position of a force that is a little outside the range, because
    there is always a place that a force within the range explains.
    """
    low, high = force_n
    ends = (0.0, low / STEP, low, high, STEP * high, MAX_FORCE_RATIO * high)
    shares = [
        density * (most - least)
        for density, least, most in zip((*BELOW, 1.0, *ABOVE), ends[:-1], ends[1:], strict=True)
    ]
    return tuple(
        Piece(least, most, share / sum(shares)) for share, least, most in zip(shares, ends[:-1], ends[1:], strict=True)
    )
