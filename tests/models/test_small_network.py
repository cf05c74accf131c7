"""The small network: its training, and that its graph answers as the posterior does, whatever the covariance."""

from collections.abc import Mapping

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from scipy.special import chdtri

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.limit import posterior_median_mm
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import rate_per_sample, touch_thresholds
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.estimators.posterior.window import windowed_graph
from beamtouch_models.design.estimators.small_network import Network, first_stage, train
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import whitening
from beamtouch_models.runtime.metadata import FORCE_OUTPUTS, POSITION_OUTPUTS
from beamtouch_models.runtime.session import runner
from models.posterior_cases import answers_of, graph_of, prior_of, with_floor
from models.rare_rest import exceeding

PRIOR = with_floor(prior_of("bench", 4, 0.2, known=False))
CONTACTS = 1000


def trained(prior: Prior) -> Network:
    """Trained for a second."""
    return train(prior, 1, lambda _done: None, fewest=2, examples=4000, iterations=300)


def graph_with(prior: Prior, network: Network) -> onnx.ModelProto:
    return windowed_graph(prior, network.table, first_stage(network), with_force=True)


@pytest.fixture(scope="module")
def network() -> Network:
    return trained(PRIOR)


@pytest.fixture(scope="module")
def graph(network: Network) -> onnx.ModelProto:
    return graph_with(PRIOR, network)


def share_held(answers: Mapping[str, NDArray[np.floating]], quantity: str, unit: str, truth: Floats) -> float:
    low, high = (answers[f"{quantity}_{end}_{unit}"] for end in ("low", "high"))
    return float(((low <= truth) & (truth <= high)).mean())


def test_the_same_seed_gives_the_same_file() -> None:
    made = (train(PRIOR, 3, lambda _done: None, fewest=2, hidden=(6,), examples=500, iterations=10) for _ in range(2))
    first, second = (to_bytes(graph_with(PRIOR, one)) for one in made)
    assert first == second


def test_training_takes_the_iterations_it_may_take_and_tells_how_far_it_is() -> None:
    told = list[float]()
    train(PRIOR, 3, told.append, fewest=2, hidden=(6,), examples=500, iterations=10)
    assert told == sorted(told)
    assert 0.9 < told[-1] <= 1


def covariances() -> dict[str, Floats]:
    """The covariance of a settled sample, and of others."""
    white = np.eye(4) * PRIOR.errors.noise_mm**2
    mode = np.sin(np.pi * np.array([0.17, 0.39, 0.61, 0.83]))
    noisy = white * np.array([1, 1, 400, 1])
    return {
        "settled": white,
        "few readings": 25 * white,
        "noisy channel": noisy,
        "rings": white + np.outer(mode, mode) * 0.05**2,
    }


@pytest.mark.parametrize(
    ("kind", "missing"), [("settled", None), ("few readings", 0), ("noisy channel", 2), ("rings", None)]
)
def test_it_answers_as_the_posterior_under_any_covariance_and_mask(
    graph: onnx.ModelProto, kind: str, missing: int | None
) -> None:
    covariance = covariances()[kind]
    drawn = draw(PRIOR, CONTACTS, 7)
    rng = np.random.default_rng(8)
    excess = covariance - np.eye(4) * PRIOR.errors.noise_mm**2
    reading = drawn.deflection_mm + rng.multivariate_normal(np.zeros(4), excess, CONTACTS)
    valid = np.arange(4) != (-1 if missing is None else missing)
    reading = np.where(valid, reading, 0.0)
    weights = whitening(reading, covariance, PRIOR.errors.gain, PRIOR.errors.zero_mm, np.tile(valid, (CONTACTS, 1)))
    found, exact = (runner(to_bytes(one))(reading, weights) for one in (graph, graph_of(PRIOR)))
    assert list(found) == [*POSITION_OUTPUTS, *FORCE_OUTPUTS]
    assert share_held(found, "position", "mm", drawn.position_mm) >= 0.93
    assert share_held(found, "force", "n", drawn.force_n) >= 0.93
    width = exact["position_high_mm"] - exact["position_low_mm"]
    for name in POSITION_OUTPUTS[:3]:
        assert np.quantile(np.abs(found[name] - exact[name]) / width, 0.98) < 0.1, name
    broad = exact["force_high_n"] - exact["force_low_n"]
    for name in FORCE_OUTPUTS:
        assert np.quantile(np.abs(found[name] - exact[name]) / broad, 0.98) < 0.1, name
    assert np.quantile(np.abs(found["misfit"] - exact["misfit"]), 0.98) < 0.3
    odds = np.abs(found["contact_log_odds"] - exact["contact_log_odds"]) / (1 + np.abs(exact["contact_log_odds"]))
    assert np.quantile(odds, 0.98) < 0.02
    error, least = (np.abs(one["position_mm"] - drawn.position_mm).mean() for one in (found, exact))
    assert error < 1.02 * least


@pytest.mark.parametrize("kept", [(0, 1, 2, 3), pytest.param((1, 2), marks=pytest.mark.soak), (2,)], ids=str)
def test_false_contacts_at_rest_are_as_many_as_were_asked_for(graph: onnx.ModelProto, kept: tuple[int, ...]) -> None:
    rate = rate_per_sample(1 / 30, 200.0, 4)
    threshold = touch_thresholds(PRIOR, rate)[len(kept) - 1]
    run = runner(to_bytes(graph))
    for covariance in covariances().values():
        assert 0.5 < exceeding(run, PRIOR, covariance, kept, rate, threshold) < 2


def test_a_load_beyond_a_known_force_is_placed_where_it_is() -> None:
    prior = with_floor(prior_of("bench", 4, 0.2, known=True))
    graph = graph_with(prior, trained(prior))
    position = np.linspace(40, 360, 1000)
    force = np.full(len(position), 3 * prior.force_n[1])
    clean, deviation = prior.sampled(on_axis(position), force)
    answers = answers_of(graph, prior, clean + np.random.default_rng(1).normal(size=clean.shape) * deviation)
    assert share_held(answers, "position", "mm", position) >= 0.93
    assert share_held(answers, "force", "n", force) >= 0.85
    # It is where it is said to be, and no contact of this surface.
    assert answers["misfit"].min() > chdtri(3, 1e-9)


@pytest.mark.soak
def test_it_holds_where_perfect_sensors_have_hardly_any_noise() -> None:
    prior = prior_of("two-spans", 5, 3e-3, known=False)
    graph = graph_with(prior, trained(prior))
    drawn = draw(prior, 600, 4)
    answers = answers_of(graph, prior, drawn.deflection_mm)
    best = posterior_median_mm(prior, drawn.deflection_mm)
    error, least = (np.abs(place - drawn.position_mm).mean() for place in (answers["position_mm"], best))
    assert error < 1.05 * least
    assert share_held(answers, "position", "mm", drawn.position_mm) >= 0.93
    assert share_held(answers, "force", "n", drawn.force_n) >= 0.93
    assert np.quantile(answers["misfit"], 0.9) == pytest.approx(chdtri(3, 0.1), rel=0.2)
