"""The paper's estimator of position: a back-propagation network with one hidden layer of ten logistic units.

Training follows section 2 of the paper: learning rate 0.9, momentum 0.7, one load position after another, until the
composite error is at most 0.1 %. The paper does not define this error; here it is the mean squared error of the output,
which lies between 0 and 1. These rates require logistic units and scaled targets, here 0.1 .. 0.9; inputs are scaled to
-1 .. 1. Several networks are trained side by side, which costs little more than one.
Rumelhart, Hinton & Williams, Learning representations by back-propagating errors, Nature 323 (1986),
doi 10.1038/323533a0.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import onnx
from scipy.special import expit
from threadpoolctl import threadpool_limits

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.estimators.onnx_graph import Graph, model
from beamtouch_models.design.sweeps import Fraction, silent
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.metadata import INPUTS

HIDDEN = 10
LEARNING_RATE = 0.9
MOMENTUM = 0.7
COMPOSITE_ERROR = 0.001
INITIAL_WEIGHT = 0.5
"""Initial weights are uniform between minus and plus this value."""
TARGET_LOW, TARGET_HIGH = 0.1, 0.9
MAX_EPOCHS = 3000
CHECK_EVERY = 10
"""Epochs between two evaluations of the composite error."""
GAIN, PATIENCE = 0.01, 600
"""Smallest relative gain of the composite error, and the usual number of epochs without one after which training
counts as stalled."""
PATTERNS = 399
"""Number of load positions in training, as in the paper."""

Outcome = Literal["reached", "stood still", "out of epochs"]


@dataclass(frozen=True)
class PaperNetwork:
    """A trained network, and the outcome of its training."""

    full_scale_mm: Floats
    """(sensors,) largest deflection in training; inputs from 0 to this value are scaled to -1 .. 1."""
    length_mm: float
    hidden: Floats
    """(sensors + 1, 10); the last row is the bias."""
    output: Floats
    """(11,); the last is the bias."""
    composite_error: float
    epochs: int
    outcome: Outcome

    def estimate_mm(self, deflection_mm: Floats) -> Floats:
        """Return the position for each row of deflections (samples, sensors); (samples,) in mm from the left end."""
        scaled = 2 * deflection_mm / self.full_scale_mm - 1
        units = expit(scaled @ self.hidden[:-1] + self.hidden[-1])
        answer = expit(units @ self.output[:-1] + self.output[-1])
        position: Floats = (answer - TARGET_LOW) / (TARGET_HIGH - TARGET_LOW) * self.length_mm
        return position


@dataclass
class _Stack:
    """Networks in training; those with fewer sensors have inputs that are always zero."""

    patterns: Floats
    """(patterns, networks, inputs), the last input being 1."""
    hidden: Floats
    """(networks, inputs, 10)."""
    output: Floats
    """(networks, 11)."""
    hidden_step: Floats
    output_step: Floats

    def keep(self, wanted: Bools) -> "_Stack":
        weights = (weight[wanted] for weight in (self.hidden, self.output, self.hidden_step, self.output_step))
        return _Stack(np.ascontiguousarray(self.patterns[:, wanted]), *weights)

    def composite_error(self, target: Floats) -> Floats:
        """Return the mean squared error of the output of each network."""
        units = expit(np.einsum("pni,nih->pnh", self.patterns, self.hidden))
        answer = expit(np.einsum("pnh,nh->pn", units, self.output[:, :-1]) + self.output[:, -1])
        error: Floats = ((answer - target[:, None]) ** 2).mean(axis=0)
        return error


def train(
    deflections_mm: Sequence[Floats],
    position_mm: Floats,
    length_mm: float,
    *,
    seed: int,
    max_epochs: int = MAX_EPOCHS,
    progress: Fraction = silent,
    effort: Effort = USUAL,
) -> list[PaperNetwork]:
    """Train a network for each set of deflections.

    Parameters
    ----------
    deflections_mm : for each network (patterns, sensors) in mm; the number of sensors may differ
    position_mm : (patterns,) load positions
    length_mm : length of the beam, which scales the targets
    seed : seed of the initial weights and of the order of the patterns
    max_epochs : bound on the number of epochs
    progress : called with the fraction of `max_epochs` done
    effort : how long training waits for a gain

    Returns
    -------
    A network for each set, with the weights of its last gain.
    """
    target = TARGET_LOW + (TARGET_HIGH - TARGET_LOW) * position_mm / length_mm
    scales = [deflection.max(axis=0) for deflection in deflections_mm]
    stack, training = _initial(deflections_mm, scales, seed), np.arange(len(scales))
    best: dict[int, PaperNetwork] = {}
    order, patience = np.random.default_rng(seed), effort.of(PATIENCE)
    # A second thread would cost more than it saves on matrices this small.
    with threadpool_limits(1, user_api="blas"):
        for epoch in range(1, max_epochs + 1):
            _present(stack, target, order.permutation(len(target)))
            if epoch % CHECK_EVERY and epoch != max_epochs:
                continue
            errors = stack.composite_error(target).tolist()
            for row, (index, error) in enumerate(zip(training.tolist(), errors, strict=True)):
                if index not in best or error < (1 - GAIN) * best[index].composite_error or error <= COMPOSITE_ERROR:
                    outcome: Outcome = "reached" if error <= COMPOSITE_ERROR else "out of epochs"
                    inputs = [*range(len(scales[index])), -1]
                    weights = stack.hidden[row][inputs], stack.output[row].copy()
                    best[index] = PaperNetwork(scales[index], length_mm, *weights, error, epoch, outcome)
                elif epoch - best[index].epochs >= patience:
                    best[index] = replace(best[index], outcome="stood still")
            lasting = np.array([best[index].outcome == "out of epochs" for index in training.tolist()])
            stack, training = stack.keep(lasting), training[lasting]
            progress(epoch / max_epochs)
            if not len(training):
                break
    return [best[index] for index in range(len(scales))]


def _initial(deflections_mm: Sequence[Floats], scales: Sequence[Floats], seed: int) -> _Stack:
    count, widest = len(scales), max(len(scale) for scale in scales)
    patterns = np.zeros((len(deflections_mm[0]), count, widest + 1))
    hidden = np.zeros((count, widest + 1, HIDDEN))
    output = np.zeros((count, HIDDEN + 1))
    for index, (deflection, scale) in enumerate(zip(deflections_mm, scales, strict=True)):
        # Each network has its own generator, so that it does not depend on the networks trained with it.
        rng = np.random.default_rng([seed, index])
        sensors = len(scale)
        patterns[:, index, :sensors] = 2 * deflection / scale - 1
        patterns[:, index, -1] = 1
        rows = [*range(sensors), -1]
        hidden[index, rows] = rng.uniform(-INITIAL_WEIGHT, INITIAL_WEIGHT, size=(sensors + 1, HIDDEN))
        output[index] = rng.uniform(-INITIAL_WEIGHT, INITIAL_WEIGHT, size=HIDDEN + 1)
    return _Stack(patterns, hidden, output, np.zeros_like(hidden), np.zeros_like(output))


def _present(stack: _Stack, target: Floats, order: Indices) -> None:
    """Present all patterns once, correcting the weights after each."""
    units = np.ones_like(stack.output)
    for pattern in order:
        inputs = stack.patterns[pattern]
        active = expit(np.einsum("ni,nih->nh", inputs, stack.hidden))
        units[:, :-1] = active
        answer = expit(np.einsum("nh,nh->n", units, stack.output))
        outer = LEARNING_RATE * (target[pattern] - answer) * answer * (1 - answer)
        inner = outer[:, None] * stack.output[:, :-1] * active * (1 - active)
        stack.output_step *= MOMENTUM
        stack.output_step += outer[:, None] * units
        stack.output += stack.output_step
        stack.hidden_step *= MOMENTUM
        stack.hidden_step += inputs[:, :, None] * inner[:, None, :]
        stack.hidden += stack.hidden_step


def paper_graph(network: PaperNetwork) -> onnx.ModelProto:
    """Return a network as an ONNX model; it ignores its whitening."""
    graph = Graph()
    deflection, _whitening = INPUTS
    weights = 2 * network.hidden[:-1] / network.full_scale_mm[:, None]
    bias = network.hidden[-1] - network.hidden[:-1].sum(axis=0)
    units = graph.apply("Sigmoid", graph.apply("Gemm", deflection, graph.constant(weights), graph.constant(bias)))
    output = graph.apply("Gemm", units, graph.constant(network.output[:-1, None]), graph.constant(network.output[-1:]))
    scale = network.length_mm / (TARGET_HIGH - TARGET_LOW)
    scaled = graph.apply("Mul", graph.apply("Sigmoid", output), graph.constant(scale))
    shifted = graph.apply("Add", scaled, graph.constant(-TARGET_LOW * scale))
    graph.apply("Squeeze", shifted, graph.ints(1), output="position_mm")
    return model(graph, len(network.full_scale_mm), ["position_mm"])


def trained_as_in_the_paper(prior: Prior, seed: int, effort: Effort = USUAL) -> PaperNetwork:
    """Train on deflections without noise, at the middle of the force range, because the paper has a single force."""
    position = np.linspace(*prior.extent.range_mm, PATTERNS)
    force = sum(prior.force_n) / 2
    (network,) = train(
        [force * prior.influence_at(on_axis(position))], position, prior.diagonal_mm, seed=seed, effort=effort
    )
    return network
