"""A small network that approximates the posterior with less arithmetic.

It learns from the posterior: simulated readings with their exact answers. The answers are smooth and free of noise, so
that few examples suffice and a second-order method converges (L-BFGS; Liu & Nocedal 1989, doi 10.1007/BF01589116). Its
inputs are the direction of the deflection vector in its principal axes, which depends on the position only; the
logarithm of its length, which depends on the force; and the missing channels.

The loss is the cost of an error. A position that is wrong by d, where the posterior's deviation is s, adds about
sqrt(s^2 + d^2) - s to the error: little at the ends of the beam, where s is large, and nearly d in the middle.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.estimators.teacher import Lessons, lessons
from beamtouch_models.progress import Fraction

HIDDEN = (20, 20)
EXAMPLES = 12_000
ITERATIONS = 2000
CALIBRATION_DRAWS = 20_000
OUTPUTS = 7
"""Median of position, logarithms of the widths below and above it, log odds, and the same three for the force."""
LEAST_FORCE = 1e-3
"""Smallest force that the network learns, over the smallest of the scene."""
ODDS_SCALE = 4.0
"""Error in the log odds, in nats, that weighs as much as a 100 % error in a width."""
WEIGHTS = (1.0, 0.1, 0.1, 0.1, 1.0, 0.1, 0.1)
"""Weights of the outputs in the loss; the first is the mean error in units of the posterior's mean deviation."""


@dataclass(frozen=True)
class Inputs:
    """Scaling of deflections to the inputs of the first layer."""

    noise_mm: float
    centre: Floats
    """(channels,) mean direction of a contact's deflection."""
    axes: Floats
    """(channels, channels) principal axes of the directions, each over its spread."""
    log_centre: float
    log_spread: float

    def features(self, deflection_mm: Floats, valid: Bools) -> Floats:
        """Return the inputs of the first layer, (samples, 2 channels + 1)."""
        scaled = np.where(valid, deflection_mm, 0.0) / self.noise_mm
        length = np.sqrt((scaled**2).sum(axis=1, keepdims=True) + 1)
        direction = (scaled / length - self.centre) @ self.axes
        log_length = (np.log(length) - self.log_centre) / self.log_spread
        return np.concatenate([direction, log_length, ~valid], axis=1)

    def log_length(self, deflection_mm: Floats, valid: Bools) -> Floats:
        """Return the logarithm of the length of the deflection in units of the noise, (samples,)."""
        scaled = np.where(valid, deflection_mm, 0.0) / self.noise_mm
        log: Floats = np.log((scaled**2).sum(axis=1) + 1) / 2
        return log


@dataclass(frozen=True)
class Network:
    """Weights and scales; `small_network_graph` writes the same arithmetic as an ONNX graph."""

    inputs: Inputs
    layers: tuple[tuple[Floats, Floats], ...]
    """(weights, bias) of the hidden layers, with tanh, and of the linear output layer."""
    position_mm: tuple[float, float]
    force_n: tuple[float, float]
    width: tuple[float, float] = (1.0, 1.0)
    """Factors on the widths of the position's and the force's interval, set so that 95 % hold the truth."""

    def raw(self, features: Floats) -> Floats:
        """Return the raw outputs (samples, 7) for features (samples, 2 channels + 1)."""
        return _forward(self.layers, features)[-1]

    @property
    def position_scale(self) -> tuple[float, float]:
        """Centre and half width of the position range: position = centre + half width x raw."""
        low, high = self.position_mm
        return (low + high) / 2, (high - low) / 2


