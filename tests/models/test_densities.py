"""Quantiles and mean distances of densities on grids, against closed forms."""

import numpy as np
import pytest
from scipy.stats import norm

from beamtouch_models.accuracy.densities import densities

LEVELS = np.array([0.01, 0.2, 0.5, 0.7, 0.975])


@pytest.mark.parametrize("step", [0.05, 0.15, 0.3, 0.5])
@pytest.mark.parametrize("shift", [0.0, 0.3, 0.5])
def test_a_normal_density_on_a_coarse_grid(step: float, shift: float) -> None:
    grid = np.arange(-10, 10, step) + shift * step
    found = densities(grid[None], -(grid[None] ** 2) / 2)
    assert found.mean_distance()[0] == pytest.approx((2 / np.pi) ** 0.5, rel=0.002)
    assert found.quantiles(LEVELS[None])[0] == pytest.approx(norm.ppf(LEVELS), abs=0.01 * (step / 0.5) ** 2 + 1e-4)


def test_densities_of_one_call_do_not_mix() -> None:
    grid = np.linspace(-12, 12, 401)
    means, widths = np.array([-2.0, 0.0, 3.0]), np.array([0.5, 1.0, 1.5])
    found = densities(np.broadcast_to(grid, (3, 401)), -(((grid - means[:, None]) / widths[:, None]) ** 2) / 2)
    assert found.mean_distance() == pytest.approx(widths * (2 / np.pi) ** 0.5, rel=1e-4)
    expected = means[:, None] + widths[:, None] * norm.ppf(LEVELS)
    assert found.quantiles(np.tile(LEVELS, (3, 1))) == pytest.approx(expected, abs=2e-3)


def test_a_density_cut_off_by_the_range() -> None:
    grid = np.linspace(0, 40, 801)
    found = densities(grid[None], -grid[None])
    assert found.quantiles(np.array([[0.5]]))[0, 0] == pytest.approx(np.log(2), rel=1e-5)
    assert found.mean_distance()[0] == pytest.approx(np.log(2), rel=1e-5)


def test_a_cliff_between_two_nodes_misplaces_no_more_than_a_cell() -> None:
    grid = np.linspace(0, 1, 129)
    for edge in np.linspace(0.3, 0.31, 7):
        # Even above the edge, and impossible below it within a thousandth of a cell.
        log_density = -(np.maximum((edge - grid) / 8e-6, 0.0) ** 2)
        found = densities(grid[None], log_density[None])
        assert found.quantiles(np.array([[0.5]]))[0, 0] == pytest.approx((1 + edge) / 2, abs=0.6 / 128)
        assert found.mean_distance()[0] == pytest.approx((1 - edge) / 4, abs=0.6 / 128)
