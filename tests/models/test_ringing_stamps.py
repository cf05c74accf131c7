"""A beam that rings while the times of readings are wrong, or most readings are lost: the filter goes on."""

from collections.abc import Callable

import numpy as np
import pytest

from beamtouch_models.filters import Chain, FloatArray, Mean

READINGS, CHANNELS = 400, 4
SIZES = {0.0: (5, 7, 100, 250), 0.7: (1, 7, 100, 250)}
"""Of the parts that reach the filter at once, by the share of lost readings and by seed."""
PERIODS = 20.0, 140.0, 20.0, 140.0
"""Of the slowest motion, in readings, by seed. Of the longer one, the filter takes seven readings together."""
STAMPS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "right": lambda times: times,
    "all the same": lambda times: np.full(len(times), 1.7e12),
    "stopped, again and again": lambda times: times // 100 * 100 + np.minimum(times % 100, 60.0),
    "ten at a time the same": lambda times: times // 10 * 10,
    "back by one, each ten": lambda times: times - times // 10,
    "back by a hundred, once": lambda times: times - 100 * (times > READINGS / 2),
    "backwards": lambda times: -times,
    "two hours earlier, once": lambda times: times - 1.44e6 * (times > READINGS / 2),
    "not known, now and then": lambda times: np.where(np.sin(times) > 0.5, np.nan, times),
    "not known for a while": lambda times: np.where(times // 50 % 2 == 1, np.nan, times),
    "two hours later, once": lambda times: times + 1.44e6 * (times > READINGS / 2),
    "too slow by a twentieth": lambda times: 0.95 * times,
    "hundred times too fast": lambda times: 100 * times,
    "scattered": lambda times: times + np.random.default_rng(0).normal(scale=3.0, size=len(times)),
}


def rung(seed: int) -> FloatArray:
    """Return readings of loads that come at once and then slide or grow, in units of the noise."""
    rng, at = np.random.default_rng(seed), np.arange(float(READINGS))
    values: FloatArray = rng.standard_normal((READINGS, CHANNELS))
    for _ in range(3):
        since = at - rng.uniform(40, READINGS)
        later, load = np.maximum(since, 0.0), rng.normal(size=CHANNELS) * 10 ** rng.uniform(0, 5)
        swing = np.exp(-rng.choice([0.0, 0.01, 0.1]) * later) * np.cos(2 * np.pi * rng.uniform(0.03, 0.5) * later)
        values += ((since >= 0) * (1 - swing + rng.choice([0.0, 0.01, 0.2]) * later))[:, np.newaxis] * load
    return values


@pytest.mark.parametrize("stamps", STAMPS)
@pytest.mark.parametrize("lost", SIZES)
@pytest.mark.parametrize("seeds", [(1, 2), pytest.param((0, 3), marks=pytest.mark.soak)])
def test_a_sample_has_a_finite_positive_covariance_whatever_the_stamps_say(
    seeds: tuple[int, ...], stamps: str, lost: float
) -> None:
    for seed in seeds:
        came = np.flatnonzero(np.random.default_rng(seed).random(READINGS) >= lost)
        gaps, times = np.diff(came, prepend=-1) - 1, STAMPS[stamps](came.astype(np.float64))
        values, chain = rung(seed)[came], Chain(Mean("growing-mean", 4, 200, 6.0), CHANNELS, 1.0, PERIODS[seed])
        size = SIZES[lost][seed]
        for first in range(0, len(came), size):
            part = slice(first, first + size)
            with np.errstate(over="raise", divide="raise", invalid="raise"):
                filtered = chain.apply(values[part], gaps[part].tolist(), times[part].tolist())
            there = ~np.isnan(filtered.mean_mm).any(axis=1)
            assert np.isfinite(filtered.covariance_mm2).all()
            assert (np.linalg.eigvalsh(filtered.covariance_mm2[there]) > 0).all()


LOAD, PERIOD = np.array([150.0, 400.0, 380.0, 200.0]), 20.0


def rings(times: FloatArray, touch: float, lift: float) -> FloatArray:
    """Return readings of a beam that rings from a touch and from a lift, at some times."""
    bent = np.random.default_rng(3).standard_normal((len(times), CHANNELS))
    for at, size in ((touch, 1.0), (lift, -1.0)):
        later = np.maximum(times - at, 0.0)
        swing = (later > 0) * (1 - np.exp(-0.02 * later) * np.cos(2 * np.pi * 0.22 * later))
        bent += size * swing[:, np.newaxis] * LOAD
    return bent


def test_a_lift_is_seen_while_the_times_of_readings_are_not_known() -> None:
    times = np.arange(240.0)
    values = rings(times, 40.3, 150.4)
    times[150:190] = np.nan
    chain = Chain(Mean("growing-mean", 4, 200, 6.0), CHANNELS, 1.0, PERIOD)
    filtered = chain.apply(values, None, times.tolist())
    for at in range(155, 190):
        apart = filtered.mean_mm[at]
        assert apart @ np.linalg.solve(filtered.covariance_mm2[at], apart) < 40


@pytest.mark.parametrize("jump", [-90_000.0, -50.0, -36.0, 36.0, 300.0])
@pytest.mark.parametrize("lost", [0, 30, 60])
def test_a_device_that_begins_anew_with_another_clock_changes_no_load(jump: float, lost: int) -> None:
    times = np.arange(200.0)
    values, came = rings(times, 40.4, 1e9), np.ones(200, dtype=np.bool_)
    came[90 : 90 + lost] = False
    at = np.flatnonzero(came)
    gaps = (np.diff(at, prepend=-1) - 1).tolist()
    stamps = times[came] + 1e6 + np.where(at >= 90 + lost, jump, 0.0)
    chain = Chain(Mean("growing-mean", 4, 200, 6.0), CHANNELS, 1.0, PERIOD)
    filtered = chain.apply(values[came], gaps, stamps.tolist())
    for row in range(90, 110):
        apart = filtered.mean_mm[row] - LOAD
        assert apart @ np.linalg.solve(filtered.covariance_mm2[row], apart) < 40
