"""Misprints and imprecise statements of the paper: equations 1 and 4 and the pitches of section 5."""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.placement.components import principal_components
from beamtouch_models.reproduction.finding import Row, compared
from beamtouch_models.reproduction.paper import FORCE_N, LENGTH_MM, LOADS_MM, deflection_mm, equal_pitch_mm

PRINTED_PITCH_MM = (67, 80, 100, 133)
MAX_SENSORS = 40
"""Bounds the search for the number of sensors at which equation 4 overflows."""


def printed_rows() -> tuple[Row, ...]:
    """Return a row for each of these statements."""
    literal, bracket = _largest_error(), _largest_error(macaulay=True)
    overflow = next(count for count in range(2, MAX_SENSORS) if not np.isfinite(_performance_si(count)))
    pitches = [LENGTH_MM / (count + 1) for count in range(2, 6)]
    return (
        compared(
            "eq. 1: deflection of the beam",
            "(x - a)³ without a condition",
            f"wrong by {literal:.2g} times the largest deflection as printed, by {bracket:.0e} with a Macaulay bracket",
            agrees=literal < 1e-6,
            why="the term (x - a)³ applies only for x > a, and upward is positive",
        ),
        compared(
            "eq. 4: performance value m = 1/(E1 E2 ... En)",
            "finite",
            f"overflows with {overflow} sensors or more, in SI units at {FORCE_N:g} N; ln m does not",
            agrees=False,
            why="double precision ends at 1.8e308",
        ),
        compared(
            "sec. 5: equal pitch for 2, 3, 4, 5 sensors, mm",
            ", ".join(map(str, PRINTED_PITCH_MM)),
            ", ".join(f"{pitch:.0f}" for pitch in pitches),
            agrees=bool(np.allclose(pitches, PRINTED_PITCH_MM, atol=0.5)),
            why="printed in reverse order",
        ),
    )


def equation_1(x: Floats, a: Floats, *, macaulay: bool) -> Floats:
    """Return equation 1 in units of W l^3/(EI), with x and a over the length; upward is positive."""
    beyond = np.maximum(x - a, 0.0) if macaulay else x - a
    deflection: Floats = ((2 - a) * (a - 1) * a * x + (1 - a) * x**3 - beyond**3) / 6
    return deflection


def _largest_error(*, macaulay: bool = False) -> float:
    """Return the largest error of equation 1, relative to the largest deflection."""
    true = deflection_mm(LOADS_MM)
    x, a = LOADS_MM[None, :] / LENGTH_MM, LOADS_MM[:, None] / LENGTH_MM
    ours = -equation_1(x, a, macaulay=macaulay) * 48 * deflection_mm([LENGTH_MM / 2], [LENGTH_MM / 2])[0, 0]
    return float(np.abs(ours - true).max() / true.max())


def _performance_si(count: int) -> float:
    """Return equation 4 as printed, with lengths in metres."""
    eigenvalues = principal_components(deflection_mm(equal_pitch_mm(count)) / 1e3).eigenvalues
    with np.errstate(over="ignore", divide="ignore"):
        return float(1 / np.prod(eigenvalues))
