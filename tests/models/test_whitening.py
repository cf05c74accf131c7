"""The whitening matrix: its square is the inverse of the total covariance, whatever the covariance and the mask."""

import mpmath
import numpy as np
import pytest
from scipy.stats import special_ortho_group

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime.error_model import whitening

GAIN, ZERO_MM = np.array([0.003, 0.01, 0.0]), np.array([1e-3, 0.0, 5e-3])


def covariances(rng: np.random.Generator, count: int, channels: int, condition: float) -> Floats:
    """Covariances of any direction whose largest and smallest variance differ by `condition`."""
    turns = np.atleast_3d(special_ortho_group(channels, seed=rng).rvs(count))
    spread = np.geomspace(1.0, 1 / condition, channels)
    made: Floats = (turns * spread) @ turns.transpose(0, 2, 1)
    return (made + made.transpose(0, 2, 1)) / 2


def test_the_floor_is_added_and_never_averages_away() -> None:
    deflection = np.array([[2.0, -1.0, 0.5]])
    found = whitening(deflection, np.zeros((3, 3)), GAIN, ZERO_MM)
    expected = 1 / np.sqrt((GAIN * deflection[0]) ** 2 + ZERO_MM**2)
    assert np.diag(found[0]) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("condition", [1.0, 1e4, 1e8, 1e12])
def test_it_whitens_a_covariance_of_any_condition(condition: float) -> None:
    rng = np.random.default_rng(1)
    for channels in (2, 4, 8):
        total = covariances(rng, 20, channels, condition)
        found = whitening(np.zeros((20, channels)), total, 0.0, 0.0)
        assert (found == np.tril(found)).all()
        # W C W' is the identity, within the rounding of C itself: eps times the condition.
        off = found @ total @ found.transpose(0, 2, 1) - np.eye(channels)
        assert np.abs(off).max() < 20 * channels * np.finfo(np.float64).eps * condition + 1e-13


def test_a_badly_scaled_covariance_is_factored_to_the_last_digits() -> None:
    # Exact, by mpmath in 50 digits: deviations over twelve decades with strong correlation.
    deviation = np.array([1e-9, 1e-3, 1e3])
    correlation = np.array([[1.0, 0.9, -0.5], [0.9, 1.0, -0.2], [-0.5, -0.2, 1.0]])
    total = correlation * np.outer(deviation, deviation)
    found = whitening(np.zeros((1, 3)), total, 0.0, 0.0)[0]
    with mpmath.workdps(50):
        exact = mpmath.inverse(mpmath.cholesky(mpmath.matrix(total.tolist())))
        expected = [[float(exact[row, column]) for column in range(3)] for row in range(3)]
    for row in range(3):
        assert found[row, : row + 1] == pytest.approx(expected[row][: row + 1], rel=1e-12)


def test_a_missing_channel_is_as_if_it_had_never_been_there() -> None:
    rng = np.random.default_rng(2)
    deflection, total = rng.normal(size=(5, 3)), covariances(rng, 5, 3, 100.0)
    valid = np.array([[True, False, True]] * 5)
    deflection[:, 1] = np.nan
    broken = total.copy()
    broken[:, 1] = broken[:, :, 1] = np.nan
    found = whitening(deflection, broken, GAIN, ZERO_MM, valid)
    kept = [0, 2]
    alone = whitening(deflection[:, kept], total[:, kept][:, :, kept], GAIN[kept], ZERO_MM[kept])
    assert found[:, kept][:, :, kept] == pytest.approx(alone, rel=1e-13)
    assert not found[:, 1].any()
    assert not found[:, :, 1].any()


@pytest.mark.parametrize(
    "total",
    [np.array([[1.0, 2.0], [2.0, 1.0]]), np.zeros((2, 2)), np.diag([1.0, np.nan]), np.diag([np.inf, 1.0])],
)
def test_what_is_no_covariance_is_refused(total: Floats) -> None:
    with pytest.raises(ValueError, match="covariance_mm2"):
        whitening(np.zeros((1, 2)), total, 0.0, 0.0)
