"""By how much a layout of a beam on the grid can exceed another one in the paper's objective.

It is the dual of a convex relaxation. Let f_i be the column of candidate i, M the sum of f_i f_i^T over a layout, and
T any positive definite matrix with eigenvalues t_1 <= t_2 <= ... Let mu be the eigenvalues of M in descending order.
Because log u <= u - 1, and because tr(T M) is at least the sum of t_j mu_j (Ruhe's trace inequality), the K leading
eigenvalues obey

    sum of log mu_j  <=  sum over the layout of h_i  -  K  -  sum of log t_j (j = 1..K),     h_i = f_i^T T f_i.

The right side is a sum over sensors. Its largest value over all layouts that keep the rules is a shortest path. T is
free. The best T solves the dual of the factorisation bound of maximum-entropy sampling (Nikolov 2015,
doi 10.1145/2746539.2746576; Li & Xie 2024, doi 10.1287/opre.2022.2388); multiplicative steps approach it here.
"""

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.eigenvalue_product import EigenvalueProduct, eigenvalue_product_of
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.sweeps import one_thread
from beamtouch_models.places import positions_of

MARGIN, MAX_MARGIN = 1e-8, 1e-6
"""Smallest bound on rounding errors of a bound or a score, in log units; with more than the largest no gap is 0."""
STEPS = 150
"""Multiplicative steps, at most."""
TIGHT = 1e-2
"""Gap after the first step below which the relaxation is tight."""
FLOOR = 1e-9
"""Smallest weight. A weight of 0 could not grow again, and denormal products would be slow."""


def largest_gap(
    influence: InfluenceFunction, rules: LayoutRules, positions_mm: Floats, leading: int | None = None
) -> float:
    """Return by how much the log eigenvalue product of another layout exceeds that of a layout (sensors,) at most.

    0: it is the best on the grid, within `rounding_margin`. Other arguments and errors are those of `placing.place`.
    """
    with one_thread():
        product = eigenvalue_product_of(influence, rules, len(positions_mm), leading)
        return gap_of(product, np.searchsorted(positions_of(rules.place_mm), positions_mm))


def gap_of(product: EigenvalueProduct, layout: Indices) -> float:
    """Return the same for a layout (sensors,) of an objective.

    Places at which the bound excludes a better sensor are left out, so that the bound often closes the gap.
    """
    score, margin = product.exact_score(layout), rounding_margin(product, layout)
    gap = max(_bound(product, layout, score + margin) - score, margin)
    return gap if gap > min(margin, MAX_MARGIN) else 0.0


def rounding_margin(product: EigenvalueProduct, layout: Indices) -> float:
    """Return a bound on the rounding error of a bound or a score, in log units.

    Coordinates are off by some eps of the longest column, and a bound divides them by the smallest scored component.
    """
    singular = np.linalg.svd(product.features[:, layout], compute_uv=False)
    ratio = singular[0] / max(singular[product.leading - 1], np.finfo(np.float64).tiny)
    return max(MARGIN, 100 * len(layout) * float(np.finfo(np.float64).eps * ratio))


def bound_layouts(product: EigenvalueProduct, weights: Floats, mask: Bools) -> tuple[Floats, Floats]:
    """Bound the scores of layouts.

    `mask` (sensors, candidates) is True where the k-th sensor from the left may be. `weights`, of the same shape, sum
    to 1 in each row; T is the gradient of the relaxation at their sum.

    Returns the bound on the layouts whose k-th sensor is at i (sensors, candidates), -inf where it may not be, and
    h_i (candidates,), which is 1 at the sensors of an optimum.
    """
    spectrum, vectors = np.linalg.eigh((product.features * weights.sum(axis=0)) @ product.features.T)
    spectrum, leading = np.maximum(spectrum[::-1], spectrum[-1] * 1e-30), product.leading
    # T inverts the first eigenvalues. It stops where the sum of the remaining ones, divided among the remaining leading
    # components, reaches the next eigenvalue; beyond, and outside the coordinates, T is 1 over that quotient.
    shares = np.cumsum(spectrum[::-1])[::-1][:leading] / (leading - np.arange(leading))
    inverted = int(np.argmax(shares >= spectrum[:leading]))
    inverse = np.full(len(spectrum), 1 / shares[inverted])
    inverse[:inverted] = 1 / spectrum[:inverted]
    price = inverse @ (vectors[:, ::-1].T @ product.features) ** 2 + product.tail / shares[inverted]
    constant = leading * (product.offset - 1) - np.log(inverse[:leading]).sum()
    return product.rules.on_line.best_through(np.where(mask, price, -np.inf)) + constant, price


def _bound(product: EigenvalueProduct, layout: Indices, limit: float) -> float:
    """Return a bound on the scores of all layouts that exceed `limit`; minus infinity if none does."""
    shape = (len(layout), len(product.rules.place_mm))
    mask, at_layout = np.isfinite(product.rules.on_line.best_through(np.zeros(shape))), np.zeros(shape)
    at_layout[np.arange(shape[0]), np.sort(layout)] = 1
    weights, bound = _within(mask, at_layout), np.inf
    for step in range(STEPS):
        through, price = bound_layouts(product, weights, mask)
        mask, bound = mask & (through > limit), min(bound, float(through.max()))
        if not mask.any(axis=1).all():
            return -np.inf
        if step == 0 and bound - limit >= TIGHT:
            # The known layout gives the best multiplier if the relaxation is tight, and a bad one if it is not.
            weights, price = (at_layout + mask / mask.sum(axis=1, keepdims=True)) / 2, np.ones_like(price)
        weights = _within(mask, weights * price)
    return bound


def _within(mask: Bools, weights: Floats) -> Floats:
    """Restrict weights to a region; each row sums to 1, and no weight inside is 0, so that it can grow again."""
    inside = np.where(mask, np.maximum(weights, FLOOR), 0.0)
    normal: Floats = inside / inside.sum(axis=1, keepdims=True)
    return normal
