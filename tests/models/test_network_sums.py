"""The arithmetic of the two networks and of the graphs of a model, beside their formulas written out once more."""

from itertools import pairwise

import numpy as np
import onnx
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators import paper_network, small_network
from beamtouch_models.design.estimators.onnx_graph import Graph, model, to_bytes, with_force_error, with_linear_input
from beamtouch_models.design.estimators.paper_network import PaperNetwork, paper_graph
from beamtouch_models.design.estimators.posterior.window import table_of
from beamtouch_models.design.estimators.small_network import layers_of, loss_and_gradient
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.session import runner
from models.loaded_string import STRING

SENSORS_MM = np.array([60.0, 150.0, 290.0])
PRIOR = Prior.of(STRING, on_axis(SENSORS_MM), Errors(0.004))


def logistic(values: Floats) -> Floats:
    shown: Floats = 1 / (1 + np.exp(-values))
    return shown


def paper_of(seed: int) -> PaperNetwork:
    rng = np.random.default_rng(seed)
    full_mm = np.array([0.7, 1.1, 0.4])
    return PaperNetwork(full_mm, 400.0, rng.normal(size=(4, 10)), rng.normal(size=11), 0.001, 30, "reached")


def test_the_papers_network_answers_by_its_formula_and_its_graph_as_it_does() -> None:
    network, deflection_mm = paper_of(1), np.random.default_rng(2).uniform(0, 1, (5, 3))
    expected = []
    for row in deflection_mm:
        inputs = np.array([*(2 * row / network.full_scale_mm - 1), 1.0])
        units = np.array([*logistic(inputs @ network.hidden), 1.0])
        expected.append((logistic(units @ network.output) - 0.1) / 0.8 * 400)
    assert network.estimate_mm(deflection_mm) == pytest.approx(np.array(expected))
    made = paper_graph(network)
    (output,) = made.graph.output
    assert output.name == "position_mm"
    answers = runner(to_bytes(made))(deflection_mm, np.zeros((5, 3, 3)))
    assert answers["position_mm"] == pytest.approx(np.array(expected), abs=1e-3)


@pytest.mark.parametrize(("epochs", "ends"), [(10, [10]), (25, [10, 20, 25])])
def test_training_looks_at_the_error_each_ten_epochs_and_in_the_last(epochs: int, ends: list[int]) -> None:
    loads = np.arange(20.0, 381.0, 24.0)
    told = list[float]()
    shown = 10.0 * PRIOR.influence_at(on_axis(loads))
    (network,) = paper_network.train([shown], loads, 400.0, seed=3, max_epochs=epochs, progress=told.append)
    assert told == pytest.approx([end / epochs for end in ends])
    assert network.full_scale_mm == pytest.approx(shown.max(axis=0))
    assert (network.outcome, network.length_mm) == ("out of epochs", 400.0)
    error = ((0.8 * (network.estimate_mm(shown) - loads) / 400) ** 2).mean()
    assert network.composite_error == pytest.approx(error)
    assert network.epochs in ends


def test_training_ends_when_the_error_stands_still_or_is_small_enough() -> None:
    loads = np.arange(20.0, 381.0, 24.0)
    # Sensors that show the same everywhere tell nothing: the error falls to that of a guess, and stays.
    same = np.ones((len(loads), 2))
    shown = 10.0 * PRIOR.influence_at(on_axis(loads))
    told = list[float]()
    still, reached = paper_network.train([same, shown], loads, 400.0, seed=3, progress=told.append)
    assert still.outcome == "stood still"
    assert still.composite_error > 0.04
    assert reached.outcome == "reached"
    assert 0.0005 < reached.composite_error <= 0.001
    assert told[-1] < 1
    # It waits for 600 epochs after the last gain of a hundredth.
    assert round(3000 * told[-1]) >= min(still.epochs + 600, 3000)
    assert round(3000 * told[-1]) <= max(still.epochs + 600, reached.epochs)


