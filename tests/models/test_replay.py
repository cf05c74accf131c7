"""Simulated readings behind the filter of the daemon: every draw as that filter and its zeros take it by themselves."""

from typing import NamedTuple

import numpy as np
import pytest

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.replay import replay
from beamtouch_models.filters import Chain, Mean, Walk, Zeros

DRAWS, READINGS, CHANNELS = 3, 60, 4
NOISE_MM, RATE_HZ, PERIOD = 0.002, 200.0, 9.0
WALK = Walk(rate_mm_per_min=0.05, max_mm=0.05, start_mm=0.0001)


class Played(NamedTuple):
    readings_mm: Floats
    came: Bools


@pytest.fixture
def chain() -> Chain:
    return Chain(Mean("growing-mean", 4, 40, 6 * NOISE_MM), CHANNELS, NOISE_MM, PERIOD)


@pytest.fixture
def played() -> Played:
    """Touches after which the beam rings, with readings that are lost, and some of one channel that are not good."""
    rng, since = np.random.default_rng(1), np.arange(READINGS) - 20
    load_mm = np.where(since < 0, 0.0, 1 - np.cos(2 * np.pi * since / PERIOD) * np.exp(-0.05 * since))
    shape_mm = rng.uniform(0.05, 0.2, size=(DRAWS, 1, CHANNELS))
    readings_mm = load_mm[:, None] * shape_mm + rng.normal(size=(DRAWS, READINGS, CHANNELS)) * NOISE_MM
    readings_mm[:, 30:33, 1] = np.nan
    came = rng.uniform(size=(DRAWS, READINGS)) > 0.1
    came[:, 40:45] = False
    return Played(readings_mm, came)


def test_each_draw_has_the_samples_that_the_filter_makes_of_it_alone(chain: Chain, played: Played) -> None:
    samples = replay(chain, played.readings_mm)

    for draw, readings_mm in enumerate(played.readings_mm):
        chain.restart()
        filtered = chain.apply(readings_mm)
        mean_mm = np.where(np.isnan(readings_mm), np.nan, filtered.mean_mm)
        assert np.array_equal(samples.mean_mm[draw], mean_mm, equal_nan=True)
        assert np.array_equal(samples.covariance_mm2[draw], filtered.covariance_mm2)
        assert np.array_equal(samples.relative_variance[draw], filtered.relative_variance, equal_nan=True)
    assert np.isnan(samples.mean_mm[:, 30:33, 1]).all()
    assert np.isfinite(np.delete(samples.mean_mm, 1, axis=2)[:, 2:]).all()
    assert not samples.drift_mm.any()


def test_samples_that_are_asked_for_are_those_of_all_readings(chain: Chain, played: Played) -> None:
    tracking, asked = (WALK, Zeros(WALK, RATE_HZ, NOISE_MM, 0.0, PERIOD, CHANNELS)), [0, 21, 31, 42, 50]

    whole = replay(chain, played.readings_mm, came=played.came, tracking=tracking)
    part = replay(chain, played.readings_mm, asked, came=played.came, tracking=tracking)

    for name in ("mean_mm", "covariance_mm2", "relative_variance", "drift_mm"):
        assert np.array_equal(getattr(part, name), getattr(whole, name)[:, asked], equal_nan=True)


def test_a_lost_reading_has_no_sample_and_the_filter_knows_of_it(chain: Chain, played: Played) -> None:
    samples = replay(chain, played.readings_mm, came=played.came)

    assert np.isnan(samples.mean_mm[~played.came]).all()
    assert not samples.covariance_mm2[~played.came].any()
    for draw, (readings_mm, came) in enumerate(zip(played.readings_mm, played.came, strict=True)):
        there = np.flatnonzero(came)
        chain.restart()
        filtered = chain.apply(readings_mm[there], (np.diff(there, prepend=-1) - 1).tolist())
        assert np.array_equal(samples.covariance_mm2[draw, there], filtered.covariance_mm2)
    assert not np.array_equal(samples.covariance_mm2, replay(chain, played.readings_mm).covariance_mm2)


def test_zeros_that_walk_are_subtracted_and_what_they_may_have_drifted_is_stated(chain: Chain) -> None:
    walked_mm = 2 * NOISE_MM * np.linspace(0, 1, 1200)[:, None] * np.ones(CHANNELS)
    noise_mm = np.random.default_rng(2).normal(size=(DRAWS, 1200, CHANNELS)) * NOISE_MM
    tracking = WALK, Zeros(WALK, RATE_HZ, NOISE_MM, 0.0, PERIOD, CHANNELS)

    stays, tracked = (replay(chain, walked_mm + noise_mm, tracking=each) for each in (None, tracking))

    assert np.abs(stays.mean_mm[:, 1000:].mean()) > 1.5 * NOISE_MM
    assert np.abs(tracked.mean_mm[:, 1000:].mean()) < 0.5 * NOISE_MM
    assert tracked.drift_mm.any()
    assert not stays.drift_mm.any()


def test_no_readings_are_no_samples(chain: Chain, played: Played) -> None:
    assert replay(chain, played.readings_mm, []).mean_mm.shape == (DRAWS, 0, CHANNELS)
    assert np.isnan(replay(chain, played.readings_mm, came=np.zeros_like(played.came)).mean_mm).all()
