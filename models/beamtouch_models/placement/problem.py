"""The placement problem, reduced to a few orthogonal coordinates so that scoring a layout is quick."""

import math
from dataclasses import dataclass, replace

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.components import log_eigenvalue_product
from beamtouch_models.placement.impossible import no_layout, too_few_components
from beamtouch_models.placement.layout import Candidates, equal_pitch_mm

TAIL = 1e-8
"""Squared length that the coordinates may leave out of any column, relative to the smallest scored component."""


@dataclass(frozen=True)
class Problem:
    """Selection of columns of an influence matrix that maximises the product of their leading eigenvalues."""

    rules: Candidates
    count: int
    leading: int
    matrix: Floats
    """(loads, candidates), with entries up to 1."""
    features: Floats
    """(coordinates, candidates): the columns of `matrix` in an orthogonal basis, the largest coordinates first."""
    tail: Floats
    """(candidates,): squared length of each column outside the coordinates."""
    starts: tuple[Indices, Indices]
    """The layouts of equal pitch and of greedy pivoting, fitted to the rules."""
    offset: float
    """Constant per component in a score, from the scale of the matrix and the number of loads."""

    def scores(self, layouts: Indices) -> Floats:
        """Return the log eigenvalue product of layouts (population, sensors), to 1e-7; -inf if a rule is broken."""
        columns = np.moveaxis(self.features[:, layouts], 0, 2)
        logs = _log_volumes(columns) if self.leading == self.count else _log_leading(columns, self.leading)
        return np.where(self.rules.allowed(layouts), logs + self.leading * self.offset, -np.inf)

    def exact_score(self, layout: Indices) -> float:
        """Return the log eigenvalue product of one layout (sensors,), to rounding."""
        logs = float(log_eigenvalue_product(self.matrix[:, layout], self.leading))
        return logs + self.leading * (self.offset + math.log(len(self.matrix)))

    @property
    def without_matrix(self) -> "Problem":
        """The problem without what only an exact score needs, which is most of its size."""
        return replace(self, matrix=np.empty((0, 0)))

    def random_layout(self, rng: np.random.Generator) -> Indices:
        """Return the allowed layout nearest to uniformly drawn positions."""
        position = self.rules.position_mm
        return self.fitted(rng.uniform(position[0], position[-1], size=self.count))

    def fitted(self, wanted_mm: Floats) -> Indices:
        """Return the allowed layout nearest to wanted positions (sensors,)."""
        layout = self.rules.fitted(wanted_mm)
        if layout is None:
            raise no_layout(self.count)
        return layout


def equal_layout(rules: Candidates, length_mm: float, count: int) -> Indices:
    """Return the allowed layout nearest to equal pitch on a beam of this length; SceneError if no layout exists."""
    if count < len(rules.fixed):
        message = f"sensors.fixed_mm has {len(rules.fixed)} sensors, more than the {count} to be placed"
        raise SceneError(message)
    layout = rules.fitted(equal_pitch_mm(length_mm, count))
    if layout is None:
        raise no_layout(count)
    return layout


def problem_of(influence: InfluenceFunction, rules: Candidates, count: int, leading: int | None = None) -> Problem:
    """Return the placement problem of a structure.

    Parameters
    ----------
    influence, rules : influence function of the structure, and rules for its sensors
    count : number of sensors
    leading : number of largest eigenvalues in the product; `count` by default

    Raises
    ------
    SceneError
        The rules allow no layout of `count` sensors, or no layout has `leading` components.
    """
    leading = leading or count
    if leading > count:
        raise too_few_components(count, leading)
    equal = equal_layout(rules, influence.length_mm, count)
    return problem_from(influence.matrix(rules.position_mm), rules, equal, leading, influence.unit_mm_per_n)


