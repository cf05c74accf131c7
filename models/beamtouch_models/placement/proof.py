"""Branch and bound: proves that a layout has the largest eigenvalue product on the grid, or states a gap.

The bound is the dual of a convex relaxation. Let f_i be the column of candidate i, M the sum of f_i f_i^T over a
layout, and T any positive definite matrix with eigenvalues t_1 <= t_2 <= ... Let mu be the eigenvalues of M in
descending order. Because log u <= u - 1, and because tr(T M) is at least the sum of t_j mu_j (Ruhe's trace inequality),
the K leading eigenvalues obey

    sum of log mu_j  <=  sum over the layout of h_i  -  K  -  sum of log t_j (j = 1..K),     h_i = f_i^T T f_i.

The right side is a sum over sensors. Its largest value over all layouts that keep the rules is a shortest path. T is
free. The best T solves the dual of the factorisation bound of maximum-entropy sampling (Nikolov 2015,
doi 10.1145/2746539.2746576; Li & Xie 2024, doi 10.1287/opre.2022.2388); multiplicative steps approach it here.
"""

import heapq
import math
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.placement.eigenvalue_product import EigenvalueProduct
from beamtouch_models.progress import Fraction, silent

MARGIN, MAX_MARGIN = 1e-8, 1e-6
"""Smallest bound on rounding errors of a bound or a score, in log units; with more than the largest nothing counts as
proven."""
QUICK = 1e-6
"""Generous bound on the error of a quick score."""
MAX_REGIONS = 3_000
"""Regions that are bounded before the remaining gap is stated: about half a minute with up to eight sensors."""
EASY_COORDINATES = 40
"""Beyond this many coordinates fewer regions are bounded: the cost of a bound grows as their cube."""
ENUMERATED = 4_096
"""Regions of up to this many layouts are scored layout by layout instead of being split further."""
ROOT_STEPS, STEPS = 150, 12
"""Bounds computed for the region of all layouts, and for each of its parts."""
FLOOR = 1e-9
"""Smallest weight. A weight of 0 could not grow again, and denormal products would be slow."""


@dataclass(frozen=True)
class Proof:
    """The outcome of a proof."""

    layout: Indices
    """The best known layout, which may be better than the given one."""
    score: float
    gap: float
    """No layout scores more than `score` + `gap`; 0 if the layout is proven the best, within `rounding_margin`."""
    evaluations: int


@dataclass(frozen=True)
class Region:
    """A set of layouts with an upper bound on their scores."""

    bound: float
    mask: Bools
    """(sensors, candidates), True where the k-th sensor from the left may be."""
    weights: Floats
    """(sensors, candidates), summing to 1 in each row; T is the gradient of the relaxation at their sum."""


def prove(
    product: EigenvalueProduct, layout: Indices, max_regions: int = MAX_REGIONS, progress: Fraction = silent
) -> Proof:
    """Prove a layout (sensors,) the best on the grid, or replace it by a better one, or bound the gap.

    `max_regions` is the number of regions to bound, 0 for the whole grid alone; `progress` is called with the gap.
    """
    max_regions = int(max_regions * min(1.0, (EASY_COORDINATES / len(product.features)) ** 3))
    score, margin, evaluations = product.exact_score(layout), rounding_margin(product, layout), 0
    root = _root(product, layout, score + margin)
    regions = [(-root.bound, 0, root)] if root else []
    bounded = 0
    while regions and -regions[0][0] > score + margin and bounded < max_regions:
        progress(-regions[0][0] - score)
        region = heapq.heappop(regions)[2]
        if math.prod(region.mask.sum(axis=1).tolist()) <= ENUMERATED:
            layouts = _layouts(region.mask)
            scores = product.scores(layouts)
            evaluations += len(layouts)
            for better in layouts[scores > max(scores.max(initial=-np.inf), score) - QUICK]:
                if (found := product.exact_score(better)) > score + margin:
                    layout, score = better, found
            continue
        for mask in _halves(region):
            bounded += 1
            if part := _tightened(product, mask, region.weights, STEPS, score + margin, region.bound):
                heapq.heappush(regions, (-part.bound, bounded, part))
    gap = max(-regions[0][0] - score if regions else -np.inf, margin)
    return Proof(layout, score, gap if gap > min(margin, MAX_MARGIN) else 0.0, evaluations)


def rounding_margin(product: EigenvalueProduct, layout: Indices) -> float:
    """Return a bound on the rounding error of a bound or a score, in log units.

    Coordinates are off by some eps of the longest column, and a bound divides them by the smallest scored component.
    """
    singular = np.linalg.svd(product.features[:, layout], compute_uv=False)
    ratio = singular[0] / max(singular[product.leading - 1], np.finfo(np.float64).tiny)
    return max(MARGIN, 100 * len(layout) * float(np.finfo(np.float64).eps * ratio))


