"""The covariance of filtered means: the noise's own at rest, and honest while a beam is touched, rings or moves."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from beamtouch_models.filters import Chain, Filtered, FloatArray, Mean
from models.covariance_cases import FILTER, NOISE_MM, PERIOD, RATE_HZ


def evidence(filtered: Filtered, samples: slice) -> FloatArray:
    """Evidence against rest [nats], shape (samples,): half the squares of the means, under covariance and floor."""
    mean = filtered.mean_mm[samples]
    total = filtered.covariance_mm2[samples] + np.eye(mean.shape[1]) * (NOISE_MM / 5) ** 2
    there = ~np.isnan(mean)
    deflection = np.where(there, mean, 0.0)
    found: FloatArray = (deflection * np.linalg.solve(total, deflection[..., np.newaxis])[..., 0]).sum(axis=1) / 2
    return found


PATTERN = np.array([0.3, 0.8, 1.0, 0.6])
GHOST = 17.0
"""Log odds from which the bench is touched."""


@pytest.mark.parametrize("amplitude", [8, 16])
def test_ringing_that_looks_like_spikes_is_motion(amplitude: float) -> None:
    """Medians of three readings of a mode at 0.36 of the rate of the readings swing slowly about another place."""
    random = np.random.default_rng(11)
    ghosts = np.zeros(0)
    for phase in random.uniform(0, 2 * math.pi, 20):
        swing = np.sin(2 * math.pi * 0.36 * np.arange(200) + phase) * np.exp(-np.arange(200) / 150)
        values = NOISE_MM * (amplitude * swing[:, np.newaxis] * PATTERN + random.standard_normal((200, 4)))
        ghosts = np.append(ghosts, evidence(Chain(FILTER, 4, NOISE_MM, 14.0).apply(values), slice(40, None)))
    assert (ghosts > GHOST).mean() <= 1e-3


@pytest.mark.parametrize("lost", [-30.0, 30.0])
def test_a_mean_of_the_half_waves_within_the_range_is_doubtful(lost: float) -> None:
    """The beam rings about rest, and swings beyond the range of the sensors on one side."""
    random = np.random.default_rng(12)
    ghosts = np.zeros(0)
    for phase in random.uniform(0, 2 * math.pi, 20):
        swing = np.sin(2 * math.pi * 0.22 * np.arange(200) + phase)
        values = 100 * swing[:, np.newaxis] * PATTERN + random.standard_normal((200, 4))
        values[values < lost - 50 * (1 - PATTERN)] = math.nan
        filtered = Chain(FILTER, 4, NOISE_MM, PERIOD).apply(NOISE_MM * values)
        ghosts = np.append(ghosts, evidence(filtered, slice(40, None)))
    assert (ghosts > GHOST).mean() <= 1e-3


@pytest.mark.parametrize("what", ["spike", "missing", "spike on all channels", "missing on all channels"])
def test_a_lone_spike_or_a_lone_lost_reading_at_rest_is_harmless(what: str) -> None:
    values = NOISE_MM * np.random.default_rng(14).standard_normal((10_000, 4))
    rows = np.arange(100, len(values), 50)
    values[rows, slice(None) if "all" in what else 2] = math.nan if "missing" in what else 1.0
    filtered = Chain(FILTER, 4, NOISE_MM, PERIOD).apply(values)
    at_rest = np.ones(len(values), dtype=np.bool_)
    at_rest[rows] = False  # while it is the newest, a spike may be a touch
    assert filtered.moves[at_rest].mean() <= 0.012
    assert filtered.relative_variance[rows[0] + 1, 2] <= 0.5


CHAINS = {
    "none": Mean(),
    "spike": Mean(spike_mm=6.0),
    "mean": Mean("moving-average", 4, spike_mm=6.0),
    "long mean": Mean("moving-average", 50),
}


@pytest.mark.parametrize(("kind", "channels"), [*((kind, 2) for kind in CHAINS), ("mean", 8)])
def test_a_beam_at_rest_has_the_noise_of_its_filter_and_nothing_else(kind: str, channels: int) -> None:
    white = np.random.default_rng(6).standard_normal((40_000 // channels, channels))
    filtered = Chain(CHAINS[kind], channels, 1.0, 20.0).apply(white)
    settled = slice(400, None)
    measured = np.cov(filtered.mean_mm[settled].T)
    stated = filtered.covariance_mm2[settled]
    assert filtered.moves[settled].mean() <= 0.01
    independent = len(filtered.mean_mm[settled]) * filtered.relative_variance[-1, 0]
    np.testing.assert_allclose(np.diag(measured), filtered.relative_variance[-1], rtol=5 * math.sqrt(2 / independent))
    ratio = np.trace(stated, axis1=1, axis2=2) / filtered.relative_variance[settled].sum(axis=1)
    assert np.median(ratio) == pytest.approx(1)
    assert ratio.mean() <= 1.2
    still = stated[~filtered.moves[settled]]
    sign, logarithm = np.linalg.slogdet(still)
    assert (sign == 1).all()
    expected = np.log(filtered.relative_variance[settled][~filtered.moves[settled]]).sum(axis=1)
    np.testing.assert_allclose(logarithm, expected, rtol=1e-9)


def test_a_spike_is_doubtful_until_the_next_reading_shows_that_it_was_one() -> None:
    values = 0.01 * np.random.default_rng(10).standard_normal((60, 3))
    values[50, 1] += 5
    filtered = Chain(Mean("moving-average", 4, spike_mm=1.0), 3, 0.01).apply(values)
    covariance = filtered.covariance_mm2
    assert covariance[50, 1, 1] > 20  # of 25: it may be a touch
    assert covariance[51, 1, 1] == pytest.approx(1e-4 / 3)
    assert not covariance[51, 1, [0, 2]].any()


def test_a_channel_without_a_reading_has_a_zero_row_and_the_others_keep_their_doubt() -> None:
    time_s = np.arange(100) / RATE_HZ
    values = np.sin(2 * math.pi * 44 * time_s)[:, np.newaxis] * [1.0, 2.0, 3.0]
    values[60:, 1] = np.nan
    covariance = Chain(Mean("moving-average", 4), 3, 0.01, 20.0).apply(values).covariance_mm2[-1]
    assert not covariance[1].any()
    assert not covariance[:, 1].any()
    correlation = covariance[0, 2] / math.sqrt(covariance[0, 0] * covariance[2, 2])
    assert correlation > 0.99


@pytest.mark.parametrize("kind", CHAINS)
@settings(max_examples=30)
@given(data=st.data())
def test_a_covariance_is_finite_and_positive_at_any_scale(kind: str, data: st.DataObject) -> None:
    noise_mm = data.draw(st.sampled_from([0.0, 1e-3, 10.0]))
    unit = st.sampled_from([0.0, 1e-6, 1e-3, 1.0, 1e3])
    readings = arrays(np.float64, (data.draw(st.integers(1, 25)), 3), elements=st.floats(-1, 1) | st.just(math.nan))
    values = data.draw(readings) * data.draw(unit) + data.draw(unit)
    period = data.draw(st.sampled_from([0.0, 12.0]))
    covariance = Chain(CHAINS[kind], 3, noise_mm, period).apply(values).covariance_mm2
    assert np.isfinite(covariance).all()
    np.testing.assert_array_equal(covariance, covariance.transpose(0, 2, 1))
    least = np.linalg.eigvalsh(covariance)[:, 0]
    assert (least >= -1e-12 * np.trace(covariance, axis1=1, axis2=2)).all()
