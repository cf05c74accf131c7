"""The split of a window that holds a change, and whether the change was a step.

All functions take several means at once. Readings are known by their sums, which are exact.
"""

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.readings import FloatArray, Sums

STEP_PART = 0.12
"""Part of what a step explains that a slope must leave: a slope explains three quarters of a step, and of a bend more
than a step does."""
PROBES = 48
"""Splits that are compared at once, from coarse to fine. The contrast of a change falls evenly on both sides of it."""
BINS = 16
"""Sums of readings by which a step is told from a slope; the slope within a sum is 1/256 of its squares."""


def best_split(sums: Sums, shortest: NDArray[np.intp], fails: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the rows since the split of each window of `fails` rows whose two sides differ most, shape (means,)."""
    low, high = shortest[:, np.newaxis], fails[:, np.newaxis] - 1
    total = sums.since(fails[:, np.newaxis])
    probes = np.arange(PROBES)
    means = np.arange(len(fails))
    while True:
        spacing = int((high - low).max())
        sizes = low + (high - low) * probes // (PROBES - 1) if spacing >= PROBES else np.minimum(low + probes, high)
        since = sums.since(sizes)
        first = total - since
        apart = since[:, :, 0] / np.maximum(since[:, :, 1], 1) - first[:, :, 0] / np.maximum(first[:, :, 1], 1)
        weight = since[:, :, 1] * first[:, :, 1] / np.maximum(total[:, :, 1], 1)
        best = np.einsum("mnc,mnc,mnc->mn", apart, apart, weight).argmax(axis=1)
        if spacing < PROBES:
            split: NDArray[np.intp] = sizes[means, best]
            return split
        low = sizes[means, np.maximum(best - 1, 0)][:, np.newaxis]
        high = sizes[means, np.minimum(best + 1, PROBES - 1)][:, np.newaxis]


def is_sharp(sums: Sums, sizes: NDArray[np.intp], limit: float) -> NDArray[np.bool_]:
    """Return whether the two readings at a split differ sharply, shape (means,); the limit is that of a reading."""
    values, number = sums.each(sizes[:, np.newaxis] + np.array([1, 0, -1]))
    jump = np.where(number.all(axis=1), values[:, 1] - values[:, 0], 0.0)
    sharp: NDArray[np.bool_] = (jump * jump).sum(axis=1) > 2 * limit
    return sharp


def is_calm(sums: Sums, sizes: NDArray[np.intp], still: int, limits: FloatArray) -> NDArray[np.bool_]:
    """Return whether `still` readings before a split scatter within a limit, shape (means,).

    Each channel has all of these readings or none: one that comes and goes may swing beyond its range. `limits`
    (channels + 1,) are by the number of channels that have them.
    """
    values, number = sums.each(sizes[:, np.newaxis] + np.arange(still, -1, -1))
    away = values - values.mean(axis=1, keepdims=True)
    there, some = number.all(axis=1), number.any(axis=1)
    calm: NDArray[np.bool_] = np.all(there == some, axis=1) & np.any(there, axis=1)
    calm &= (away * away).sum(axis=(1, 2)) < limits[there.sum(axis=1)]
    return calm


def is_step(sums: Sums, sizes: NDArray[np.intp], clearly: float) -> NDArray[np.bool_]:
    """Return whether the last `sizes` rows and as many before them differ like a step, and not like a slope."""
    edges = 2 * sizes[:, np.newaxis] * np.arange(BINS, -1, -1) // BINS
    values, number = sums.each(edges)
    ages = edges[:, :-1] + edges[:, 1:]  # times two, which changes no share
    step = np.broadcast_to(np.arange(BINS) >= BINS // 2, ages.shape)
    shapes = np.stack([step, ages])[..., np.newaxis]
    centred = shapes - (shapes * number).sum(axis=2, keepdims=True) / np.maximum(number.sum(axis=1), 1)[:, np.newaxis]
    squares = np.maximum((centred * centred * number).sum(axis=2), np.finfo(np.float64).tiny)
    by_step, by_slope = ((centred * values).sum(axis=2) ** 2 / squares).sum(axis=2)
    clear: NDArray[np.bool_] = by_step - by_slope > np.maximum(clearly, STEP_PART * by_step)
    return clear
