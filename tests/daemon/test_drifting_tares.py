"""Tares of a beam that drifts: refused although its readings scatter no more than their noise."""

import numpy as np
import pytest

from beamtouch_daemon.measuring.at_rest import NotAtRestError, rest_gaps
from beamtouch_models.filters import FloatArray

from .surfaces import NOISE_MM, counts_of, surface_of


def creeping(readings: int, noises: float, seed: int = 1) -> FloatArray:
    """Return counts of two channels with noise; the mean of the second moves by so many noises between its halves."""
    noise = NOISE_MM * np.random.default_rng(seed).standard_normal((readings, 2))
    creep = np.linspace(-noises, noises, readings) * NOISE_MM
    return counts_of(noise + np.outer(creep, [0.0, 1.0]))


@pytest.mark.parametrize("noise_mm", [NOISE_MM, None])
@pytest.mark.parametrize(
    ("readings", "noises"), [(50, 2.0), (200, 1.3), (1000, 0.6), (4000, 0.35)], ids=["50", "200", "1000", "4000"]
)
def test_the_more_readings_a_tare_has_the_smaller_a_drift_is_refused(
    readings: int, noises: float, noise_mm: float | None
) -> None:
    surface = surface_of(noise_mm=noise_mm)
    for seed in range(3):
        counts = creeping(readings, noises * (-1) ** seed, seed)
        assert np.std(counts[:, 1]) < 2 * NOISE_MM / 0.0001, "its scatter alone shows nothing"
        with pytest.raises(NotAtRestError, match=r"s2 moved: standard deviation .*, drift .*, noise"):
            rest_gaps(counts, surface)


@pytest.mark.parametrize(("readings", "noises"), [(50, 0.3), (200, 0.2), (1000, 0.1), (4000, 0.05)])
def test_a_drift_that_noise_explains_is_taken(readings: int, noises: float) -> None:
    for seed in range(3):
        assert set(rest_gaps(creeping(readings, noises, seed), surface_of(noise_mm=NOISE_MM))) == {"s1", "s2"}
