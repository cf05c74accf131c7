"""Quantiles and mean distances of posteriors in closed form: of densities on grids, and of a bar on two scales."""

import numpy as np
import pytest
from scipy.stats import norm, truncnorm

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.posterior import posterior_quantiles, summaries
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors

LEVELS = np.array([0.025, 0.3, 0.5, 0.8, 0.975])
SIZE_MM, FORCE_N = 130.0, 10.0


def summarized(grid: Floats, log_density: Floats, levels: Floats = LEVELS) -> tuple[Floats, float]:
    """Quantiles and mean distance of one density, the second of two rows; the first is another one on another grid."""
    other = np.linspace(-7.0, 2.0, len(grid))
    rows = summaries(np.stack([other, grid]), np.stack([other, log_density]), np.stack([levels[::-1], levels]))
    return rows[1, :-1], float(rows[1, -1])


def test_four_nodes_in_a_deviation_give_a_normal_density_to_two_in_ten_thousand() -> None:
    grid = 50 + 3.0 * np.arange(-24, 25) / 4
    quantiles, distance = summarized(grid, norm.logpdf(grid, 50.7, 3.0))
    assert quantiles == pytest.approx(norm.ppf(LEVELS, 50.7, 3.0), abs=0.012)
    assert distance == pytest.approx(3.0 * (2 / np.pi) ** 0.5, rel=3e-4)


@pytest.mark.parametrize("rate", [0.8, -0.8, 12.0, -12.0])
def test_an_exponential_density_is_cut_off_at_both_ends(rate: float) -> None:
    """Its peak is at an end of the grid; if it is steep, the median lies in the first or the last cells."""
    length, grid = 4.0, np.linspace(1.0, 5.0, 801)
    quantiles, distance = summarized(grid, -rate * grid + 1e3)
    steep, whole = abs(rate), -np.expm1(-abs(rate) * length)
    if rate > 0:
        assert quantiles == pytest.approx(1 - np.log1p(-LEVELS * whole) / steep, rel=1e-4)
    else:
        assert quantiles == pytest.approx(5 + np.log1p(-(1 - LEVELS) * whole) / steep, rel=1e-4)
    middle = -np.log1p(-whole / 2) / steep

    def up_to(end: float) -> float:
        """The integral of t exp(-steep t) up to an end."""
        return float((1 - np.exp(-steep * end) * (1 + steep * end)) / steep)

    assert distance == pytest.approx((up_to(length) - 2 * up_to(middle)) / whole, rel=3e-4)


def test_of_an_even_density_quantiles_are_shares_of_the_grid_whatever_its_steps() -> None:
    grid = np.array([2.0, 2.5, 4.0, 4.25, 7.0, 12.0])
    levels = np.array([0.0, 0.02, 0.5, 0.77, 1.0])
    quantiles, distance = summarized(grid, np.full(6, -3.0), levels)
    assert quantiles == pytest.approx([2.0, 2.2, 7.0, 9.7, 12.0])
    assert distance == pytest.approx(2.5)


def test_a_cliff_within_the_grid_is_integrated_as_straight_lines() -> None:
    """1 from 0 to 6, and next to nothing beyond: half of the cell of the cliff counts."""
    grid = np.linspace(0.0, 10.0, 41)
    quantiles, distance = summarized(grid, np.where(grid <= 6.0, 0.0, -50.0))
    assert quantiles[:4] == pytest.approx(6.125 * LEVELS[:4])
    assert distance == pytest.approx(6.125 / 4, rel=2e-3)


def test_densities_are_relative_and_may_be_next_to_nothing() -> None:
    grid = np.linspace(0.0, 20.0, 161)
    alone, far = (summarized(grid, norm.logpdf(grid, 8.03, 0.6) + shift) for shift in (0.0, -5e4))
    assert far[0] == pytest.approx(alone[0])
    assert far[1] == pytest.approx(alone[1])
    sharp, _ = summarized(grid, np.where(np.arange(161) == 40, 0.0, -1e6))
    assert sharp == pytest.approx(np.full(5, 5.0), abs=0.125)


