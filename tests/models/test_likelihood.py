"""The likelihood of places, against plain integrals over the force and normal densities of all channels."""

import mpmath
import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.likelihood import NEGLIGIBLE, log_density, possible_rise
from beamtouch_models.design.accuracy.prior import Forces, Piece, forces_of

COVARIANCE = np.array([[0.9, 0.2, -0.1], [0.2, 1.4, 0.3], [-0.1, 0.3, 0.7]]) * 0.05**2
INFLUENCE = np.array(
    [[0.03, 0.06, 0.02], [0.0, 0.0, 0.0], [0.05, -0.02, 0.04], [1e-3, 2e-3, -1e-3], [0.07, 0.09, 0.05]]
)
"""(places, channels), one of which does not move, and one that hardly does."""
VARIANCE = INFLUENCE**2 * np.array([0.04, 0.09, 0.01]) + 1e-5
SAMPLES = np.array([[0.31, 0.55, 0.17], [-0.2, 0.12, 0.4], [1.2, -0.3, 0.9]])


def whitening_of(covariance: Floats) -> Floats:
    """W with W'W the inverse of a covariance, for each sample."""
    return np.tile(np.linalg.inv(np.linalg.cholesky(covariance)), (len(SAMPLES), 1, 1))


def densities(
    forces: Forces, covariance: Floats, variance: Floats | None = None, shared: Floats | None = None
) -> Floats:
    weights = whitening_of(covariance)
    return log_density(
        forces,
        weights,
        np.einsum("dij,dj->di", weights, SAMPLES),
        INFLUENCE[None],
        None if variance is None else variance[None],
        shared,
        negligible=np.inf,
    )


def assert_same_up_to_a_constant(found: Floats, expected: Floats, tolerance: float = 1e-5) -> None:
    """Log densities (draws, places) differ by a constant of each draw."""
    assert found - found[:, :1] == pytest.approx(expected - expected[:, :1], abs=tolerance)


def integral(forces: Forces, shape: Floats, sample: Floats, covariance: Floats) -> float:
    """The log of the mean of a normal density over all forces, by Simpson's rule."""
    logs = []
    for piece in forces:
        force = np.linspace(piece.low_n, piece.high_n, 2001)
        left = sample - force[:, None] * shape
        square = np.einsum("fi,ij,fj->f", left, np.linalg.inv(covariance), left)
        weight = np.append(np.tile([2.0, 4.0], 1000), 1.0)
        weight[0] = 1.0
        logs.append(logsumexp(-square / 2, b=piece.share * weight / weight.sum()))
    return float(logsumexp(logs) - np.log(np.linalg.det(covariance)) / 2)


@pytest.mark.parametrize(
    "forces", [forces_of((3.0, 17.0), 0.0), forces_of((3.0, 17.0), 0.1), (Piece(0.0, 5.0, 0.3), Piece(5.0, 8.0, 0.7))]
)
def test_the_force_is_integrated_out_whatever_the_covariance(forces: Forces) -> None:
    expected = [[integral(forces, shape, sample, COVARIANCE) for shape in INFLUENCE] for sample in SAMPLES]
    assert_same_up_to_a_constant(densities(forces, COVARIANCE), np.array(expected))


def test_an_exact_force_leaves_a_normal_density_of_all_channels() -> None:
    expected = [
        [multivariate_normal.logpdf(sample, 7.0 * shape, COVARIANCE) for shape in INFLUENCE] for sample in SAMPLES
    ]
    assert_same_up_to_a_constant(densities(forces_of((7.0, 7.0), 0.0), COVARIANCE), np.array(expected))


def test_independent_channels_may_be_weighed_by_one_number_each() -> None:
    deviation, forces = np.array([0.05, 0.07, 0.04]), forces_of((3.0, 17.0), 0.05)
    weights = np.tile(1 / deviation, (len(SAMPLES), 1))
    found = log_density(forces, weights, SAMPLES * weights, INFLUENCE[None], VARIANCE[None], negligible=np.inf)
    assert found == pytest.approx(densities(forces, np.diag(deviation**2), VARIANCE), rel=1e-9)


@pytest.mark.parametrize(
    "shared", [None, np.array([[0.8], [0.5], [-0.6]]), np.array([[0.8, 0.3], [0.5, -0.4], [-0.6, 0.7]])]
)
def test_errors_of_the_influence_add_to_the_covariance_by_the_square_of_the_force(shared: Floats | None) -> None:
    """An exact force; sources that channels share correlate what mounting and interpolation leave."""
    noise, force_n = np.diag([0.05, 0.07, 0.04]) ** 2, 7.0
    correlation = np.eye(3) if shared is None else shared @ shared.T
    correlation[np.diag_indices(3)] = 1.0
    expected = [
        [
            multivariate_normal.logpdf(
                sample, force_n * shape, noise + force_n**2 * correlation * np.sqrt(np.outer(left_open, left_open))
            )
            for shape, left_open in zip(INFLUENCE, VARIANCE, strict=True)
        ]
        for sample in SAMPLES
    ]
    assert_same_up_to_a_constant(
        densities(forces_of((force_n, force_n), 0.0), noise, VARIANCE, shared), np.array(expected)
    )


