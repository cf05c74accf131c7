"""An upper bound on the eigenvalue product of every layout in a region, from the dual of a convex relaxation.

Let f_i be the column of candidate i, M the sum of f_i f_i^T over a layout, and T any positive definite matrix with
eigenvalues t_1 <= t_2 <= ... Let mu be the eigenvalues of M in descending order. Because log u <= u - 1, and because
tr(T M) is at least the sum of t_j mu_j (Ruhe's trace inequality), the K leading eigenvalues obey

    sum of log mu_j  <=  sum over the layout of h_i  -  K  -  sum of log t_j (j = 1..K),     h_i = f_i^T T f_i.

The right side is a sum over sensors. Its largest value over all layouts that keep the rules is a shortest path. T is
free. The best T solves the dual of the factorisation bound of maximum-entropy sampling (Nikolov 2015,
doi 10.1145/2746539.2746576; Li & Xie 2024, doi 10.1287/opre.2022.2388); multiplicative steps approach it here.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.placement.problem import Problem

LEFT_OUT = 1e-6
"""Squared length that T may leave out of any column, relative to what the scored components need. On the coordinates
left out, T is a multiple of the identity."""


@dataclass(frozen=True)
class Bound:
    """An upper bound on the layouts of a region, with its terms."""

    value: float
    """No layout of the region scores more."""
    through: Floats
    """(sensors, candidates): bound on the layouts whose k-th sensor is at i; -inf outside the region."""
    price: Floats
    """(candidates,): h_i above; 1 at the sensors of an optimum."""


@dataclass(frozen=True)
class Bounder:
    """The data that all bounds of one problem share."""

    problem: Problem
    features: Floats
    """(coordinates, candidates): the coordinates on which T is free."""
    rest: Floats
    """(candidates,): squared length of each column in all other coordinates."""

    @property
    def ease(self) -> float:
        """Fraction of the usual number of bounds to compute; the cost of one grows as the cube of the coordinates."""
        return min(1.0, (100 / len(self.features)) ** 3)

    def bound(self, weights: Floats, region: Bools) -> Bound:
        """Bound the layouts of a region.

        Parameters
        ----------
        weights : (candidates,), summing to the number of sensors; T is the gradient of the relaxation at this point
        region : (sensors, candidates), True where the k-th sensor from the left may be
        """
        problem = self.problem
        spectrum, vectors = np.linalg.eigh((self.features * weights) @ self.features.T)
        inverse, tail_inverse = _gradient(spectrum[::-1], problem.leading)
        price = inverse @ (vectors[:, ::-1].T @ self.features) ** 2 + tail_inverse * self.rest
        constant = problem.leading * (problem.offset - 1) - np.log(inverse[: problem.leading]).sum()
        through = problem.rules.best_through(np.where(region, price, -np.inf)) + constant
        return Bound(float(through.max()), through, price)


def bounder_of(problem: Problem) -> Bounder:
    """Prepare the bounds of a problem."""
    squares = problem.features[::-1] ** 2
    left_out = np.cumsum(np.vstack([problem.tail, squares]), axis=0)[::-1]
    # left_out[c] is the squared length of each column outside the first c coordinates.
    worst = left_out.max(axis=1)
    needed = worst[problem.leading - 1]
    kept = max(problem.leading, int(np.argmax(worst <= LEFT_OUT * needed)) or len(problem.features))
    return Bounder(problem, problem.features[:kept], left_out[kept])


def _gradient(spectrum: Floats, leading: int) -> tuple[Floats, float]:
    """Return the eigenvalues of T, ascending, and its eigenvalue on all coordinates left out.

    T inverts the first eigenvalues of `spectrum` (descending). It stops where the sum of the remaining eigenvalues,
    divided among the remaining leading components, reaches the next eigenvalue; beyond, T is 1 over that quotient.
    """
    spectrum = np.maximum(spectrum, spectrum[0] * 1e-30)
    shares = np.cumsum(spectrum[::-1])[::-1][:leading] / (leading - np.arange(leading))
    whole = int(np.argmax(shares >= spectrum[:leading]))
    share = float(shares[whole])
    inverse = np.full(len(spectrum), 1 / share)
    inverse[:whole] = 1 / spectrum[:whole]
    return inverse, 1 / share