def test_initial_weights_are_drawn_evenly_up_to_a_half_for_each_network_alone() -> None:
    shown = [np.random.default_rng(1).uniform(1, 2, (7, sensors)) for sensors in (40, 3)]
    scales = [each.max(axis=0) for each in shown]
    stack = paper_network._initial(shown, scales, 5)
    assert stack.patterns.shape == (7, 2, 41)
    assert stack.patterns[:, 0, :40] == pytest.approx(2 * shown[0] / scales[0] - 1)
    assert stack.patterns[:, 1, :3] == pytest.approx(2 * shown[1] / scales[1] - 1)
    assert (stack.patterns[:, :, -1] == 1).all()
    assert (stack.patterns[:, 1, 3:40] == 0).all()
    assert (stack.hidden[1, 3:40] == 0).all()
    drawn = np.concatenate([stack.hidden[0].ravel(), stack.output.ravel()])
    assert np.abs(drawn).max() <= 0.5
    assert np.abs(drawn).max() > 0.48
    assert drawn.mean() == pytest.approx(0, abs=0.05)
    assert drawn.std() == pytest.approx(1 / np.sqrt(12), rel=0.1)
    assert (stack.hidden_step == 0).all()
    assert (stack.output_step == 0).all()
    kept = stack.keep(np.array([False, True]))
    assert kept.hidden.tolist() == stack.hidden[1:].tolist()
    assert kept.patterns.tolist() == stack.patterns[:, 1:].tolist()


SIZES = (3, 5, 4, 1)


def flat_weights(seed: int = 6) -> Floats:
    count = sum(fan_in * fan_out + fan_out for fan_in, fan_out in pairwise(SIZES))
    drawn: Floats = np.random.default_rng(seed).normal(size=count)
    return drawn


def test_the_gradient_of_a_small_network_is_that_of_differences() -> None:
    rng = np.random.default_rng(7)
    flat, features, target = flat_weights(), rng.normal(size=(9, 3)), rng.uniform(-1, 1, 9)
    layers = layers_of(flat, SIZES)
    assert [(weights.shape, bias.shape) for weights, bias in layers] == [((3, 5), (5,)), ((5, 4), (4,)), ((4, 1), (1,))]
    assert (
        np.concatenate([np.concatenate([weights.ravel(), bias]) for weights, bias in layers]).tolist() == flat.tolist()
    )

    def loss_of(weights: Floats) -> float:
        (first, second, last) = layers_of(weights, SIZES)
        hidden = np.tanh(np.tanh(features @ first[0] + first[1]) @ second[0] + second[1])
        return float((((hidden @ last[0] + last[1])[:, 0] - target) ** 2).mean() / 2)

    loss, gradient = loss_and_gradient(layers, features, target)
    assert loss == pytest.approx(loss_of(flat))
    for entry in range(len(flat)):
        step = np.where(np.arange(len(flat)) == entry, 1e-5, 0.0)
        slope = (loss_of(flat + step) - loss_of(flat - step)) / 2e-5
        assert gradient[entry] == pytest.approx(slope, abs=1e-8)


def test_examples_lack_channels_in_three_tenths_and_name_the_node_of_their_place() -> None:
    table = table_of(PRIOR)
    rng = np.random.default_rng(8)
    reading, target = small_network._examples(PRIOR, table, 2, rng, 6000)
    lacking = (reading == 0).sum(axis=1)
    assert set(lacking.tolist()) == {0, 1}
    assert lacking.mean() == pytest.approx(0.3, abs=0.03)
    assert (reading == 0).mean(axis=0) == pytest.approx(0.1, abs=0.02)
    assert target.min() == pytest.approx(-1, abs=0.01)
    assert target.max() == pytest.approx(1, abs=0.01)
    # From -1 at the first node of the table to 1 at its last: the direction of a reading is that of its node.
    whole = lacking == 0
    node = np.rint((target[whole] + 1) / 2 * (len(table.position_mm) - 1)).astype(int)
    seen = PRIOR.influence_at(on_axis(table.position_mm[node]))
    cosine = (seen * reading[whole]).sum(axis=1) / np.linalg.norm(seen, axis=1) / np.linalg.norm(reading[whole], axis=1)
    assert np.quantile(cosine, 0.1) > 0.999
    none, _ = small_network._examples(PRIOR, table, 3, np.random.default_rng(8), 500)
    assert (none != 0).all()


def test_initial_weights_of_the_small_network_have_the_spread_of_glorot_and_bengio() -> None:
    drawn = small_network._initial(np.random.default_rng(9), 60, 90)
    assert len(drawn) == 60 * 90 + 90
    assert drawn[:5400].std() == pytest.approx(np.sqrt(2 / 150), rel=0.05)
    assert drawn[5400:].std() == pytest.approx(0.1, rel=0.25)


