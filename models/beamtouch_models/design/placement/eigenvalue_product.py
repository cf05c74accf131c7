"""The paper's objective: principal components of the influence matrix, and the product of their eigenvalues.

*Components.* The principal components are those of eq. 2 and 3, the product of their eigenvalues is that of eq. 4.
Everything comes from a pivoted QR of the influence matrix and the singular values of its triangle, never from the
eigenvalues of its square, so that small components stay accurate (Drmac & Veselic 2008, doi 10.1137/050639193).
Products are sums of logarithms, so that nothing overflows. For a search the matrix is reduced to a few orthogonal
coordinates, so that scoring a layout is quick.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.layout_rules import LayoutRules, equal_layout
from beamtouch_models.errors import SceneError

EPS = float(np.finfo(np.float64).eps)
TAIL = 1e-8
"""Squared length that the coordinates may leave out of any column, relative to the smallest scored component."""
RANDOM_STARTS = 4
"""Random layouts to start from, beside equal pitch and the greedy layout."""
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Components:
    """Principal components of an influence matrix of shape (loads, sensors)."""

    eigenvalues: Floats
    """(sensors,), of X^T X / N0, in descending order, in the square of the unit of X."""
    vectors: Floats
    """(sensors, components), a column per component, signed so that its largest entry is positive."""
    transformed: Floats
    """(loads, components): the components of each load, as in the paper's figure 3."""


def principal_components(matrix: Floats) -> Components:
    """Return the components of an influence matrix (loads, sensors); eq. 2 is a second moment about zero, not the mean.

    Compared with 60-digit arithmetic on the same matrix, each eigenvalue of 32 sensors has a relative error of 1e-12
    (equal pitch) to 1e-10 (1 mm apart on 400 mm).

    Raises
    ------
    ValueError
        An entry is not finite, or the eigenvalues are beyond the range of float64.
    """
    scaled, size = _scaled(matrix)
    orthonormal, triangle, order = qr(scaled, mode="economic", pivoting=True)
    rows, singular, columns = np.linalg.svd(triangle, full_matrices=False)
    with np.errstate(over="ignore", under="ignore"):
        eigenvalues = (singular * size / np.sqrt(len(matrix))) ** 2
    if not eigenvalues[0] < np.inf or (eigenvalues[0] < np.finfo(np.float64).tiny and size > 0):
        message = f"the eigenvalues of a matrix with entries up to {size:g} leave the range of float64; scale it"
        raise ValueError(message)
    vectors = np.empty_like(columns.T)
    vectors[order] = columns.T
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None, :], axis=0)
    sign = np.where(largest < 0, -1.0, 1.0)
    return Components(eigenvalues, vectors * sign, orthonormal @ rows * (singular * size) * sign)


def discernible(eigenvalues: Floats, noise: float) -> int:
    """Return the number of components that exceed their noise, as in the paper's section 3.

    The transformation to components is orthogonal, so each component has the noise of one sensor. Its magnitude is its
    root mean square over the loads, which is the root of its eigenvalue. `noise` has the unit of the influence matrix.
    """
    magnitude = np.sqrt(eigenvalues)
    return int((magnitude > np.maximum(noise, magnitude[0] * EPS * len(magnitude))).sum())


def log_eigenvalue_product(matrix: Floats, leading: int | None = None) -> float:
    """Return the natural logarithm of the product of the leading eigenvalues of eq. 2, which is minus that of eq. 4.

    It is minus infinity if sensors coincide or stand on a support, within rounding. If all eigenvalues count, it comes
    from the diagonal of the triangle. For 32 sensors its error is then 1e-12 (equal pitch) to 1e-10 (1 mm apart on
    400 mm), absolute, and 1e-13, relative.

    Parameters
    ----------
    matrix : (loads, sensors) influence matrix, finite
    leading : number of largest eigenvalues in the product; all by default
    """
    loads, sensors = matrix.shape
    leading = leading or sensors
    scaled, size = _scaled(matrix)
    if size == 0 or leading > min(loads, sensors):
        return -np.inf
    if leading < sensors:
        triangle = qr(scaled, mode="r", pivoting=True)[0][:sensors]
        magnitude = np.linalg.svd(triangle, compute_uv=False)[:leading]
        floor, lengths = magnitude[0] * EPS * max(loads, sensors), np.ones(1)
    else:
        # Scale the columns to a length of 1 to 2, so that a sensor near a support is not lost to rounding. Powers of
        # two change no digit.
        lengths = np.linalg.norm(scaled, axis=0)
        if lengths.min() == 0:
            return -np.inf
        lengths = np.exp2(np.floor(np.log2(lengths)))
        magnitude = np.abs(np.diag(qr(scaled / lengths, mode="r", pivoting=True)[0]))
        floor = EPS * max(loads, sensors)
    if magnitude.min() <= floor:
        return -np.inf
    logs = 2 * (np.log(magnitude).sum() + np.log(lengths).sum())
    return float(logs + leading * (2 * np.log(size) - np.log(loads)))