def train(
    prior: Prior,
    seed: int,
    progress: Fraction,
    *,
    hidden: tuple[int, ...] = HIDDEN,
    examples: int = EXAMPLES,
    iterations: int = ITERATIONS,
) -> Network:
    """Train a network; the same seed gives the same weights. `progress` is called with the fraction done."""
    rng = np.random.default_rng(seed)
    taught = lessons(prior, rng, examples)
    inputs = inputs_of(prior, taught)
    features = inputs.features(taught.deflection_mm, taught.valid)
    target = _targets(prior, inputs, taught)
    sizes = (features.shape[1], *hidden, OUTPUTS)
    start = np.concatenate([_initial(rng, fan_in, fan_out) for fan_in, fan_out in pairwise(sizes)])
    done = 0

    def loss(flat: Floats) -> tuple[float, Floats]:
        nonlocal done
        done += 1
        progress(min(1.0, done / (1.1 * iterations)))
        return loss_and_gradient(_layers(flat, sizes), features, target)

    # The matrices are small: a second thread costs more than it saves, and makes the order of sums random.
    with threadpool_limits(1, user_api="blas"):
        options = {"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30, "ftol": 1e-9, "gtol": 1e-8}
        found = minimize(loss, start, jac=True, method="L-BFGS-B", options=options)
        network = Network(inputs, _layers(found.x, sizes), prior.position_mm, prior.force_n)
        return _with_calibrated_widths(network, lessons(prior, rng, CALIBRATION_DRAWS, contacts_only=True))


@dataclass(frozen=True)
class Targets:
    """Target outputs, with the weights of their errors."""

    raw: Floats
    """(samples, 7)"""
    spread: Floats
    """(samples, 2) deviation of position and force, in the units of their outputs."""
    weight: Floats
    """(samples, 7)"""


def inputs_of(prior: Prior, taught: Lessons) -> Inputs:
    """Return the scaling of inputs, from simulated contacts with all channels."""
    whole = taught.touched & taught.valid.all(axis=1)
    scaled = taught.deflection_mm[whole] / prior.noise_mm
    length = np.sqrt((scaled**2).sum(axis=1, keepdims=True) + 1)
    direction = scaled / length
    centre = direction.mean(axis=0)
    _, spread, rows = np.linalg.svd(direction - centre, full_matrices=False)
    axes = rows.T / np.maximum(spread / np.sqrt(len(direction)), 1e-6)
    log_length = np.log(length)
    return Inputs(prior.noise_mm, centre, axes, float(log_length.mean()), float(max(log_length.std(), 1e-3)))


def _targets(prior: Prior, inputs: Inputs, taught: Lessons) -> Targets:
    low, high = prior.position_mm
    half = (high - low) / 2
    position = (taught.position - (low + high) / 2) / half
    log_length = inputs.log_length(taught.deflection_mm, taught.valid)
    # A force that nothing holds has an interval from 0 on.
    force = np.log(np.maximum(taught.force, LEAST_FORCE * prior.force_n[0])) - log_length[:, None]
    raw, spread = np.empty((len(position), OUTPUTS)), np.empty((len(position), 2))
    for first, values, column in ((0, position, 0), (4, force, 1)):
        median, below, above = values.T
        widths = np.maximum(np.stack([median - below, above - median]), 1e-7)
        raw[:, first], raw[:, first + 1 : first + 3] = median, np.log(widths).T
        spread[:, column] = widths.sum(axis=0) / 4
    raw[:, 3] = taught.log_odds / ODDS_SCALE
    # Where nothing touches, position and force are never used.
    weight = np.where(taught.touched[:, None], 1.0, 0.02) * np.array(WEIGHTS)
    weight[:, 3] = WEIGHTS[3]
    touched = taught.touched
    weight[:, 0] /= spread[touched, 0].mean()
    weight[:, 4] /= spread[touched, 1].mean()
    if prior.force_is_known:
        weight[:, 4:] = 0
    return Targets(raw, spread, weight / len(raw))


def loss_and_gradient(
    layers: tuple[tuple[Floats, Floats], ...], features: Floats, target: Targets
) -> tuple[float, Floats]:
    """Return the loss and its flat gradient, in the order weights, bias, weights, bias, ..."""
    values = _forward(layers, features)
    off = values[-1] - target.raw
    cost, slope = off**2 / 2, off.copy()
    for output, column in ((0, 0), (4, 1)):
        spread = target.spread[:, column]
        whole = np.sqrt(spread**2 + off[:, output] ** 2)
        cost[:, output], slope[:, output] = whole - spread, off[:, output] / whole
    loss = float((target.weight * cost).sum())
    slope *= target.weight
    gradients: list[Floats] = []
    for index in range(len(layers) - 1, -1, -1):
        gradients[:0] = [(values[index].T @ slope).ravel(), slope.sum(axis=0)]
        if index:
            slope = (slope @ layers[index][0].T) * (1 - values[index] ** 2)
    return loss, np.concatenate(gradients)


def _forward(layers: tuple[tuple[Floats, Floats], ...], features: Floats) -> list[Floats]:
    """Return the features, the values of the hidden layers, and the raw outputs."""
    values = [features]
    for weights, bias in layers[:-1]:
        values.append(np.tanh(values[-1] @ weights + bias))
    weights, bias = layers[-1]
    return [*values, values[-1] @ weights + bias]


def _initial(rng: np.random.Generator, fan_in: int, fan_out: int) -> Floats:
    """Return random initial weights (Glorot & Bengio 2010) and random biases, so that no two units are alike."""
    weights = rng.normal(scale=np.sqrt(2 / (fan_in + fan_out)), size=fan_in * fan_out)
    return np.concatenate([weights, rng.normal(scale=0.1, size=fan_out)])


def _layers(flat: Floats, sizes: tuple[int, ...]) -> tuple[tuple[Floats, Floats], ...]:
    layers, start = [], 0
    for fan_in, fan_out in pairwise(sizes):
        weights = flat[start : start + fan_in * fan_out].reshape(fan_in, fan_out)
        start += fan_in * fan_out
        layers.append((weights, flat[start : start + fan_out]))
        start += fan_out
    return tuple(layers)


def _with_calibrated_widths(network: Network, fresh: Lessons) -> Network:
    """Scale the intervals to hold the truth in 95 % of fresh simulated cases (split conformal prediction)."""
    raw = network.raw(network.inputs.features(fresh.deflection_mm, fresh.valid))
    centre, half = network.position_scale
    log_force = np.log(fresh.true_force_n) - network.inputs.log_length(fresh.deflection_mm, fresh.valid)
    factors = []
    for first, truth in ((0, (fresh.true_position_mm - centre) / half), (4, log_force)):
        error = truth - raw[:, first]
        width = np.exp(np.where(error < 0, raw[:, first + 1], raw[:, first + 2]))
        factors.append(float(np.quantile(np.abs(error) / width, 0.95)))
    return Network(network.inputs, network.layers, network.position_mm, network.force_n, (factors[0], factors[1]))
