"""The covariance of filtered means covers their error while a simulated beam is touched and rings."""

import numpy as np
import pytest
from scipy.stats import chi2

from beamtouch_models.filters import Chain, FloatArray
from beamtouch_models.lab.challenge.contacts import touched
from beamtouch_models.lab.challenge.play import DrawnContacts, Play, SimulatedSurface
from beamtouch_models.lab.challenge.ringing import rings
from models.covariance_cases import FILTER, NOISE_MM, PERIOD

BEFORE, LOADS = 60, 80
"""Readings at rest before a load, more than the filter looks back, and loads."""


def held(play: Play, still_mm: FloatArray, samples: list[int], noise: np.random.Generator) -> FloatArray:
    """Share of the loads whose normalised error is within its 95 % quantile, for each of the samples.

    The truth is the deflection at rest under each load, (loads, sensors).
    """
    inside, first = np.zeros(len(samples)), min(samples) - BEFORE
    chain = Chain(FILTER, 4, NOISE_MM, PERIOD)
    for readings, true_mm in zip(play.deflection_mm[:, first:], still_mm, strict=True):
        chain.restart()
        filtered = chain.apply(readings + NOISE_MM * noise.standard_normal(readings.shape))
        for index, at in enumerate(samples):
            mean = filtered.mean_mm[at - first]
            floor = np.diag((0.003 * mean) ** 2 + (NOISE_MM / 5) ** 2)
            total, error = filtered.covariance_mm2[at - first] + floor, mean - true_mm
            inside[index] += error @ np.linalg.solve(total, error) <= chi2.ppf(0.95, 4)
    return inside / LOADS


def test_at_the_touch_of_a_beam_that_follows_at_once_the_error_is_covered_at_every_reading(
    surface: SimulatedSurface,
) -> None:
    drawn = DrawnContacts.of(surface, LOADS, np.random.default_rng(3))
    play = touched(drawn)
    samples = [play.rows[0][1] + reading for reading in (0, 1, 2, 3, 4, 8, 20, 100)]
    assert held(play, drawn.deflection_mm, samples, drawn.rng).min() >= 0.93


@pytest.mark.parametrize("lasting_s", [0.0, 0.03])
def test_while_the_beam_rings_the_error_is_covered(surface: SimulatedSurface, lasting_s: float) -> None:
    drawn = DrawnContacts.of(surface, LOADS, np.random.default_rng(4))
    play = rings(drawn, lasting_s=lasting_s)
    samples = [reading for name, reading in play.rows if not name.endswith(" 20 ms")]
    assert held(play, drawn.deflection_mm, samples, drawn.rng).min() >= 0.93