def bound_layouts(product: EigenvalueProduct, weights: Floats, mask: Bools) -> tuple[Floats, Floats]:
    """Bound the layouts of a region; weights and mask are those of a `Region`.

    Returns the bound on the layouts whose k-th sensor is at i (sensors, candidates), -inf outside the region, and h_i
    (candidates,), which is 1 at the sensors of an optimum.
    """
    spectrum, vectors = np.linalg.eigh((product.features * weights.sum(axis=0)) @ product.features.T)
    spectrum, leading = np.maximum(spectrum[::-1], spectrum[-1] * 1e-30), product.leading
    # T inverts the first eigenvalues. It stops where the sum of the remaining ones, divided among the remaining leading
    # components, reaches the next eigenvalue; beyond, and outside the coordinates, T is 1 over that quotient.
    shares = np.cumsum(spectrum[::-1])[::-1][:leading] / (leading - np.arange(leading))
    whole = int(np.argmax(shares >= spectrum[:leading]))
    inverse = np.full(len(spectrum), 1 / shares[whole])
    inverse[:whole] = 1 / spectrum[:whole]
    price = inverse @ (vectors[:, ::-1].T @ product.features) ** 2 + product.tail / shares[whole]
    constant = leading * (product.offset - 1) - np.log(inverse[:leading]).sum()
    return product.rules.best_through(np.where(mask, price, -np.inf)) + constant, price


def _tightened(
    product: EigenvalueProduct, mask: Bools, weights: Floats, steps: int, limit: float, known: float = np.inf
) -> Region | None:
    """Return a region with its bound, without the candidates that the bound excludes; None if nothing is left.

    `steps` bounds are computed from `weights` on, a layout must exceed `limit`, and `known` is a bound already known.
    """
    weights = _within(mask, weights)
    bound, best = known, weights
    for _ in range(steps):
        through, price = bound_layouts(product, weights, mask)
        mask = mask & (through > limit)
        if through.max() < bound:
            bound, best = float(through.max()), weights
        if not mask.any(axis=1).all():
            return None
        weights = _within(mask, weights * price)
    return Region(bound, mask, _within(mask, best))


def _root(product: EigenvalueProduct, layout: Indices, limit: float) -> Region | None:
    """Return the region of all allowed layouts, without those that the bound excludes."""
    shape = (len(layout), len(product.rules.position_mm))
    mask, at_layout = np.isfinite(product.rules.best_through(np.zeros(shape))), np.zeros(shape)
    at_layout[np.arange(shape[0]), np.sort(layout)] = 1
    # The best known layout gives the best multiplier if the relaxation is tight, and a bad one if it is not.
    first = _tightened(product, mask, at_layout, 1, limit)
    if first is None or first.bound - limit < 1e-2:
        return first
    spread = (at_layout + mask / mask.sum(axis=1, keepdims=True)) / 2
    return _tightened(product, first.mask, spread, ROOT_STEPS, limit, first.bound)


def _layouts(mask: Bools) -> Indices:
    """Return the layouts (layouts, sensors) of a region."""
    choices = np.meshgrid(*(np.flatnonzero(row) for row in mask), indexing="ij")
    layouts = np.stack([choice.ravel() for choice in choices], axis=1)
    return layouts[np.all(np.diff(layouts, axis=1) > 0, axis=1)]


def _within(mask: Bools, weights: Floats) -> Floats:
    """Restrict weights to a region; each row sums to 1, and no weight inside is 0, so that it can grow again."""
    inside = np.where(mask, np.maximum(weights, FLOOR), 0.0)
    normal: Floats = inside / inside.sum(axis=1, keepdims=True)
    return normal


def _halves(region: Region) -> tuple[Bools, Bools]:
    """Split a region at the sensor that the relaxation spreads most, at the mean of its weights."""
    index = np.arange(region.mask.shape[1])
    mean = region.weights @ index
    variance = region.weights @ index**2 - mean**2
    counts = region.mask.sum(axis=1)
    row = int(np.where(counts > 1, variance + 1e-3 * counts, -1.0).argmax())
    allowed = np.flatnonzero(region.mask[row])
    middle = int(np.clip(np.ceil(mean[row]), allowed[0] + 1, allowed[-1]))
    left, right = region.mask.copy(), region.mask.copy()
    left[row, middle:] = False
    right[row, :middle] = False
    return left, right
