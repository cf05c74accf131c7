"""The paper's back-propagation network: its arithmetic, how training ends, what it learns, and its model."""

import json
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import runtime
from beamtouch_models.arrays import Floats
from beamtouch_models.design.estimators.paper_network import (
    _initial,
    _present,
    paper_graph,
    train,
    trained_as_in_the_paper,
)
from beamtouch_models.lab.reproduction.paper import deflection_mm
from beamtouch_models.places import on_axis
from models.posterior_cases import answers_of, prior_of
from support.programs.in_process import Command
from support.surfaces.example_scenes import SCENES

LOADS = np.arange(20.0, 201.0, 4.0)
ONE_SENSOR = deflection_mm([200.0], LOADS)
TWO_SENSORS = deflection_mm([133.0, 267.0], LOADS)


def squared_error(inputs: Floats, hidden: Floats, output: Floats, target: float) -> float:
    """Half the squared error, written from its definition."""
    units = 1 / (1 + np.exp(-(inputs @ hidden)))
    answer = 1 / (1 + np.exp(-(units @ output[:-1] + output[-1])))
    return float((target - answer) ** 2 / 2)


def test_a_step_is_0_9_of_the_gradient_and_0_7_of_the_last_step() -> None:
    stack = _initial([TWO_SENSORS], [TWO_SENSORS.max(axis=0)], seed=3)
    target = np.linspace(0.1, 0.9, len(LOADS))
    before = np.zeros_like(stack.hidden[0]), np.zeros_like(stack.output[0])
    for pattern in (5, 31):
        hidden, output = stack.hidden[0].copy(), stack.output[0].copy()
        inputs = np.array([*(2 * TWO_SENSORS[pattern] / TWO_SENSORS.max(axis=0) - 1), 1.0])
        _present(stack, target, np.array([pattern]))
        steps = stack.hidden[0] - hidden, stack.output[0] - output
        for weights, step, last in zip((hidden, output), steps, before, strict=True):
            for index in np.ndindex(weights.shape):
                kept, errors = weights[index], []
                for shift in (1e-6, -1e-6):
                    weights[index] = kept + shift
                    errors.append(squared_error(inputs, hidden, output, target[pattern]))
                weights[index] = kept
                slope = (errors[0] - errors[1]) / 2e-6
                assert step[index] == pytest.approx(-0.9 * slope + 0.7 * last[index], abs=1e-8)
        before = steps


def test_training_reaches_the_composite_error_and_the_answers_are_as_accurate() -> None:
    loads = np.arange(20.0, 381.0, 8.0)
    deflection = deflection_mm([122.0, 278.0], loads)
    (network,) = train([deflection], loads, 400.0, seed=0)
    assert network.outcome == "reached"
    answer = network.estimate_mm(deflection)
    error = float(((0.8 * (answer - loads) / 400) ** 2).mean())
    assert error == pytest.approx(network.composite_error, rel=1e-9)
    assert error <= 0.001
    assert np.abs(answer - loads).mean() < 0.03 * 400


def test_a_network_does_not_depend_on_its_neighbours() -> None:
    (alone,) = train([ONE_SENSOR], LOADS, 400.0, seed=4, max_epochs=30)
    beside, _ = train([ONE_SENSOR, TWO_SENSORS], LOADS, 400.0, seed=4, max_epochs=30)
    assert beside.hidden == pytest.approx(alone.hidden, rel=1e-9)


def test_the_papers_network_as_a_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    # A twentieth of the load positions; the command below trains on all of them.
    monkeypatch.setattr("beamtouch_models.design.estimators.paper_network.PATTERNS", 21)
    prior = prior_of("paper", 2, 2.0, known=True)
    network = trained_as_in_the_paper(prior, 0)
    position = np.linspace(40, 360, 50)
    deflection = prior.force_n[1] * prior.influence_at(on_axis(position))
    answers = answers_of(paper_graph(network), prior, deflection)
    assert list(answers) == ["position_mm"]
    assert answers["position_mm"] == pytest.approx(network.estimate_mm(deflection), abs=1e-2)
    # Without noise it knows the position to a percent or so of the length.
    assert np.abs(answers["position_mm"] - position).mean() < 0.03 * prior.diagonal_mm


@pytest.mark.soak
def test_the_papers_network_builds_and_is_evaluated(design_sensors_here: Command, tmp_path: Path) -> None:
    path = tmp_path / "paper.onnx"
    options = ("--estimator", "paper-network", "--criterion", "eigenvalue-product", "--json")
    built = design_sensors_here("build", SCENES / "paper.toml", *options, "-o", path)
    assert json.loads(built.stdout)["outputs"] == ["position_mm"]
    model = runtime.load(path)
    assert model.metadata.estimator == "paper-network"
    assert model.metadata.min_channels == len(model.metadata.layout)
    assert model.metadata.accuracy.ratio > 1
    done = design_sensors_here("evaluate", path, "--draws", 300, "--json")
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["evaluations"]
    assert found["span"]["ratio"]["value"] > 1
    assert found["position_coverage"] is found["missed"] is None