def scales(place_mm: Floats) -> Floats:
    """A bar on two springs of 1 N/mm: each carries the load by its lever, so the posterior is normal."""
    share = place_mm / SIZE_MM
    return np.concatenate([1 - share, share], axis=-1)


def bar(noise_mm: float) -> Prior:
    return Prior(Extent.of_beam((10.0, 120.0)), SIZE_MM, (FORCE_N, FORCE_N), Errors(noise_mm), 2, scales)


@pytest.mark.parametrize("noise_mm", [0.3, 0.01, 1e-4, 1e-7])
def test_the_posterior_of_a_bar_on_two_scales_is_a_normal_one_cut_off_at_the_ends_of_the_range(noise_mm: float) -> None:
    """It has a deviation of l s / (F sqrt 2) about l/2 (1 + (d2 - d1)/F), as the difference of the scales shows."""
    prior, at_mm = bar(noise_mm), np.array([10.0, 37.0, 64.8, 111.0, 120.0])
    deviation = SIZE_MM * noise_mm / (FORCE_N * 2**0.5)
    samples = FORCE_N * scales(at_mm[:, None]) + noise_mm * np.array([0.4, -0.3])
    middle = SIZE_MM / 2 * (1 + (samples[:, 1] - samples[:, 0]) / FORCE_N)
    expected = truncnorm((10 - middle) / deviation, (120 - middle) / deviation, middle, deviation)
    quantiles, distance = posterior_quantiles(prior, samples, np.tile(LEVELS, (5, 1)))
    assert (quantiles - middle[:, None]) / deviation == pytest.approx(
        (np.transpose([expected.ppf(level) for level in LEVELS]) - middle[:, None]) / deviation, abs=0.01
    )
    # The mean distance from the median of a normal density that is cut off, by its values at median and ends.
    ends = [norm.pdf((end - middle) / deviation) for end in (10.0, expected.ppf(0.5), 120.0)]
    share = norm.cdf((120 - middle) / deviation) - norm.cdf((10 - middle) / deviation)
    assert distance == pytest.approx(deviation * (2 * ends[1] - ends[0] - ends[2]) / share, rel=2e-3)


def test_more_samples_than_a_step_takes_are_answered_in_their_order() -> None:
    prior, at_mm = bar(1e-3), np.linspace(20.0, 110.0, 215)
    median, _ = posterior_quantiles(prior, FORCE_N * scales(at_mm[:, None]))
    assert median[:, 0] == pytest.approx(at_mm, abs=1e-3)


def test_a_covariance_of_each_sample_widens_its_posterior() -> None:
    prior, sample = bar(0.01), FORCE_N * scales(np.array([[50.0], [50.0]]))
    whitening = np.stack([np.diag([1 / 0.01, 1 / 0.01]), np.diag([1 / 0.03, 1 / 0.02])])
    _, distance = posterior_quantiles(prior, sample, whitening_per_mm=whitening)
    # Of scales that err by s and t, an exact force takes the mean, weighed by their precisions.
    deviations = SIZE_MM / FORCE_N * np.array([0.01 / 2**0.5, (1 / (1 / 0.03**2 + 1 / 0.02**2)) ** 0.5])
    assert distance == pytest.approx(deviations * (2 / np.pi) ** 0.5, rel=1e-3)


def test_a_posterior_in_two_pieces_keeps_both() -> None:
    """A string under a known force moves a sensor in its middle alike on either side."""

    def string(place_mm: Floats) -> Floats:
        return np.minimum(place_mm, SIZE_MM - place_mm) / SIZE_MM

    prior = Prior(Extent.of_beam((0.0, SIZE_MM)), SIZE_MM, (FORCE_N, FORCE_N), Errors(1e-4), 1, string)
    levels = np.array([[0.25, 0.75]])
    quantiles, distance = posterior_quantiles(prior, FORCE_N * string(np.array([[40.0]])), levels)
    assert quantiles[0] == pytest.approx([40.0, 90.0], abs=0.002)
    assert distance[0] == pytest.approx(25.0, abs=0.01)