def test_of_an_open_force_errors_of_the_influence_are_those_at_the_likeliest_force() -> None:
    """The likeliest by least squares, within the range: here below, inside and above it."""
    noise, forces = np.diag([0.05, 0.07, 0.04]) ** 2, forces_of((3.0, 17.0), 0.0)
    expected, likeliest = np.empty((2, len(SAMPLES), len(INFLUENCE)))
    for row, sample in enumerate(SAMPLES):
        for place, (shape, left_open) in enumerate(zip(INFLUENCE, VARIANCE, strict=True)):
            precision = shape @ np.linalg.inv(noise) @ shape
            force_n = shape @ np.linalg.inv(noise) @ sample / precision if precision else 0.0
            likeliest[row, place] = force_n
            wider = noise + np.clip(force_n, 3.0, 17.0) ** 2 * np.diag(left_open)
            expected[row, place] = integral(forces, shape, sample, wider)
    assert (likeliest < 3).any()
    assert ((likeliest > 3) & (likeliest < 17)).any()
    assert (likeliest > 17).any()
    assert_same_up_to_a_constant(densities(forces, noise, VARIANCE), expected)


@pytest.mark.parametrize("size", [0.8 / 14, 1.01e-4 / 14, 0.99e-4 / 14, 5.0])
@pytest.mark.parametrize("projection", [-40.0, 0.3, 90.0])
def test_tails_of_the_force_cancel_no_digits(size: float, projection: float) -> None:
    """The log of the mean over 3 to 17 N of exp(-(y - F size)^2 / 2), by an error function of many digits."""
    sample, one = np.array([[projection]]), np.ones((1, 1, 1))
    found = log_density(forces_of((3.0, 17.0), 0.0), one, sample, np.array([[[size], [0.0]]]), negligible=np.inf)
    with mpmath.workdps(40):
        ends = [mpmath.mpf(force) * mpmath.mpf(size) - projection for force in (3, 17)]
        near, far = ends if ends[0] > 0 else (-ends[1], -ends[0])  # both in the upper tail, or around 0
        share = (mpmath.erfc(near / mpmath.sqrt(2)) - mpmath.erfc(far / mpmath.sqrt(2))) / 2
        mean = share * mpmath.sqrt(2 * mpmath.pi) / (14 * mpmath.mpf(size))
        exact = float(mpmath.log(mean) + mpmath.mpf(projection) ** 2 / 2)
    assert found[0, 0] - found[0, 1] == pytest.approx(exact, rel=1e-7, abs=2e-9 + 1e-9 * projection**2)


def test_what_is_not_negligible_is_exact_and_the_rest_stays_negligible() -> None:
    weights, forces = whitening_of(COVARIANCE)[:1], forces_of((3.0, 17.0), 0.0)
    sample = np.einsum("dij,dj->di", weights, 9.0 * INFLUENCE[[4]])
    many = INFLUENCE[4] * np.linspace(0.0, 1.0, 400)[:, None] + INFLUENCE[2] * np.linspace(1.0, 0.0, 400)[:, None]
    exact = log_density(forces, weights, sample, many[None], negligible=np.inf)
    found = log_density(forces, weights, sample, many[None])
    counts = exact >= exact.max() - NEGLIGIBLE
    assert 0 < counts.mean() < 1
    assert found[counts] == pytest.approx(exact[counts])
    assert found[~counts].max() < exact.max() - NEGLIGIBLE
    assert not np.allclose(found[~counts], exact[~counts], atol=1e-3)


def test_of_an_exact_force_even_what_is_negligible_is_exact() -> None:
    weights, forces = whitening_of(COVARIANCE), forces_of((7.0, 7.0), 0.0)
    sample = np.einsum("dij,dj->di", weights, SAMPLES)
    exact = log_density(forces, weights, sample, INFLUENCE[None], negligible=np.inf)
    found = log_density(forces, weights, sample, INFLUENCE[None], negligible=1.0)
    assert (exact < exact.max(axis=1, keepdims=True) - 1).any()
    assert found == pytest.approx(exact, rel=1e-9)


def test_what_is_negligible_is_bounded_by_the_likeliest_force_of_the_range() -> None:
    weights, forces = whitening_of(COVARIANCE), forces_of((3.0, 17.0), 0.0)
    sample = np.einsum("dij,dj->di", weights, SAMPLES)
    found = log_density(forces, weights, sample, INFLUENCE[None], negligible=1.0)
    force = np.linspace(3.0, 17.0, 20_001)[:, None]
    for row, one in enumerate(SAMPLES):
        for place, shape in enumerate(INFLUENCE):
            off = (one - force * shape) @ weights[row].T
            largest = -((off**2).sum(axis=1).min()) / 2
            if largest < found[row].max() - 3:
                assert found[row, place] == pytest.approx(largest, abs=1e-3)


def test_a_peak_may_rise_by_half_of_its_drop_to_the_lower_neighbour() -> None:
    along = np.array([[1.0, 8.0, 4.0, 4.5, 3.0]])
    assert possible_rise(along, 1).tolist() == [[0.0, 3.5, 0.0, 0.75, 0.0]]
    assert possible_rise(along[:, ::-1], 1).tolist() == [[0.0, 0.75, 0.0, 3.5, 0.0]]
    ends = np.array([[9.0, 4.0, 4.0, 7.0]])
    assert possible_rise(ends, 1).tolist() == [[2.5, 0.0, 0.0, 1.5]]
    both = np.stack([np.concatenate([ends, 2 * ends]), np.concatenate([3 * ends, ends])])  # (2, 2, 4)
    assert possible_rise(both, 2)[1, 0].tolist() == [7.5, 0.0, 0.0, 4.5]
    assert possible_rise(both, 1)[:, :, 0].tolist() == [[0.0, 4.5], [9.0, 0.0]]
