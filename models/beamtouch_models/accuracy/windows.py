"""Means of overlapping windows, drawn so that some successive means are large together."""

import numpy as np

from beamtouch_models.arrays import Floats


def overlapping_means(largest: Floats, window: int, run: int, rng: np.random.Generator) -> tuple[Floats, int]:
    """Draw means of white readings over the last `window` of them, in deviations of a mean.

    Parameters
    ----------
    largest : (draws, dimensions) normal, however they were drawn: what `run` successive means have in common
    window, run : numbers of readings and of successive means

    Returns (draws, means, dimensions), normal if `largest` is, and the index of the first of the `run` means. As many
    means before and after them are drawn as depend on them.
    """
    readings, margin = window + run - 1, window + run
    means = np.zeros((run, readings))
    for first in range(run):
        means[first, first : first + window] = window**-0.5
    # The least readings that raise all means alike.
    common = np.linalg.solve(means @ means.T, np.ones(run)) @ means
    common /= np.linalg.norm(common)
    drawn = rng.normal(size=(len(largest), readings + 2 * margin, largest.shape[1]))
    middle = drawn[:, margin : margin + readings]
    middle += common[:, None] * (largest - np.einsum("k,dkc->dc", common, middle))[:, None]
    below = np.concatenate([np.zeros_like(drawn[:, :1]), np.cumsum(drawn, axis=1)], axis=1)
    found: Floats = (below[:, window:] - below[:, :-window]) / window**0.5
    return found, margin
