"""Figures with standard errors, against their scatter over many repetitions."""

import numpy as np
import pytest

from beamtouch_models.accuracy.statistics import mean_of, quantile_of, ratio_of, share_of


def test_means_scatter_by_their_standard_errors() -> None:
    rng = np.random.default_rng(1)
    samples = [rng.exponential(size=(2, 2000)) for _ in range(200)]
    weights = [rng.uniform(0.5, 1.5, 2000) for _ in range(200)]
    pairs = list(zip(samples, weights, strict=True))
    for figures, truth in (
        ([mean_of(sample[0]) for sample in samples], 1.0),
        ([mean_of(sample[0], weight) for sample, weight in pairs], 1.0),
        ([quantile_of(sample[0], 0.95) for sample in samples], -np.log(0.05)),
        ([quantile_of(sample[0], 0.95, weight) for sample, weight in pairs], -np.log(0.05)),
        ([ratio_of(sample[0] + sample[1], sample[1]) for sample in samples], 2.0),
        ([share_of(sample[0] < 0.1) for sample in samples], 1 - np.exp(-0.1)),
    ):
        values = np.array([figure.value for figure in figures])
        stated = np.array([figure.standard_error for figure in figures])
        assert values.mean() == pytest.approx(truth, abs=5 * values.std() / 200**0.5 + 0.01 * truth)
        assert stated.mean() == pytest.approx(values.std(), rel=0.2)


def test_a_weight_counts_like_repeated_cases() -> None:
    values, counts = np.arange(64.0), np.tile([1.0, 3.0], 32)
    every = np.repeat(values, counts.astype(int))
    assert mean_of(values, counts).value == pytest.approx(every.mean())
    assert quantile_of(values, 0.8, counts).value == pytest.approx(np.quantile(every, 0.8), abs=1)


def test_a_share_of_none_has_a_standard_error() -> None:
    assert share_of(np.zeros(999, np.bool_)).standard_error == pytest.approx(1e-3, rel=0.02)
