"""Cubic Hermite elements along one axis: their matrices, and the shapes that they have at places.

The unknowns of a node are the deflection and the slope times the length of an element; those of neighbours stand side
by side: (value, slope, value, slope, ...). Bogner, Fox & Schmit, The generation of inter-element-compatible stiffness
and mass matrices by the use of interpolation formulas, Proc. Conf. Matrix Methods in Structural Mechanics, 1965, make a
rectangular plate of products of two such axes.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from beamtouch_models.arrays import Floats, Indices

# Coefficients (shapes, powers) of the shapes in t from 0 to 1 along an element.
SHAPES = np.array([[1.0, 0.0, -3.0, 2.0], [0.0, 1.0, -2.0, 1.0], [0.0, 0.0, 3.0, -2.0], [0.0, 0.0, -1.0, 1.0]])
POWERS = np.arange(4)


@dataclass(frozen=True)
class HermiteAxis:
    """Equal elements along an axis."""

    length: float
    elements: int

    @property
    def step(self) -> float:
        """Length of an element."""
        return self.length / self.elements

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return 2 * self.elements + 2

    @property
    def nodes(self) -> Floats:
        """(nodes,) places of the nodes."""
        return np.linspace(0.0, self.length, self.elements + 1)

    def products(self, left: int, right: int) -> sp.csr_matrix:
        """Return the integrals of products of two derivatives of the shapes, (unknowns, unknowns).

        `left` and `right` are the orders of the derivatives, 0 to 2, of the rows and the columns.
        """
        one, other = (_derivatives(order) for order in (left, right))
        integral = one @ (1 / (1 + POWERS[:, None] + POWERS)) @ other.T * self.step ** (1 - left - right)
        starts = 2 * np.arange(self.elements)[:, None]
        rows, columns = (starts + index.ravel() for index in np.indices((4, 4)))
        values = np.tile(integral.ravel(), self.elements)
        matrix = sp.coo_matrix((values, (rows.ravel(), columns.ravel())), shape=(self.unknowns, self.unknowns))
        return matrix.tocsr()

    def constant(self) -> Floats:
        """Return the unknowns (unknowns,) of a deflection of 1."""
        values: Floats = np.tile([1.0, 0.0], self.elements + 1)
        return values

    def rising(self) -> Floats:
        """Return the unknowns (unknowns,) of a deflection that is the coordinate."""
        return np.column_stack([self.nodes, np.full(self.elements + 1, self.step)]).ravel()

    def squared(self) -> Floats:
        """Return the unknowns (unknowns,) of a deflection that is the square of the coordinate."""
        return np.column_stack([self.nodes**2, 2 * self.nodes * self.step]).ravel()

    def at(self, place: Floats, order: int = 0) -> tuple[Indices, Floats]:
        """Return unknowns and their weights (places, 4) in a derivative of the deflection at places (places,)."""
        element = np.clip((place / self.step).astype(np.intp), 0, self.elements - 1)
        weight = (place / self.step - element)[:, None] ** POWERS @ _derivatives(order).T / self.step**order
        return 2 * element[:, None] + np.arange(4), weight

    def over(self, low: Floats, high: Floats) -> tuple[Indices, Floats]:
        """Return unknowns and their weights (places, n) in the mean deflection from `low` to `high`, (places,) each."""
        inside = np.linspace(0.0, self.length, self.elements + 1)
        first = np.clip((low / self.step).astype(np.intp), 0, self.elements - 1)
        last = np.clip(np.ceil(high / self.step).astype(np.intp), first + 1, self.elements)
        many = int((last - first).max())
        first = np.minimum(first, self.elements - many)
        index = 2 * first[:, None] + np.arange(2 * many + 2)
        weight = np.zeros(index.shape)
        for number in range(many):
            start = inside[first + number]
            ends = [np.clip((end - start) / self.step, 0.0, 1.0) for end in (low, high)]
            # The middle and the half length make a form that does not cancel for short stretches.
            weight[:, 2 * number : 2 * number + 4] += _integrals(*ends) * (self.step / (high - low))[:, None]
        return index, weight


def _derivatives(order: int) -> Floats:
    """Return the coefficients (shapes, powers) of a derivative of the shapes, in t."""
    coefficients = SHAPES
    for _ in range(order):
        coefficients = np.column_stack([coefficients[:, 1:] * POWERS[1:], np.zeros(4)])
    return coefficients


def _integrals(start: Floats, end: Floats) -> Floats:
    """Return the integrals (places, shapes) of the shapes from `start` to `end` of an element, in t.

    Gauss's rule of two points is exact for cubics, and does not cancel on short stretches.
    """
    half, middle = (end - start) / 2, (end + start) / 2
    points = middle[:, None] + half[:, None] * np.array([-1.0, 1.0]) / np.sqrt(3.0)
    values: Floats = (points[..., None] ** POWERS @ SHAPES.T).sum(axis=1) * half[:, None]
    return values