def problem_from(matrix: Floats, rules: Candidates, equal: Indices, leading: int, unit: float = 1.0) -> Problem:
    """Return the placement problem of an influence matrix (loads, candidates).

    Parameters
    ----------
    rules, equal : the rules, and the allowed layout nearest to equal pitch
    leading : number of largest eigenvalues in the product
    unit : unit of deflection in scores, in the unit of `matrix`

    Raises
    ------
    SceneError
        The matrix is zero, or has fewer than `leading` components.
    """
    size = float(np.abs(matrix).max())
    if not 0 < size < np.inf:
        message = f"the largest deflection per newton is {size:g} mm; check the dimensions and the rigidity of the beam"
        raise SceneError(message)
    matrix = matrix / size
    features, tail, pivots = reduced(matrix, leading)
    if len(features) < leading:
        message = (
            f"contacts at {len(matrix)} positions give only {len(features)} components above rounding, not "
            f"{leading}; widen contact.position_mm or use fewer components"
        )
        raise SceneError(message)
    free = len(equal) - len(rules.fixed)
    wanted = np.concatenate([rules.fixed, np.resize(pivots, free)])
    greedy = rules.fitted(rules.position_mm[wanted])
    offset = 2 * (math.log(size) - math.log(unit)) - math.log(len(matrix))
    starts = (equal, equal if greedy is None else greedy)
    return Problem(rules, len(equal), leading, matrix, features, tail, starts, offset)


def reduced(matrix: Floats, leading: int) -> tuple[Floats, Floats, Indices]:
    """Reduce columns to coordinates in an orthogonal basis, by Gram-Schmidt with the longest remainder first.

    Parameters
    ----------
    matrix : (loads, candidates)
    leading : number of components that must stay accurate

    Returns
    -------
    The coordinates (coordinates, candidates), the squared lengths left out (candidates,), and the pivots.
    """
    remainder = matrix.copy()
    most = min(matrix.shape)
    basis, features = np.empty((most, len(matrix))), np.empty((most, matrix.shape[1]))
    pivots: list[int] = []
    squares = np.einsum("ij,ij->j", remainder, remainder)
    floor = rounding = squares.max() * (np.finfo(np.float64).eps * max(matrix.shape)) ** 2
    subtracted, level = 0, squares.max()
    for k in range(most):
        # Update the remainder only now and then, in one product, before rounding shows in the squares.
        if squares.max() <= level * 1e-4:
            remainder -= basis[subtracted:k].T @ features[subtracted:k]
            squares = np.einsum("ij,ij->j", remainder, remainder)
            subtracted, level = k, squares.max()
        pivot = int(squares.argmax())
        if squares[pivot] <= floor:
            return features[:k], squares, np.array(pivots, dtype=np.intp)
        if k == leading - 1:
            floor = max(rounding, TAIL * squares[pivot])
        direction = remainder[:, pivot] - features[subtracted:k, pivot] @ basis[subtracted:k]
        for _ in range(2):
            direction = direction - (basis[:k] @ direction) @ basis[:k]
            direction /= np.linalg.norm(direction)
        basis[k], features[k] = direction, direction @ remainder
        squares = np.maximum(squares - features[k] ** 2, 0.0)
        pivots.append(pivot)
    return features, np.zeros(matrix.shape[1]), np.array(pivots, dtype=np.intp)


def _log_volumes(columns: Floats) -> Floats:
    """Return log det(X^T X) (population,) by Gram-Schmidt, for columns (population, sensors, coordinates)."""
    rest = np.array(columns)
    total = np.zeros(len(rest))
    tiny = np.finfo(np.float64).tiny
    for k in range(rest.shape[1]):
        square = np.einsum("pc,pc->p", rest[:, k], rest[:, k])
        total += np.log(np.maximum(square, tiny))
        if k + 1 < rest.shape[1]:
            along = np.einsum("psc,pc->ps", rest[:, k + 1 :], rest[:, k]) / np.maximum(square, tiny)[:, None]
            rest[:, k + 1 :] -= along[:, :, None] * rest[:, k, None, :]
    return total


def _log_leading(columns: Floats, leading: int) -> Floats:
    """Return the log product of the leading eigenvalues of X^T X, for columns (population, sensors, coordinates)."""
    singular = np.linalg.svd(columns, compute_uv=False)[:, :leading]
    logs: Floats = 2 * np.log(np.maximum(singular, np.finfo(np.float64).tiny)).sum(axis=1)
    return logs