def _scaled(matrix: Floats) -> tuple[Floats, float]:
    """Return a matrix scaled to entries below 2, and the divisor; raises ValueError if an entry is not finite."""
    size = float(np.abs(matrix).max())
    if not np.isfinite(size):
        raise ValueError("an influence matrix must be finite")
    # A power of two, so that no digit changes.
    unit = float(np.exp2(np.floor(np.log2(size)))) if size else 0.0
    return (matrix / unit if unit else matrix), unit


@dataclass(frozen=True)
class EigenvalueProduct:
    """Selection of columns of an influence matrix that maximises the product of their leading eigenvalues."""

    rules: LayoutRules
    leading: int
    matrix: Floats
    """(loads, candidates), with entries up to 1."""
    features: Floats
    """(coordinates, candidates): the columns of `matrix` in an orthogonal basis, the largest coordinates first."""
    tail: Floats
    """(candidates,): squared length of each column outside the coordinates."""
    equal: Indices
    """(sensors,), the allowed layout nearest to equal pitch."""
    pivots: Indices
    """(coordinates,), the candidates whose columns the coordinates were made from, the most independent first."""
    offset: float
    """Constant per component in a score, from the scale of the matrix and the number of loads."""
    at_once: int = 32

    def scores(self, layouts: Indices, _above: float = -np.inf) -> Floats:
        """Return the log eigenvalue product of layouts (population, sensors), to 1e-7; -inf if a rule is broken."""
        scores, allowed = np.full(len(layouts), -np.inf), self.rules.allowed(layouts)
        columns = np.moveaxis(self.features[:, layouts[allowed]], 0, 1)
        if self.leading == layouts.shape[1]:
            sizes = np.abs(np.diagonal(np.linalg.qr(columns, mode="r"), axis1=1, axis2=2))
        else:
            sizes = np.linalg.svd(columns, compute_uv=False)[:, : self.leading]
        scores[allowed] = 2 * np.log(np.maximum(sizes, TINY)).sum(axis=1) + self.leading * self.offset
        return scores

    def exact_score(self, layout: Indices) -> float:
        """Return the log eigenvalue product of one layout (sensors,), to rounding."""
        logs = log_eigenvalue_product(self.matrix[:, layout], self.leading)
        return logs + self.leading * (self.offset + math.log(len(self.matrix)))

    def starts(self, seed: int) -> list[Indices]:
        """Return the allowed layouts nearest to equal pitch, to greedy pivoting, and to places drawn uniformly."""
        rng, place, count = np.random.default_rng(seed), self.rules.place_mm, len(self.equal)
        greedy = np.concatenate([self.rules.fixed, np.resize(self.pivots, count - len(self.rules.fixed))])
        drawn = rng.uniform(place.min(axis=0), place.max(axis=0), size=(RANDOM_STARTS, count, self.rules.axes))
        wanted = (self.rules.fitted(places) for places in (place[greedy], *drawn))
        return [self.equal, *(layout for layout in wanted if layout is not None)]


def eigenvalue_product_of(
    influence: InfluenceFunction, rules: LayoutRules, count: int, leading: int | None = None
) -> EigenvalueProduct:
    """Return the objective for a structure.

    Parameters
    ----------
    influence, rules : influence function of the structure, and rules for its sensors
    count : number of sensors
    leading : number of largest eigenvalues in the product; `count` by default

    Raises
    ------
    SceneError
        The rules allow no layout of `count` sensors, the structure does not move, or it has fewer than `leading`
        components.
    """
    leading = leading or count
    if leading > count:
        message = f"{count} sensors have {count} components, not {leading}; use fewer components or more sensors"
        raise SceneError(message)
    equal = equal_layout(rules, influence.size_mm, count)
    matrix = influence.matrix(rules.place_mm)
    size = float(np.abs(matrix).max())
    if not 0 < size < np.inf:
        message = f"the largest deflection per newton is {size:g} mm; check the dimensions and the rigidity of the beam"
        raise SceneError(message)
    features, tail, pivots = _reduced(matrix / size, leading)
    if len(features) < leading:
        raise SceneError(
            f"contacts at {len(matrix)} positions give only {len(features)} components above rounding, not "
            f"{leading}; widen contact.position_mm or use fewer components"
        )
    offset = 2 * (math.log(size) - math.log(influence.unit_mm_per_n)) - math.log(len(matrix))
    return EigenvalueProduct(rules, leading, matrix / size, features, tail, equal, pivots, offset)


def _reduced(matrix: Floats, leading: int) -> tuple[Floats, Floats, Indices]:
    """Reduce columns to coordinates in an orthogonal basis, by a QR with the longest remainder first.

    Parameters
    ----------
    matrix : (loads, candidates)
    leading : number of components that must stay accurate

    Returns
    -------
    The coordinates (coordinates, candidates), the squared lengths left out (candidates,), and the pivots.
    """
    triangle, order = qr(matrix, mode="r", pivoting=True)
    square = np.diag(triangle) ** 2
    floor = square[0] * (np.finfo(np.float64).eps * max(matrix.shape)) ** 2
    if leading <= len(square):
        floor = max(floor, TAIL * square[leading - 1])
    count, columns = int((square > floor).sum()), np.empty_like(triangle)
    columns[:, order] = triangle
    return columns[:count], (columns[count:] ** 2).sum(axis=0), order[:count]
