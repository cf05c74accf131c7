"""The power of the test that knows what happened, in `design-sensors challenge`."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2, norm

from beamtouch_models.challenge import faults
from beamtouch_models.challenge.play import Case, drawn
from beamtouch_models.challenge.power import distances, power_of_noise, power_of_shift
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.error_model import whitening


def whitened(surface: SimulatedSurface, fault_mm: np.ndarray) -> np.ndarray:
    covariance = np.eye(surface.channels) * surface.min_noise_mm**2
    floor = surface.metadata.floor
    return whitening(fault_mm, covariance, floor.gain, floor.zero_mm)


CASES = (
    Case(False, lambda *a: faults.pulled(*a, times=0.25)),
    Case(False, lambda *a: faults.two_contacts(*a, apart=0.5, ratio=1.0)),
    Case(False, faults.stuck),
)


@pytest.mark.parametrize("case", CASES, ids=["pull", "two contacts", "stuck"])
def test_the_distance_of_a_fault_is_that_of_the_nearest_contact_or_of_rest(
    surface: SimulatedSurface, case: Case
) -> None:
    fault = case.make(surface, 6, np.random.default_rng(7)).fault_mm
    assert fault is not None
    found = distances(surface, fault, np.ones(fault.shape, np.bool_))
    for row, weights, distance in zip(fault, whitened(surface, fault), found, strict=True):

        def away(at: np.ndarray, row: np.ndarray = row, weights: np.ndarray = weights) -> float:
            place, force = float(np.clip(at[0], 1.0, 399.0)), max(float(at[1]), 0.0)
            return float(np.linalg.norm(weights @ (row - force * surface.influence(place))))

        starts = [np.array([place, force]) for place in np.linspace(1, 399, 30) for force in (0.5, 5.0, 15.0)]
        least = min(minimize(away, start, method="Nelder-Mead").fun for start in sorted(starts, key=away)[:3])
        assert distance == pytest.approx(min(least, away(np.zeros(2))), rel=2e-3, abs=2e-3)


def test_the_power_is_that_of_the_likelihood_ratio_and_no_misfit_does_better(surface: SimulatedSurface) -> None:
    alpha, random = 1e-3, np.random.default_rng(8)
    fault = faults.two_contacts(surface, 60, random, apart=0.5, ratio=1.0).fault_mm
    assert fault is not None
    every = np.ones(fault.shape, np.bool_)
    distance = distances(surface, fault, every)
    power = power_of_shift(distance, alpha)
    assert 0.3 < power < 0.9
    weights = whitened(surface, fault)
    grid = np.linspace(1, 399, 2001)
    ratio, misfit = [], []
    for row, weight in zip(fault, weights, strict=True):
        shape = surface.influence(grid) @ weight.T
        unit = shape / np.linalg.norm(shape, axis=1, keepdims=True)
        moved = weight @ row
        along = unit @ moved
        nearest = np.argmax(along)
        between = moved - max(along[nearest], 0.0) * unit[nearest]
        sample = moved + random.normal(size=(400, 4))
        ratio.append((sample - (moved - between)) @ between / np.linalg.norm(between) > norm.isf(alpha))
        best = np.maximum(sample @ unit.T, 0.0).max(axis=1)
        misfit.append((sample**2).sum(axis=1) - best**2 > chi2.isf(alpha, 2))
    assert np.mean(ratio) == pytest.approx(power, abs=0.01)
    assert np.mean(misfit) < power + 0.01


def test_the_power_for_a_noisy_channel_is_that_of_its_direction(surface: SimulatedSurface) -> None:
    alpha, random, draws = 1e-2, np.random.default_rng(9), 60
    position, force = drawn(surface, draws, random)
    clean = surface.under(position, force)
    noise = np.ones(clean.shape)
    noise[np.arange(draws), random.integers(4, size=draws)] = 30.0
    power = power_of_noise(surface, clean, noise, alpha)
    assert 0.2 < power < 0.9
    seen = []
    least_mm, floor = surface.min_noise_mm, surface.metadata.floor
    for at, row, loud, weight in zip(position, clean, noise, whitened(surface, clean), strict=True):
        deviation = np.sqrt((loud * least_mm) ** 2 + (np.array(floor.gain) * row) ** 2 + np.square(floor.zero_mm))
        error = random.normal(size=(1000, 4)) * deviation @ weight.T
        tangent = np.stack([surface.influence(at), surface.influence(at, 1)], axis=1)
        basis = np.linalg.qr(weight @ tangent)[0]
        left = weight[:, np.argmax(loud)]
        left = left - basis @ (basis.T @ left)
        seen.append(np.abs(error @ left / np.linalg.norm(left)) > norm.isf(alpha / 2))
    assert np.mean(seen) == pytest.approx(power, abs=0.02)
