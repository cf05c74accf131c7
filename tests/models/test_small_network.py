"""The small network: its gradient, its graph, and its accuracy after training."""

from itertools import pairwise

import numpy as np
import pytest

from beamtouch_models.accuracy import limit
from beamtouch_models.estimators.small_network import (
    OUTPUTS,
    Network,
    Targets,
    _layers,
    loss_and_gradient,
    train,
)
from beamtouch_models.estimators.small_network_graph import small_network_graph
from beamtouch_models.estimators.teacher import lessons
from beamtouch_models.export import to_bytes
from posterior_cases import answers_of, prior_of

PRIOR = prior_of("bench", 3, 1.0, known=False)


@pytest.fixture(scope="module")
def network() -> Network:
    """Trained for a few seconds."""
    return train(PRIOR, 1, lambda _done: None, hidden=(12, 12), examples=5000, iterations=400)


def test_the_gradient_agrees_with_differences_of_the_loss() -> None:
    rng = np.random.default_rng(0)
    sizes = (5, 4, 3, OUTPUTS)
    count = sum((fan_in + 1) * fan_out for fan_in, fan_out in pairwise(sizes))
    flat = rng.normal(size=count)
    target = Targets(rng.normal(size=(30, OUTPUTS)), rng.uniform(0.01, 1, (30, 2)), rng.uniform(size=(30, OUTPUTS)))
    features = rng.normal(size=(30, 5))
    gradient = loss_and_gradient(_layers(flat, sizes), features, target)[1]
    for index in range(0, count, 3):
        step = np.zeros(count)
        step[index] = 1e-6
        above, below = (loss_and_gradient(_layers(flat + s * step, sizes), features, target)[0] for s in (1, -1))
        assert (above - below) / 2e-6 == pytest.approx(gradient[index], rel=1e-5, abs=1e-7)


def test_the_teacher_is_the_posterior() -> None:
    taught = lessons(PRIOR, np.random.default_rng(2), 400, contacts_only=True)
    assert taught.touched.all()
    assert taught.valid.all()
    best = limit.posterior_median_mm(PRIOR, taught.deflection_mm)
    width = taught.position[:, 2] - taught.position[:, 1]
    # Next to an end of the range the interval, which does not lean on the range of the force, moves the median.
    assert (np.abs(taught.position[:, 0] - best) < 0.1 * width).mean() > 0.98
    mixed = lessons(PRIOR, np.random.default_rng(2), 400)
    assert 0 < (~mixed.touched).sum() < 200
    assert 0 < (~mixed.valid).sum(axis=1).max() < 2


def test_the_same_seed_gives_the_same_file() -> None:
    first, second = (train(PRIOR, 3, lambda _done: None, hidden=(6,), examples=500, iterations=10) for _ in range(2))
    files = [to_bytes(small_network_graph(one, with_force=True)) for one in (first, second)]
    assert files[0] == files[1]


def test_the_graph_computes_what_the_network_computes(network: Network) -> None:
    taught = lessons(PRIOR, np.random.default_rng(5), 300)
    answers = answers_of(small_network_graph(network, with_force=True), PRIOR, taught.deflection_mm, taught.valid)
    inputs = network.inputs
    raw = network.raw(inputs.features(taught.deflection_mm, taught.valid))
    centre, half = network.position_scale
    position = centre + half * raw[:, 0]
    assert answers["position_mm"] == pytest.approx(np.clip(position, *PRIOR.position_mm), abs=2e-2)
    log_force = raw[:, 4] + inputs.log_length(taught.deflection_mm, taught.valid)
    assert answers["force_n"] == pytest.approx(np.clip(np.exp(log_force), *PRIOR.force_n), rel=1e-3)
    # It does not look at its covariance, so it has no interval to give.
    assert set(answers) == {"position_mm", "force_n"}


def test_the_value_of_a_missing_channel_has_no_effect(network: Network) -> None:
    graph = small_network_graph(network, with_force=False)
    deflection = limit.draw(PRIOR, 50, 5).deflection_mm
    valid = np.ones(deflection.shape, np.bool_)
    valid[:, 1] = False
    before = answers_of(graph, PRIOR, deflection, valid)
    for rubbish in (np.nan, np.inf, -1e30, 0.0):
        deflection[:, 1] = rubbish
        after = answers_of(graph, PRIOR, deflection, valid)
        assert all(np.array_equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("missing", [None, 0])
def test_the_error_is_near_the_limit(network: Network, missing: int | None) -> None:
    drawn = limit.draw(PRIOR, 4000, 6)
    valid = np.ones(drawn.deflection_mm.shape, np.bool_)
    prior, reading = PRIOR, drawn.deflection_mm
    if missing is not None:
        valid[:, missing] = False
        prior, reading = PRIOR.without(missing), np.delete(reading, missing, axis=1)
    answers = answers_of(small_network_graph(network, with_force=True), PRIOR, drawn.deflection_mm, valid)
    best = np.abs(limit.posterior_median_mm(prior, reading) - drawn.position_mm).mean()
    # The bound after a few seconds of training; a build trains five times as long.
    assert np.abs(answers["position_mm"] - drawn.position_mm).mean() < 1.35 * best
