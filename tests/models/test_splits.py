"""The split of a window: the search from coarse to fine, and what tells a step from a slope."""

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray
from beamtouch_models.filters.splits import Sums, best_split, is_step

CHANNELS = 3
ROWS = 2100
WINDOW = 1000


def sums_of(values: FloatArray) -> Sums:
    """Sums up to the last of the readings (rows, channels), for a single mean."""
    rows = np.zeros((len(values) + 1, 2, CHANNELS))
    rows[1:, 0], rows[1:, 1] = np.cumsum(values, axis=0), np.arange(1, len(values) + 1)[:, np.newaxis]
    return Sums(rows[:-1], rows[-1:], np.array([len(values)]))


def searched(values: FloatArray, shortest: int) -> int:
    """Find the split by comparing all of them."""
    window = values[-WINDOW:]
    sizes = range(shortest, WINDOW)
    apart = [window[-size:].mean(axis=0) - window[:-size].mean(axis=0) for size in sizes]
    contrast = [one @ one * size * (WINDOW - size) for one, size in zip(apart, sizes, strict=True)]
    return sizes[int(np.argmax(contrast))]


@pytest.mark.parametrize("since", [400, 517, 750, 989])
@pytest.mark.parametrize("size", [1.5, 20.0])
def test_the_split_is_that_of_an_exhaustive_search(since: int, size: float) -> None:
    values = np.random.default_rng(since).standard_normal((ROWS, CHANNELS))
    values[-since:] += size
    found = best_split(sums_of(values), np.array([384]), np.array([WINDOW]))
    assert found.tolist() == [searched(values, 384)]


@pytest.mark.parametrize("since", [5, 60, 1000])
def test_a_step_is_told_from_a_slope_and_from_a_bend(since: int) -> None:
    noise = np.random.default_rng(3).standard_normal((ROWS, CHANNELS))
    ages = np.arange(ROWS)[::-1, np.newaxis]
    shapes: dict[str, FloatArray] = {
        "step": (ages < since).astype(np.float64),
        "slope": ages / (2 * since),
        "bend": np.clip(ages - since, 0, None) / since,
    }
    found = {
        name: bool(is_step(sums_of(noise + 40 * shape), np.array([since]), 20.0)[0]) for name, shape in shapes.items()
    }
    assert found == {"step": True, "slope": False, "bend": False}