def test_training_learns_the_node_of_a_contact() -> None:
    """Of three sensors under a string, the direction of the deflections tells the place."""
    network = small_network.train(PRIOR, 1, lambda _done: None, fewest=3, hidden=(8,), examples=400, iterations=60)
    place_mm = np.linspace(30, 370, 50)
    shown = 9.0 * PRIOR.influence_at(on_axis(place_mm)) / PRIOR.largest_mm
    features = shown / np.linalg.norm(shown, axis=1, keepdims=True)
    found = small_network.forward(network.layers, features)[-1][:, 0]
    nodes = np.interp(place_mm, network.table.position_mm, np.linspace(-1, 1, len(network.table.position_mm)))
    assert np.abs(found - nodes).mean() < 0.05
    assert network.largest_mm == PRIOR.largest_mm


def adding() -> onnx.ModelProto:
    """Return a model of three channels that answers with their sum as force, and with an interval of it."""
    graph = Graph()
    graph.apply("ReduceSum", "deflection_mm", graph.ints(1), keepdims=0, output="force_n")
    graph.apply("Sub", "force_n", graph.constant(0.3), output="force_low_n")
    graph.apply("Add", "force_n", graph.constant(0.4), output="force_high_n")
    return model(graph, 3, ["force_n", "force_low_n", "force_high_n"])


DEFLECTION_MM = np.array([[0.5, 1.25, -0.25], [2.0, 0.0, 1.0]])


def answered(made: onnx.ModelProto) -> dict[str, Floats]:
    found = runner(to_bytes(made))(DEFLECTION_MM, np.zeros((2, 3, 3)))
    return {name: np.asarray(values, dtype=np.float64) for name, values in found.items()}


@pytest.mark.parametrize("curve_per_mm", [0.0, 0.2])
@pytest.mark.parametrize("offset_mm", [[0.0, 0.0, 0.0], [0.1, 0.0, -0.3]])
def test_offsets_are_taken_off_and_the_curve_straightened_before_a_graph(
    offset_mm: list[float], curve_per_mm: float
) -> None:
    made = with_linear_input(adding(), np.array(offset_mm), curve_per_mm)
    left = DEFLECTION_MM - offset_mm
    assert answered(made)["force_n"] == pytest.approx((left + curve_per_mm * left**2).sum(axis=1), rel=1e-6)
    assert (len(made.graph.node) == 3) is (offset_mm == [0.0] * 3 and not curve_per_mm)


def test_an_error_of_all_forces_widens_their_intervals_as_independent_errors_do() -> None:
    plain, wide = answered(adding()), answered(with_force_error(adding(), 0.05))
    force = plain["force_n"]
    assert wide["force_n"] == pytest.approx(force)
    added = 1.959964 * 0.05 * force
    assert force - wide["force_low_n"] == pytest.approx(np.hypot(0.3, added), rel=1e-5)
    assert wide["force_high_n"] - force == pytest.approx(np.hypot(0.4, added), rel=1e-5)
    unchanged = adding()
    assert with_force_error(unchanged, 0.0) is unchanged
    paper = paper_graph(paper_of(1))
    assert with_force_error(paper, 0.05) is paper


def test_operations_of_a_graph_have_their_numbers_and_what_sorts_returns_the_best_first() -> None:
    graph = Graph()
    values, index = graph.top("deflection_mm", 2, 1, largest=True)
    least, _ = graph.top("deflection_mm", 2, 1, largest=False)
    first, second = graph.split(values, 2, 1)
    graph.apply("Squeeze", first, graph.ints(1), output="most")
    graph.apply("Squeeze", second, graph.ints(1), output="next")
    low, _ = graph.split(least, 2, 1)
    graph.apply("Squeeze", low, graph.ints(1), output="least")
    where, _ = graph.split(graph.cast(index, np.float32), 2, 1)
    graph.apply("Squeeze", where, graph.ints(1), output="where")
    found = answered(model(graph, 3, ["most", "next", "least", "where"]))
    assert {name: values.tolist() for name, values in found.items()} == {
        "most": [1.25, 2.0],
        "next": [0.5, 1.0],
        "least": [-0.25, 0.0],
        "where": [1.0, 0.0],
    }
    made = model(Graph(), 3, [])
    assert (made.ir_version, [opset.version for opset in made.opset_import]) == (8, [17])
