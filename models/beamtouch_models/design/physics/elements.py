"""Exact beam elements: states along a uniform stretch of beam, its stiffness, its shape functions.

The four states at a point are deflection w, rotation phi, bending moment M and shear force Q. Along the beam
(Timoshenko, on a Winkler foundation)

    w' = phi + Q/(k G A),   phi' = M/(E I),   M' = -Q,   Q' = foundation w - load.

The power series of this linear system from an element's end is exact: with four terms without a foundation, and to
rounding with 18 terms on a foundation, where the mesh is fine enough for that. It gives the stiffness, the shape
functions and the deflection under a point load between clamped ends. So loads and sensors need no nodes, and the mesh
adds no error. Without shear the solutions are Hetenyi's, Beams on Elastic Foundation, 1946, ch. III; for the elements
see Eisenberger & Yankelevsky, Exact stiffness matrix for beams on elastic foundation, Computers & Structures 21 (1985),
doi 10.1016/0045-7949(85)90189-0.

Units: lengths in the beam's length l, rigidities in a reference EI, the foundation in EI/l^4, deflections in
F l^3/(EI). Shear compliances are EI/(k G A l^2).
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from beamtouch_models.arrays import Floats, Indices

MAX_ON_FOUNDATION = 0.5
"""Longest element on a foundation, in units of (4 EI / foundation)^(1/4), for which the series converges."""
TERMS = 18
MIRROR = np.array([1.0, -1.0])
"""Signs of deflection and rotation seen from the other end."""


@dataclass(frozen=True)
class Elements:
    """Elements with their power series."""

    height: Floats
    """(elements,) length of each."""
    foundation: float
    series: Floats
    """(elements, 4, 2, terms): power series of w, phi, M, Q in the distance from an end held in w and phi, per unit
    moment and per unit shear force at that end."""
    clamp: Floats
    """(elements, 2, 2): moment and shear force at a clamped end, per unit w and phi at the other end."""

    def pick(self, index: Indices | int) -> "Elements":
        """Return the elements at `index`, in its shape."""
        return Elements(self.height[index], self.foundation, self.series[index], self.clamp[index])


def elements_of(height: Floats, rigidity: Floats, shear: Floats, foundation: float) -> Elements:
    """Return elements of given length, rigidity and shear compliance, (elements,) each."""
    terms = TERMS if foundation else 4
    series = np.zeros((len(height), 4, 2, terms))
    series[:, 2, 0, 0] = series[:, 3, 1, 0] = 1.0
    for power in range(1, terms):
        w, phi, moment, force = np.moveaxis(series[..., power - 1], 1, 0)
        series[:, 0, :, power] = (phi + shear[:, None] * force) / power
        series[:, 1, :, power] = moment / rigidity[:, None] / power
        series[:, 2, :, power] = -force / power
        series[:, 3, :, power] = foundation * w / power
    at_end = _evaluate(series[:, :2], height[:, None, None])
    return Elements(height, foundation, series, np.asarray(np.linalg.inv(at_end), np.float64))


def stiffness(of: Elements) -> Floats:
    """Return the stiffness (elements, 4, 4) in w and phi at the left, w and phi at the right."""
    right = _evaluate(of.series[:, [3, 2]], of.height[:, None, None]) @ of.clamp
    across = -of.clamp[:, [1, 0], :]
    top = np.concatenate([right * np.outer(MIRROR, MIRROR), across], axis=-1)
    bottom = np.concatenate([np.swapaxes(across, -1, -2), right], axis=-1)
    matrix = np.concatenate([top, bottom], axis=-2)
    symmetric: Floats = (matrix + np.swapaxes(matrix, -1, -2)) / 2
    return symmetric


def rigid_forces(of: Elements) -> Floats:
    """Return the nodal forces under a rigid motion, per unit w at the left and at the right; (elements, 4, 2).

    Only the foundation resists a rigid motion. By reciprocity its work is the integral of each shape function times the
    motion: a sum of positive terms, where a product with the stiffness would cancel.
    """
    total = np.zeros((len(of.height), 4, 2))
    if of.foundation == 0:
        return total
    for place, weight in gauss_rule(6):
        shape = shapes(place * of.height, (1 - place) * of.height, of)
        total += (weight * of.foundation * of.height)[:, None, None] * shape[:, :, None] * [1 - place, place]
    return total


@cache
def gauss_rule(points: int) -> tuple[tuple[float, float], ...]:
    """Return places and weights on 0..1 that integrate polynomials of a degree below twice their number."""
    node, weight = np.polynomial.legendre.leggauss(points)
    return tuple(zip(((1 + node) / 2).tolist(), (weight / 2).tolist(), strict=True))


def shapes(from_left: Floats, from_right: Floats, of: Elements) -> Floats:
    """Return the deflection per unit w and phi at the left, w and phi at the right; (..., 4).

    Each is computed from the end where it vanishes, so that it stays accurate there. By reciprocity these are also the
    nodal forces of a unit load.
    """
    return np.stack([*_mirrored(_from_clamp(from_right, of)), *_from_clamp(from_left, of)], axis=-1)


def clamped(near: Floats, far: Floats, of: Elements) -> Floats:
    """Return the deflection between clamped ends.

    `near` and `far` are the distances of the left point from the left end and of the right point from the right end,
    in either order. Computed from the end with the nearer point, nothing cancels.
    """
    near, far = np.minimum(near, far), np.maximum(near, far)
    force, moment = _mirrored(_from_clamp(far, of))
    by_moment, by_force = (_evaluate(of.series[..., 0, column, :], near) for column in (0, 1))
    deflection: Floats = by_moment * moment + by_force * force
    return deflection


def _from_clamp(x: Floats, of: Elements) -> tuple[Floats, Floats]:
    """Return the deflection at x from a clamped end, per unit w and per unit phi of the other end."""
    by_moment, by_force = (_evaluate(of.series[..., 0, column, :], x) for column in (0, 1))
    per_w, per_phi = (by_moment * of.clamp[..., 0, end] + by_force * of.clamp[..., 1, end] for end in (0, 1))
    return per_w, per_phi


def _mirrored(pair: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    return pair[0], -pair[1]


def _evaluate(series: Floats, x: Floats) -> Floats:
    """Evaluate a power series (..., terms) at x, by Horner's rule."""
    total = series[..., -1] * np.ones_like(x)
    for power in range(series.shape[-1] - 2, -1, -1):
        total = total * x + series[..., power]
    return total
