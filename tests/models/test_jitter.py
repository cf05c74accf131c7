"""A beam that rings, read at times that its stamps do not say exactly: the fit allows for that, and is no surer."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from beamtouch_models.filters import Chain, FloatArray, Mean
from beamtouch_models.filters.jitter import refit
from beamtouch_models.filters.sinusoids import Band, Fit, Poles, fit, refine, seek

LOAD = np.array([150.0, 400.0, 380.0, 200.0])
"""Deflection of a touch, in units of the noise."""
FREQUENCY, DECAY = 2 * np.pi * 0.22, 0.02
"""Angular, and decay, per reading."""
BAND, MOST = Band(0.25), 0.3
ROWS = 30


def swinging(times: FloatArray) -> FloatArray:
    """Return the deflection under a sudden force, (times, channels)."""
    rung = np.exp(-DECAY * times) * np.cos(FREQUENCY * times)
    bent: FloatArray = (1 - rung)[:, np.newaxis] * LOAD
    return bent


def read(jitter: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the stamps before the newest one, the readings, and what the stamps are off."""
    random = np.random.default_rng(seed)
    off = jitter * random.standard_normal(ROWS)
    values = swinging(np.arange(1.0, ROWS + 1) + off) + random.standard_normal((ROWS, len(LOAD)))
    return np.arange(1.0, ROWS + 1) - ROWS, values, off


def begun(times: FloatArray, values: FloatArray) -> Fit:
    """Return a fit with one pole that takes stamps for exact."""
    without = fit(times, values, Poles.none(), BAND, slopes=False)
    return refine(times, values, seek(without, times, values, BAND), BAND, slopes=False, steps=2)


@pytest.mark.parametrize("jitter", [0.02, 0.1, 0.25])
def test_the_constant_is_as_far_off_as_its_covariance_says(jitter: float) -> None:
    squares, found = [], []
    for seed in range(60):
        times, values, _ = read(jitter, seed)
        told, _ = refit(begun(times, values), times, values, BAND, MOST)
        apart = told.constant - LOAD
        squares.append(apart @ np.linalg.solve(told.covariance, apart) / len(LOAD))
        found.append(told.jitter)
    assert 0.6 < np.mean(squares) < 1.6
    assert np.median(found) == pytest.approx(jitter, rel=0.25)


def test_the_fit_is_that_of_one_who_knows_no_stamp_and_fits_each() -> None:
    times, values, _ = read(0.1, 1)
    told, _ = refit(begun(times, values), times, values, BAND, MOST)

    def left(parameters: FloatArray) -> FloatArray:
        constant, cosine, sine = parameters[:12].reshape(3, 4)
        decay, frequency, off = parameters[12], parameters[13], parameters[14:]
        wave = np.exp((1j * frequency - decay) * (times + off))[:, np.newaxis]
        apart = values - constant - wave.real * cosine - wave.imag * sine
        return np.concatenate([apart.ravel(), off / told.jitter])

    first = np.concatenate([told.coefficients.ravel(), told.poles.decay, told.poles.frequency, np.zeros(ROWS)])
    by_scipy = least_squares(left, first, xtol=1e-12, ftol=1e-12)
    deviation = np.sqrt(np.diag(told.covariance))
    assert np.abs((told.constant - by_scipy.x[:4]) / deviation).max() < 1.0
    spread = np.linalg.inv(by_scipy.jac.T @ by_scipy.jac)
    assert deviation == pytest.approx(np.sqrt(np.diag(spread))[:4], rel=0.25)


@pytest.mark.parametrize("jitter", [0.04, 0.2])
def test_a_beam_that_rings_is_known_although_stamps_are_off(jitter: float) -> None:
    found, errors = 0, []
    for seed in range(20):
        random = np.random.default_rng(seed)
        chain = Chain(Mean("growing-mean", 4, 200, 6.0), len(LOAD), 1.0, 20.0)
        off = jitter * random.standard_normal(240)
        since = np.arange(240.0) - 200 + off
        loaded = np.where((since >= 0)[:, np.newaxis], swinging(np.maximum(since, 0.0)), 0.0)
        filtered = chain.apply(loaded + random.standard_normal(loaded.shape))
        deviation = np.sqrt(np.diag(filtered.covariance_mm2[-1]) + filtered.relative_variance[-1])
        if deviation.max() < 0.1 * LOAD.max():
            found += 1
            errors.append(np.abs(filtered.mean_mm[-1] - LOAD) / deviation)
    assert found >= 16
    assert np.mean(np.array(errors) < 2) > 0.9


@pytest.mark.parametrize("channels", [2, 4])
def test_a_load_that_comes_softly_is_no_swing_whose_stamps_are_off(channels: int) -> None:
    load, told = LOAD[:channels] * 0.75, 0
    for seed in range(3):
        chain = Chain(Mean("growing-mean", 4, 200, 6.0), channels, 1.0, 20.0)
        since = np.arange(240.0) - 200
        come = load * (1 - np.exp(-np.maximum(since, 0.0) / 6))[:, np.newaxis]
        filtered = chain.apply(come + np.random.default_rng(seed).standard_normal(come.shape))
        for at in range(208, 240):
            covariance = filtered.covariance_mm2[at] + np.eye(channels) * filtered.relative_variance[at]
            apart = min((filtered.mean_mm[at] - there for there in (come[at], load)), key=lambda a: float(a @ a))
            told += float(apart @ np.linalg.solve(covariance, apart)) > 4 * channels
    assert told == 0
