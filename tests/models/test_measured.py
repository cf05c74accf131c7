"""What is measured of an estimator: the threshold of contact, the accuracy, the golden answers."""

import numpy as np
import pytest

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.rest import FALSE_ALARM_RATE, contact_threshold
from beamtouch_models.building.measured import _for_odds, measured
from beamtouch_models.estimators.estimator import estimator_of
from beamtouch_models.export import to_bytes
from beamtouch_models.session import runner
from posterior_cases import answers_of, graph_of, prior_of


@pytest.mark.parametrize("sensors", [2, 5])
@pytest.mark.parametrize("rate", [1e-2, 1e-3])
def test_samples_at_rest_exceed_the_threshold_at_the_stated_rate(sensors: int, rate: float) -> None:
    prior = prior_of("bench", sensors, 1.0, known=False)
    made = estimator_of("posterior", prior, with_force=False, seed=0, progress=lambda _done: None)
    run = runner(to_bytes(_for_odds(made.graph)))
    threshold = contact_threshold(prior, run, 3, rate)
    draws = 200_000
    rest = np.random.default_rng(9).normal(scale=prior.noise_mm, size=(draws, sensors)).astype(np.float32)
    found = (run(rest, np.ones(rest.shape, np.bool_))["contact_log_odds"] > threshold).mean()
    assert found == pytest.approx(rate, abs=4 * (rate / draws) ** 0.5 + 0.05 * rate)


def test_the_threshold_of_a_single_channel_is_the_normal_tail() -> None:
    # One channel on a beam whose influence is the same everywhere: the odds grow with the reading, and the rarest
    # millionth of a normal distribution lies above 4.7534 deviations (tables; scipy.stats.norm.isf agrees).
    prior = prior_of("cantilever", 1, 2.0, known=True)
    made = estimator_of("posterior", prior, with_force=False, seed=0, progress=lambda _done: None)
    run = runner(to_bytes(_for_odds(made.graph)))
    threshold = contact_threshold(prior, run, 1, FALSE_ALARM_RATE)
    reading = np.linspace(0, 8, 8001, dtype=np.float32)[:, None] * np.float32(prior.noise_mm)
    odds = run(reading, np.ones(reading.shape, np.bool_))["contact_log_odds"]
    assert (np.diff(odds) >= -1e-4).all()
    assert reading[np.searchsorted(odds, threshold), 0] / prior.noise_mm == pytest.approx(4.7534, abs=0.03)


def test_the_odds_alone_are_those_of_the_whole() -> None:
    prior = prior_of("bench", 4, 1.0, known=False)
    graph = graph_of(prior)
    readings = limit.draw(prior, 1000, 2).deflection_mm
    alone = answers_of(_for_odds(graph), readings)
    assert list(alone) == ["contact_log_odds"]
    assert np.array_equal(alone["contact_log_odds"], answers_of(graph, readings)["contact_log_odds"])


def test_the_same_seed_measures_the_same() -> None:
    prior = prior_of("bench", 2, 1.0, known=False)
    made = estimator_of("posterior", prior, with_force=True, seed=4, progress=lambda _done: None)
    first, second = measured(made, prior, 4), measured(made, prior, 4)
    assert first == second
    assert first.accuracy.ratio == pytest.approx(1, abs=0.01)
    # Four thousand plain contacts leave 1.2 % at best.
    assert 0 < first.accuracy.limit_standard_error < 0.01 * first.accuracy.limit_percent
    assert 0 < first.accuracy.error_standard_error < 0.01 * first.accuracy.error_percent
    assert first.accuracy.ratio_standard_error is not None
    assert first.accuracy.ratio_standard_error < 0.001
    assert first.golden.answers["force_n"][0] > 0
