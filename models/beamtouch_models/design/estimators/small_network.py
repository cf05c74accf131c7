"""A small network that finds where on the beam to look, from the direction of the deflection vector.

The direction depends on the position only, whatever the force. The network answers in nodes of a table of the
influence, which are spaced evenly in the change of the reading. It learns from simulated
contacts, with and without missing channels, by a second-order method (L-BFGS; Liu & Nocedal 1989,
doi 10.1007/BF01589116). Its answer needs to be near only: `posterior.window` takes two steps from there, and then
computes the posterior around it.
"""

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.onnx_graph import Graph
from beamtouch_models.design.estimators.posterior.fitted_cells import Whitened
from beamtouch_models.design.estimators.posterior.window import FirstStage, Table, table_of
from beamtouch_models.design.sweeps import Fraction

HIDDEN = (16, 16)
EXAMPLES = 8000
ITERATIONS = 500
MISSING_SHARE = 0.3
"""Share of the examples in which channels are missing."""
FAINT = 1e-9
"""Added to the square of the deflection, over that of the largest: a beam at rest has no direction."""

Layers = tuple[tuple[Floats, Floats], ...]
"""(weights, bias) of the hidden layers, with tanh, and of the linear output layer."""


@dataclass(frozen=True)
class Network:
    """Weights and scales; `first_stage` writes the same arithmetic as an ONNX graph."""

    table: Table
    largest_mm: float
    """Largest deflection of the scene at a sensor."""
    layers: Layers


def first_stage(network: Network) -> FirstStage:
    """Return the first stage that names the node of the network."""
    steps = network.table.steps

    def add(graph: Graph, seen: Whitened) -> tuple[list[str], list[str]]:
        square = graph.apply("ReduceSumSquare", seen.bounded, axes=[1])
        square = graph.apply("Add", square, graph.constant(FAINT * network.largest_mm**2))
        value = graph.apply("Div", seen.bounded, graph.apply("Sqrt", square))
        for weights, bias in network.layers[:-1]:
            value = graph.apply("Tanh", graph.apply("Gemm", value, graph.constant(weights), graph.constant(bias)))
        weights, bias = network.layers[-1]
        half = steps / 2
        value = graph.apply("Gemm", value, graph.constant(weights * half), graph.constant((bias + 1) * half))
        value = graph.apply("Clip", value, graph.constant(0.0), graph.constant(steps - 0.5))
        return [graph.cast(value, np.int64)], []

    return add


def train(
    prior: Prior,
    seed: int,
    progress: Fraction,
    *,
    fewest: int,
    hidden: tuple[int, ...] = HIDDEN,
    examples: int = EXAMPLES,
    iterations: int = ITERATIONS,
) -> Network:
    """Train a network; the same seed gives the same weights.

    Parameters
    ----------
    prior : the surface
    seed : seed of the examples and the initial weights
    progress : called with the fraction done
    fewest : smallest number of channels from which a position is stated
    hidden, examples, iterations : units per hidden layer, simulated contacts, bound on the iterations
    """
    rng = np.random.default_rng(seed)
    table = table_of(prior)
    deflection, target = _examples(prior, table, fewest, rng, examples)
    scaled = deflection / prior.largest_mm
    features = scaled / np.sqrt((scaled**2).sum(axis=1, keepdims=True) + FAINT)
    sizes = (prior.channels, *hidden, 1)
    start = np.concatenate([_initial(rng, fan_in, fan_out) for fan_in, fan_out in pairwise(sizes)])
    done = 0

    def loss(flat: Floats) -> tuple[float, Floats]:
        nonlocal done
        done += 1
        progress(min(1.0, done / (1.1 * iterations)))
        return loss_and_gradient(layers_of(flat, sizes), features, target)

    # The matrices are small: a second thread costs more than it saves, and makes the order of sums random.
    with threadpool_limits(1, user_api="blas"):
        options = {"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30, "ftol": 1e-9, "gtol": 1e-8}
        optimum = minimize(loss, start, jac=True, method="L-BFGS-B", options=options)
    return Network(table, prior.largest_mm, layers_of(optimum.x, sizes))


def _examples(prior: Prior, table: Table, fewest: int, rng: np.random.Generator, size: int) -> tuple[Floats, Floats]:
    """Draw samples (size, channels), 0 where a channel is missing, and their nodes (size,), scaled to -1 .. 1."""
    place, force = prior.extent.uniform(size, rng), rng.uniform(*prior.force_n, size=size)
    reading = prior.draw(place, force, rng)
    masks = [
        np.isin(np.arange(prior.channels), working)
        for count in range(fewest, prior.channels)
        for working in combinations(range(prior.channels), count)
    ]
    if masks:
        lacking = np.flatnonzero(rng.random(size) < MISSING_SHARE)
        reading[lacking] *= np.array(masks)[rng.integers(len(masks), size=len(lacking))]
    nodes = np.linspace(-1.0, 1.0, len(table.position_mm))
    return reading, np.interp(place[:, 0], table.position_mm, nodes)


def loss_and_gradient(layers: Layers, features: Floats, target: Floats) -> tuple[float, Floats]:
    """Return half the mean squared error and its flat gradient, in the order weights, bias, weights, bias, ..."""
    values = forward(layers, features)
    off = values[-1] - target[:, None]
    slope = off / len(target)
    gradients: list[Floats] = []
    for index in range(len(layers) - 1, -1, -1):
        gradients[:0] = [(values[index].T @ slope).ravel(), slope.sum(axis=0)]
        if index:
            slope = (slope @ layers[index][0].T) * (1 - values[index] ** 2)
    return float((off**2).mean() / 2), np.concatenate(gradients)


def forward(layers: Layers, features: Floats) -> list[Floats]:
    """Return the features, the values of the hidden layers, and the output (samples, 1)."""
    values = [features]
    for weights, bias in layers[:-1]:
        values.append(np.tanh(values[-1] @ weights + bias))
    weights, bias = layers[-1]
    return [*values, values[-1] @ weights + bias]


def _initial(rng: np.random.Generator, fan_in: int, fan_out: int) -> Floats:
    """Return random initial weights (Glorot & Bengio 2010) and random biases, so that no two units are alike."""
    weights = rng.normal(scale=np.sqrt(2 / (fan_in + fan_out)), size=fan_in * fan_out)
    return np.concatenate([weights, rng.normal(scale=0.1, size=fan_out)])


def layers_of(flat: Floats, sizes: tuple[int, ...]) -> Layers:
    """Return the layers of a network of these sizes from its flat weights."""
    layers, start = [], 0
    for fan_in, fan_out in pairwise(sizes):
        weights = flat[start : start + fan_in * fan_out].reshape(fan_in, fan_out)
        start += fan_in * fan_out
        layers.append((weights, flat[start : start + fan_out]))
        start += fan_out
    return tuple(layers)
