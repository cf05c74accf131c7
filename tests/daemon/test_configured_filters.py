"""The configured chain of filters: any split gives the same, nothing drifts, and a restart forgets."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_daemon.config.signal import Filter, GrowingMean, MovingAverage, NoFilter
from beamtouch_daemon.processing.filters import stages
from beamtouch_models.filters import Chain, FloatArray

RATE_HZ = 200.0
NOISE = np.ones(2)
WHITE = np.random.default_rng(7).standard_normal((50_000, 2))


def column(*values: float) -> FloatArray:
    return np.array(values, dtype=np.float64)[:, np.newaxis]


@pytest.mark.parametrize(
    "kind",
    [
        MovingAverage(kind="moving-average", window=8),
        MovingAverage(kind="moving-average", window=8, spike_mm=0.5),
    ],
)
def test_nothing_drifts_however_much_has_passed(kind: Filter) -> None:
    chain = Chain(stages(kind, RATE_HZ, NOISE), 2)
    for _ in range(20):
        chain.apply(1e12 + 1e9 * WHITE[:50_000])
    chain.apply(np.full((3, 2), 1e21))  # what a sum that runs on would hold after 1e9 readings of 1e12
    new = Chain(stages(kind, RATE_HZ, NOISE), 2)
    after, untouched = (used.apply(np.full((16, 2), 0.1)).mean_mm[8:] for used in (chain, new))
    np.testing.assert_array_equal(after, untouched)  # to the bit, after a million large ones


def test_a_restart_forgets_earlier_values() -> None:
    chain = Chain(stages(MovingAverage(kind="moving-average", window=2, spike_mm=0.1), RATE_HZ, NOISE), 1)
    chain.apply(column(7, 7, 7))
    chain.restart()
    assert chain.apply(column(1, 1)).mean_mm[:, 0].tolist() == [1, 1]


streams = st.lists(st.tuples(*[st.floats(-1e3, 1e3) | st.just(math.nan)] * 2), min_size=1, max_size=40).map(
    lambda rows: np.array(rows, dtype=np.float64)
)
kinds = st.sampled_from(
    [
        NoFilter(spike_mm=0.5),
        MovingAverage(kind="moving-average", window=5, spike_mm=0.5),
        MovingAverage(kind="moving-average", window=1),
        GrowingMean(kind="growing-mean", max_mean_ms=1.0),
        GrowingMean(kind="growing-mean", max_mean_ms=60.0),
        GrowingMean(kind="growing-mean", max_mean_ms=130.0, spike_mm=6.0),
    ]
)


@given(values=streams, kind=kinds, data=st.data())
def test_any_split_of_the_stream_gives_the_same_to_the_bit(
    values: FloatArray, kind: Filter, data: st.DataObject
) -> None:
    cuts = sorted(data.draw(st.lists(st.integers(0, len(values)), max_size=6), label="cuts"))
    period = data.draw(st.sampled_from([0.0, 7.5, 40.0]), label="period")
    noise_mm = data.draw(st.sampled_from([0.0, 1e-3, 300.0]), label="noise")
    whole = Chain(stages(kind, RATE_HZ, NOISE), 2, noise_mm, period).apply(values)
    chain = Chain(stages(kind, RATE_HZ, NOISE), 2, noise_mm, period)
    pieces = [chain.apply(piece) for piece in np.split(values, cuts)]
    for name in ("mean_mm", "relative_variance", "moves", "covariance_mm2"):
        np.testing.assert_array_equal(np.concatenate([getattr(piece, name) for piece in pieces]), getattr(whole, name))
    assert np.isnan(whole.mean_mm)[np.isnan(values)].all()


def test_an_average_begins_when_half_of_its_window_is_there() -> None:
    chain = Chain(stages(MovingAverage(kind="moving-average", window=8), RATE_HZ, NOISE), 1)
    values = np.arange(10.0)[:, np.newaxis]
    values[7] = np.nan
    filtered = chain.apply(values).mean_mm[:, 0]
    np.testing.assert_array_equal(filtered[:6], [np.nan] * 3 + [1.5, 2.0, 2.5])
    np.testing.assert_array_equal(filtered[6:], [3.0, np.nan, (36 - 7) / 7, (45 - 8) / 7])
