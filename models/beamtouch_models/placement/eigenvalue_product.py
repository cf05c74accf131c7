"""The paper's objective: the product of the leading eigenvalues of the influence matrix (eq. 4), as a logarithm.

The influence matrix is reduced to a few orthogonal coordinates, so that scoring a layout is quick.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg import qr

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.components import log_eigenvalue_product
from beamtouch_models.placement.layout import Candidates, equal_layout

TAIL = 1e-8
"""Squared length that the coordinates may leave out of any column, relative to the smallest scored component."""
RANDOM_STARTS = 4
"""Random layouts to start from, beside equal pitch and the greedy layout."""
TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class EigenvalueProduct:
    """Selection of columns of an influence matrix that maximises the product of their leading eigenvalues."""

    rules: Candidates
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
        """Return the allowed layouts nearest to equal pitch, to greedy pivoting, and to positions drawn uniformly."""
        rng, position, count = np.random.default_rng(seed), self.rules.position_mm, len(self.equal)
        greedy = np.concatenate([self.rules.fixed, np.resize(self.pivots, count - len(self.rules.fixed))])
        drawn = rng.uniform(position[0], position[-1], size=(RANDOM_STARTS, count))
        wanted = (self.rules.fitted(places) for places in (position[greedy], *drawn))
        return [self.equal, *(layout for layout in wanted if layout is not None)]


def eigenvalue_product_of(
    influence: InfluenceFunction, rules: Candidates, count: int, leading: int | None = None
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
    equal = equal_layout(rules, influence.length_mm, count)
    matrix = influence.matrix(rules.position_mm)
    size = float(np.abs(matrix).max())
    if not 0 < size < np.inf:
        message = f"the largest deflection per newton is {size:g} mm; check the dimensions and the rigidity of the beam"
        raise SceneError(message)
    features, tail, pivots = _reduced(matrix / size, leading)
    if len(features) < leading:
        message = (
            f"contacts at {len(matrix)} positions give only {len(features)} components above rounding, not "
            f"{leading}; widen contact.position_mm or use fewer components"
        )
        raise SceneError(message)
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
