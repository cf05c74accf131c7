"""Two sinusoids that become the same one, of any size and decay, leave a fit with a finite, positive covariance."""

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray
from beamtouch_models.filters.sinusoids import Band, Poles, fit

BAND = Band(0.01)
"""Angular frequencies that are allowed."""


@pytest.mark.parametrize("apart", [0.0, 1e-9, 1e-5, 0.3])
def test_poles_that_meet_leave_a_finite_positive_covariance(apart: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(500):
        readings, channels = rng.integers(6, 60), rng.integers(1, 9)
        ages: FloatArray = np.arange(float(readings)) - readings + 1.0  # a swing may have been 1e9 times as large
        values: FloatArray = rng.normal(size=(readings, channels)) * 10 ** rng.uniform(-1, 5)
        frequency, decay = rng.uniform(BAND.lowest, np.pi), rng.uniform(0.0, 0.5)
        poles = Poles(np.array([decay, decay]), np.array([frequency, frequency + apart])).within(BAND)

        found = fit(ages, values, poles, BAND, slopes=bool(rng.integers(2)))

        assert np.isfinite(found.coefficients).all()
        assert np.linalg.eigvalsh(found.covariance).min() > 0
