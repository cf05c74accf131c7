"""The small network: its gradient, its graph, and what it knows after training."""

from dataclasses import replace

import numpy as np
import onnxruntime as ort
import pytest

from beamtouch_models import export, limit
from beamtouch_models.limit import Array
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.network import BATCH, Float32, Network, Simulator, Truth, _gradients, _initial, _truth, train
from beamtouch_models.scene import load_scene
from example_scenes import SCENES

scene, _ = load_scene(SCENES / "bench.toml")
layout = np.array([68.0, 156.0, 244.0, 332.0])
simulator = Simulator(scene, layout, 0.00226, may_miss_one=True)


def loss(network: Network, truth: Truth) -> float:
    """The loss that training lowers, written from its definition in float64."""
    value = network.inputs.features(truth.deflection_mm, truth.valid).astype(np.float64)
    for weights, bias in network.layers[:-1]:
        value = np.tanh(value @ weights + bias)
    raw = value @ network.layers[-1][0] + network.layers[-1][1]

    def pinball(error: Array, quantile: float) -> float:
        return float((np.maximum(quantile * error, (quantile - 1) * error) * truth.touched).sum())

    total = float(np.logaddexp(0, np.where(truth.touched, -1.0, 1.0) * raw[:, 3]).sum())
    for columns, target in ((raw[:, :3], truth.position), (raw[:, 4:], truth.log_force)):
        median, below, above = columns.T
        total += pinball(target - median, 0.5)
        total += 4 * pinball(target - (median - np.logaddexp(0, below)), 0.025)
        total += 4 * pinball(target - (median + np.logaddexp(0, above)), 0.975)
    return total / len(raw)


def test_the_gradient_is_the_slope_of_the_loss() -> None:
    rng = np.random.default_rng(0)
    network = _initial(simulator, rng)
    truth = _truth(network, simulator, rng)
    gradients = _gradients(network, truth)
    # The outer quantiles pull on the widths only, not on the median; so the median's columns are left out.
    for index, column in ((4, 1), (4, 2), (4, 3), (4, 5), (5, 6), (5, 3)):
        array = network.layers[index // 2][index % 2].astype(np.float64)
        step = np.zeros_like(array)
        step[..., column] = 1e-3
        moved = [
            replace(network, layers=(*network.layers[:2], (layer_of(index, network, array + sign * step))))
            for sign in (1, -1)
        ]
        slope = (loss(moved[0], truth) - loss(moved[1], truth)) / 2e-3
        assert slope == pytest.approx(float(gradients[index][..., column].sum()), rel=2e-2, abs=2e-4)
    assert len(truth.position) == BATCH


def layer_of(index: int, network: Network, array: Array) -> tuple[Float32, Float32]:
    weights, bias = network.layers[2]
    return (array.astype(np.float32), bias) if index == 4 else (weights, array.astype(np.float32))


def test_the_same_seed_gives_the_same_file() -> None:
    first, second = (
        export.to_bytes(export.network_graph(train(simulator, 3, 20, lambda _: None), with_force=True))
        for _ in range(2)
    )
    assert first == second


def test_the_graph_computes_what_the_network_computes() -> None:
    network = train(simulator, 3, 50, lambda _: None)
    session = ort.InferenceSession(export.to_bytes(export.network_graph(network, with_force=True)))
    drawn = simulator.draw(np.random.default_rng(1), 500)
    raw = network.raw(network.inputs.features(drawn.deflection_mm, drawn.valid))
    (odds,) = session.run(["contact_log_odds"], {"deflection_mm": drawn.deflection_mm, "valid": drawn.valid})
    assert odds == pytest.approx(raw[:, 3], rel=1e-4, abs=1e-4)
    (position,) = session.run(["position_mm"], {"deflection_mm": drawn.deflection_mm, "valid": drawn.valid})
    assert position == pytest.approx(np.clip(200 + 199 * raw[:, 0], 1, 399), rel=1e-4, abs=1e-2)


def test_what_a_missing_channel_holds_changes_nothing(bench: ModelFile) -> None:
    drawn = limit.draw(scene, layout, bench.metadata.noise.sample_mm, 50, 5)
    deflection = drawn.deflection_mm.astype(np.float32)
    valid = np.ones(deflection.shape, np.bool_)
    valid[:, 2] = False
    before = bench.estimate(deflection, valid)
    for rubbish in (np.nan, np.inf, -1e30, 0.0):
        deflection[:, 2] = rubbish
        after = bench.estimate(deflection, valid)
        assert all(np.array_equal(before[name], after[name]) for name in bench.outputs)


@pytest.mark.parametrize("missing", [None, 0, 1, 2, 3])
def test_intervals_hold_the_truth_and_the_error_is_near_the_limit(bench: ModelFile, missing: int | None) -> None:
    present = np.array([channel for channel in range(4) if channel != missing])
    noise = bench.metadata.noise.sample_mm
    drawn = limit.draw(scene, layout, noise, 4000, 6)
    valid = np.zeros(drawn.deflection_mm.shape, np.bool_)
    valid[:, present] = True
    answers = bench.estimate(drawn.deflection_mm.astype(np.float32), valid)
    best = limit.posterior_median_mm(scene, layout[present], noise, drawn.deflection_mm[:, present])
    error = np.abs(answers["position_mm"] - drawn.position_mm).mean()
    # Measured: 1.19 with all channels, up to 1.48 with one missing, which training sees less of.
    assert error < (1.3 if missing is None else 1.6) * np.abs(best - drawn.position_mm).mean()
    inside = (answers["position_low_mm"] <= drawn.position_mm) & (drawn.position_mm <= answers["position_high_mm"])
    assert inside.mean() > 0.91
    inside = (answers["force_low_n"] <= drawn.force_n) & (drawn.force_n <= answers["force_high_n"])
    assert inside.mean() > 0.91
    assert (answers["contact_log_odds"] > bench.metadata.contact_threshold).mean() > 0.97


def test_false_alarms_of_a_beam_at_rest(bench: ModelFile) -> None:
    # Stated: 1 in 1e5. In 400 000 samples 4 are expected; 17 or more would come once in a million.
    rest = np.random.default_rng(9).normal(scale=bench.metadata.noise.sample_mm, size=(400_000, 4)).astype(np.float32)
    odds = bench.estimate(rest, np.ones(rest.shape, np.bool_))["contact_log_odds"]
    assert (odds > bench.metadata.contact_threshold).sum() < 17
