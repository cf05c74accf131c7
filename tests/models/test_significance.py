"""The quantile of the chi-square distribution against scipy."""

import pytest
from scipy.stats import chi2

from beamtouch_models.filters.significance import chi_square_quantile


@pytest.mark.parametrize("beyond", [0.01, 0.0002])
@pytest.mark.parametrize("freedom", [2, 8, 400])
def test_the_quantile_is_that_of_chi_square(freedom: int, beyond: float) -> None:
    assert chi_square_quantile(freedom, beyond) == pytest.approx(chi2.isf(beyond, freedom), rel=0.04)
