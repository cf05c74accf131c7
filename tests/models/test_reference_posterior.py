"""The reference posterior under any covariance and with tails, against plain integrals."""

import dataclasses

import mpmath
import numpy as np
import pytest

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.forces import TAIL, forces_of
from beamtouch_models.accuracy.posterior import log_likelihood, posterior_quantiles
from beamtouch_models.arrays import Floats
from beamtouch_models.error_model import whitening
from posterior_cases import prior_of


@pytest.mark.parametrize("force_n", [(2.0, 20.0), (10.0, 10.0)])
@pytest.mark.parametrize("truth_n", [0.4, 5.0, 10.0, 24.0, 90.0])
def test_the_force_is_integrated_out_exactly(force_n: tuple[float, float], truth_n: float) -> None:
    forces = forces_of(force_n, TAIL)
    assert sum(piece.share for piece in forces) == pytest.approx(1)
    for size in (1e-6, 0.1, 3.0, 200.0):
        projection = truth_n * size + 0.3
        with mpmath.workdps(60):

            def density(force: mpmath.mpf, size: float = size, projection: float = projection) -> mpmath.mpf:
                return mpmath.exp(-((projection - force * size) ** 2) / 2)

            total = mpmath.mpf(0)
            for piece in forces:
                low, high = mpmath.mpf(piece.low_n), mpmath.mpf(piece.high_n)
                if low == high:
                    total += piece.share * density(low)
                    continue
                peak = min(max(projection / size, low), high)
                marks = sorted({low, high, *(min(max(peak + k / size, low), high) for k in (-40, -9, -3, 0, 3, 9, 40))})
                total += piece.share * mpmath.quad(density, marks) / (high - low)
            exact = float(mpmath.log(total))
        found = log_likelihood(forces, np.array([size]), np.array([[projection]]), np.zeros((1, 1)))[0, 0]
        assert found == pytest.approx(exact, rel=1e-7, abs=1e-7)


def correlated(channels: int, noise_mm: float) -> Floats:
    """A covariance with an excess along one direction, as a sample has just after a touch."""
    along = np.sin(np.arange(1, channels + 1))
    made: Floats = noise_mm**2 * (np.eye(channels) + 30.0 * np.outer(along, along))
    return made


@pytest.mark.parametrize("tail", [0.0, TAIL])
@pytest.mark.parametrize("known", [True, False])
def test_quantiles_are_those_of_a_plain_integral_under_any_covariance(tail: float, known: bool) -> None:
    prior = prior_of("bench", 3, 2.0, known=known)
    covariance = correlated(3, prior.noise_mm)
    rng = np.random.default_rng(4)
    drawn = limit.draw(prior, 4, 7)
    reading = drawn.deflection_mm + rng.multivariate_normal(np.zeros(3), covariance, 4)
    found, distance = posterior_quantiles(
        prior,
        reading,
        np.tile([0.025, 0.5, 0.975], (4, 1)),
        whitening_per_mm=whitening(reading, covariance, 0.003, 1e-3),
        tail=tail,
    )
    grid = np.linspace(*prior.position_mm, 1201)
    shape = prior.influence_at(grid)
    for row, one in enumerate(reading):
        precision = np.linalg.inv(covariance + np.diag((0.003 * one) ** 2 + 1e-6))
        density = np.zeros(len(grid))
        square, along = np.einsum("gi,ij,gj->g", shape, precision, shape), shape @ precision @ one
        for piece in forces_of(prior.force_n, tail):
            forces = np.linspace(piece.low_n, piece.high_n, 1 if piece.low_n == piece.high_n else 4001)
            misfit = one @ precision @ one - 2 * np.outer(forces, along) + np.outer(forces**2, square)
            likelihood = np.exp(-misfit / 2)
            density += piece.share * (
                likelihood[0] if len(forces) == 1 else np.trapezoid(likelihood, forces, axis=0) / np.ptp(forces)
            )
        below = np.concatenate([[0.0], np.cumsum(density[1:] + density[:-1])])
        expected = np.interp([0.025, 0.5, 0.975], below / below[-1], grid)
        width = expected[2] - expected[0]
        assert found[row] == pytest.approx(expected, abs=2e-3 * width + 0.02)
        mean = np.trapezoid(density * np.abs(grid - expected[1]), grid) / np.trapezoid(density, grid)
        assert distance[row] == pytest.approx(mean, rel=5e-3)


def test_a_sample_of_gains_and_zeros_scatters_as_the_floor_says() -> None:
    bare = prior_of("bench", 4, 0.1, known=False)
    prior = dataclasses.replace(bare, gain=0.01, zero_mm=np.array([0.0, 1e-3, 2e-3, 4e-3]))
    drawn = limit.draw(prior, 40_000, 3)
    clean = drawn.force_n[:, None] * prior.influence_at(drawn.position_mm)
    off = (drawn.deflection_mm - clean) / np.sqrt(prior.noise_mm**2 + (0.01 * clean) ** 2 + np.square(prior.zero_mm))
    assert off.std(axis=0) == pytest.approx(np.ones(4), rel=0.02)
    evenly = limit.draw_evenly(prior, 4096, 3)
    clean = evenly.force_n[:, None] * prior.influence_at(evenly.position_mm)
    assert ((evenly.deflection_mm - clean) / prior.deviation_mm(clean)).std() == pytest.approx(1, rel=0.02)


def test_the_limit_rises_with_the_floor_and_intervals_hold_the_truth_under_it() -> None:
    bare = prior_of("bench", 4, 0.05, known=False)
    prior = dataclasses.replace(bare, gain=0.01, zero_mm=bare.noise_mm)
    assert limit.accuracy_limit(prior, 1000, 1).percent > 2 * limit.accuracy_limit(bare, 1000, 1).percent
    drawn = limit.draw(prior, 2000, 5)
    ends, _ = posterior_quantiles(prior, drawn.deflection_mm, np.tile([0.025, 0.975], (2000, 1)))
    held = (ends[:, 0] <= drawn.position_mm) & (drawn.position_mm <= ends[:, 1])
    assert held.mean() == pytest.approx(0.95, abs=0.02)
    # Without the floor, the same samples get intervals that are far too narrow.
    ends, _ = posterior_quantiles(bare, drawn.deflection_mm, np.tile([0.025, 0.975], (2000, 1)))
    assert ((ends[:, 0] <= drawn.position_mm) & (drawn.position_mm <= ends[:, 1])).mean() < 0.75
