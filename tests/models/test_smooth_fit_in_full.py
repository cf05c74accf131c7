"""What a fit of two smoothnesses tells, against the equations of a Gaussian process with the whole covariance."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.physics.smooth_fit import SmoothFit
from beamtouch_models.design.physics.smoothness import Smoothness, measured_together

SPAN_MM, SCALE = np.array([80.0, 50.0]), np.array([2.0, 0.5, 3.0])
SMOOTH = (Smoothness(2, 0.2, 0.5, (0.4, 0.7)), Smoothness(1, 0.3, 4.0, (1.1, 0.6)))
WEIGHTS = np.array([0.3, 0.7])
RNG = np.random.default_rng(5)
SHARE = RNG.uniform(size=(7, 2))[[0, 1, 2, 3, 4, 5, 6, 6]]
VALUES = RNG.normal(size=(8, 3))
VALUES[2, 1] = np.nan
LIGHT = RNG.uniform(1, 4, 8)
AT = RNG.uniform(size=(3, 2))
COLUMNS = range(3)


@pytest.fixture(scope="module")
def fit() -> SmoothFit:
    measured = measured_together(SHARE, VALUES, LIGHT)
    return SmoothFit(SHARE * SPAN_MM, SPAN_MM, measured, SCALE, SMOOTH, WEIGHTS, 6.0)


def rows_of(column: int, out: int | None = None) -> Indices:
    """Return the rows that a column has, or those of its neighbours with the same missing ones, without one row."""
    rows = np.flatnonzero(np.isfinite(VALUES[:, column]))
    return rows if out is None else rows[rows != out]


def noise_of(smooth: Smoothness) -> Floats:
    noise: Floats = smooth.scatter**2 * (1 + smooth.additive * LIGHT) / (1 + smooth.additive)
    return noise


def told(smooth: Smoothness, column: int, place: Floats, out: int | None = None) -> tuple[Floats, Floats, float]:
    """Return mean and variance at places, and the square of the amplitude, of one column over its scale."""
    rows = rows_of(column, out)
    covariance = smooth.covariance(SHARE[rows], SHARE[rows]) + np.diag(noise_of(smooth)[rows])
    towards, values = smooth.covariance(place, SHARE[rows]), VALUES[rows, column]
    square = float(values @ np.linalg.solve(covariance, values)) / (len(rows) - 2)
    left = 1 - np.einsum("ij,ji->i", towards, np.linalg.solve(covariance, towards.T))
    return towards @ np.linalg.solve(covariance, values), left * square, square


def test_mean_and_deviation_are_those_of_the_mixture(fit: SmoothFit) -> None:
    mean, deviation = fit.at(AT * SPAN_MM)
    for column in COLUMNS:
        means, variances, _ = zip(*(told(smooth, column, AT) for smooth in SMOOTH), strict=True)
        wanted = WEIGHTS @ np.array(means)
        squares = WEIGHTS @ (np.array(variances) + np.array(means) ** 2)
        assert mean[:, column] == pytest.approx(wanted * SCALE[column], rel=1e-9)
        assert deviation[:, column] == pytest.approx(np.sqrt(squares - wanted**2) * SCALE[column], rel=1e-6)


def test_values_repeat_as_the_part_that_grows_with_the_force(fit: SmoothFit) -> None:
    for column in COLUMNS:
        squares = [told(smooth, column, AT)[2] for smooth in SMOOTH]
        repeats = 0.3 * 0.2**2 / 1.5 * squares[0] + 0.7 * 0.3**2 / 5 * squares[1]
        assert fit.repeatability[column] == pytest.approx(np.sqrt(repeats) * SCALE[column])
        # Half the largest force: four times the variance of the part that does not grow.
        under = 0.3 * 0.2**2 * (1 + 0.5 * 4) / 1.5 * squares[0] + 0.7 * 0.3**2 * (1 + 4 * 4) / 5 * squares[1]
        assert fit.scatter_under(3.0)[column] == pytest.approx(np.sqrt(under) * SCALE[column])
    assert np.all(fit.scatter_under(6.0) > fit.repeatability)


def test_columns_of_other_rows_are_taken_as_independent(fit: SmoothFit) -> None:
    products = []
    for smooth in SMOOTH:
        covariance = smooth.covariance(SHARE, SHARE) + np.diag(noise_of(smooth))
        both = VALUES[:, [0, 2]].T @ np.linalg.solve(covariance, VALUES[:, [0, 2]])
        # Eight values, and three more that are not correlated.
        products.append(both[0, 1] / np.sqrt(both[0, 0] * both[1, 1]) * 8 / 11)
    wanted = WEIGHTS @ products
    assert fit.correlation == pytest.approx(np.array([[1, 0, wanted], [0, 1, 0], [wanted, 0, 1]]), abs=1e-9)


def test_a_value_is_less_what_the_others_say_over_its_deviation(fit: SmoothFit) -> None:
    for column in COLUMNS:
        for row in rows_of(column):
            wanted = 0.0
            for weight, smooth in zip(WEIGHTS, SMOOTH, strict=True):
                mean, _, _ = told(smooth, column, SHARE[[row]], row)
                others = rows_of(column, row)
                covariance = smooth.covariance(SHARE[others], SHARE[others]) + np.diag(noise_of(smooth)[others])
                towards = smooth.covariance(SHARE[[row]], SHARE[others])
                left = 1 + noise_of(smooth)[row] - float((towards @ np.linalg.solve(covariance, towards.T))[0, 0])
                _, _, square = told(smooth, column, AT)
                wanted += weight * (VALUES[row, column] - mean[0]) / np.sqrt(left * square)
            assert fit.left_out[row, column] == pytest.approx(wanted, rel=1e-6)
    assert fit.left_out[2, 1] == 0


def test_without_a_value_the_others_tell_the_rest(fit: SmoothFit) -> None:
    mean, _ = fit.without(4).at(AT * SPAN_MM)
    for column in COLUMNS:
        wanted = WEIGHTS @ np.array([told(smooth, column, AT, 4)[0] for smooth in SMOOTH])
        assert mean[:, column] == pytest.approx(wanted * SCALE[column], rel=1e-9)
    assert fit.without(4).left_out.shape == (8, 3)


def test_further_values_are_as_certain_as_the_best_that_were_measured(fit: SmoothFit) -> None:
    more = RNG.uniform(size=(2, 2))
    found = fit.variance_with(more * SPAN_MM, AT * SPAN_MM)
    for column in COLUMNS:
        wanted = np.zeros(3)
        for weight, smooth in zip(WEIGHTS, SMOOTH, strict=True):
            rows, noise = rows_of(column), noise_of(smooth)
            place = np.concatenate([SHARE[rows], more])
            # Two values at one place count as their mean.
            last = 1 / (1 / noise[6] + 1 / noise[7])
            least = min(*noise[rows[rows < 6]], last)
            covariance = smooth.covariance(place, place) + np.diag([*noise[rows], least, least])
            towards = smooth.covariance(AT, place)
            left = 1 - np.einsum("ij,ji->i", towards, np.linalg.solve(covariance, towards.T))
            wanted += weight * left * told(smooth, column, AT)[2]
        assert found[:, column] == pytest.approx(wanted * SCALE[column] ** 2, rel=1e-6)


def test_a_draw_of_one_smoothness_is_normal_about_its_mean(fit: SmoothFit) -> None:
    one = replace(fit, combinations=SMOOTH[1:], weights=np.ones(1))
    mean, deviation = one.at(AT * SPAN_MM)
    rng = np.random.default_rng(1)
    drawn = np.array([one.draw(AT * SPAN_MM, rng) for _ in range(600)])
    off = (drawn - mean) / deviation
    assert np.abs(off.mean(axis=0)).max() < 0.15
    assert np.abs(off.std(axis=0) - 1).max() < 0.1
    smooth = SMOOTH[1]
    covariance = smooth.covariance(SHARE, SHARE) + np.diag(noise_of(smooth))
    towards = smooth.covariance(AT, SHARE)
    left = smooth.covariance(AT, AT) - towards @ np.linalg.solve(covariance, towards.T)
    wanted = left / np.sqrt(np.outer(np.diag(left), np.diag(left)))
    assert np.corrcoef(off[..., 0].T) == pytest.approx(wanted, abs=0.12)
    across = np.corrcoef(off[:, 0, 0], off[:, 0, 2])[0, 1]
    assert across == pytest.approx(one.correlation[0, 2], abs=0.12)


def test_a_fit_takes_its_units_from_the_table() -> None:
    """Values, forces and places in other units change the fit by these units, and by nothing else."""
    rng = np.random.default_rng(3)
    place_mm = np.linspace(0, 300, 9)[:, None]
    values = np.column_stack([np.sin(place_mm[:, 0] / 70), np.cos(place_mm[:, 0] / 90)]) + 0.01 * rng.normal(
        size=(9, 2)
    )
    force_n = rng.choice([2.0, 5.0, 9.0], 9)
    one = SmoothFit.of(place_mm, values, force_n)
    other = SmoothFit.of(7 * place_mm, values * [3.0, 0.2], 11 * force_n)
    assert (one.strongest_n, other.strongest_n) == (9.0, 99.0)
    assert one.scale == pytest.approx(np.sqrt((values**2).mean(axis=0)))
    assert one.span_mm == pytest.approx([300.0])
    assert one.weights.sum() == pytest.approx(1.0)
    assert other.weights == pytest.approx(one.weights)
    between = np.array([[20.0], [133.0]])
    for found, wanted in zip(other.at(7 * between), one.at(between), strict=True):
        assert found == pytest.approx(wanted * [3.0, 0.2], rel=1e-6)
    assert {smooth.additive for smooth in SmoothFit.of(place_mm, values, np.full(9, 5.0)).combinations} == {0.0}
