"""A small network from deflections to position, force and contact, each with its interval.

Its inputs are made independent of the force as far as they can be: the direction of the deflection vector, which says
where, turned to its principal axes, and the logarithm of its length, which says how hard. Its outputs are quantiles,
trained with the quantile ("pinball") loss, so that the middle one minimises the paper's mean absolute error and the
outer ones bound 95 % of the cases; contact is trained with the cross-entropy, which makes it a log odds.
Koenker & Bassett, Regression Quantiles, Econometrica 46 (1978), doi 10.2307/1913643.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from threadpoolctl import threadpool_limits

from beamtouch_models.beam import scene_influence
from beamtouch_models.scene import Scene

Float32 = NDArray[np.float32]
Bools = NDArray[np.bool_]

HIDDEN = 32
BATCH = 1024
LEARNING_RATE = 4e-3
QUANTILES = (0.025, 0.5, 0.975)
TABLE = 2001
"""Load positions of the influence table that training draws from."""
MISSING_FRACTION = 0.15
"""Share of the training samples in which one channel is missing, where the scene can do without it."""


@dataclass(frozen=True)
class Inputs:
    """How a deflection becomes the input of the first layer."""

    noise_mm: float
    centre: Float32
    """(channels,) mean direction of a contact's deflection."""
    axes: Float32
    """(channels, channels) principal axes of the directions, each over its spread."""
    log_centre: float
    log_spread: float

    def features(self, deflection_mm: Float32, valid: Bools) -> Float32:
        """Inputs of the first layer, (batch, 2 channels + 1)."""
        scaled = np.where(valid, deflection_mm, np.float32(0)) / np.float32(self.noise_mm)
        length = np.sqrt((scaled**2).sum(axis=1, keepdims=True) + np.float32(1))
        direction = (scaled / length - self.centre) @ self.axes
        log_length = (np.log(length) - np.float32(self.log_centre)) / np.float32(self.log_spread)
        missing = (~valid).astype(np.float32)
        return np.concatenate([direction, log_length, missing], axis=1)

    def log_length(self, deflection_mm: Float32, valid: Bools) -> Float32:
        """Logarithm of the length of the deflection in units of the noise, (batch,)."""
        scaled = np.where(valid, deflection_mm, np.float32(0)) / np.float32(self.noise_mm)
        log: Float32 = np.log(np.sqrt((scaled**2).sum(axis=1) + np.float32(1)))
        return log


@dataclass(frozen=True)
class Network:
    """Weights and scales; `export` writes the same arithmetic as an ONNX graph.

    Raw outputs, a column each: position's median, and the logits of the widths below and above it; the contact's log
    odds; the same three for the logarithm of the force over the length of the deflection.
    """

    inputs: Inputs
    layers: tuple[tuple[Float32, Float32], ...]
    """(weights, bias) of two hidden layers with tanh and a linear last one."""
    position_mm: tuple[float, float]
    force_n: tuple[float, float]
    width: tuple[float, float] = (1.0, 1.0)
    """Factors on the widths of the position's and the force's interval, set so that 95 % hold the truth."""

    def raw(self, features: Float32) -> Float32:
        """Raw outputs (batch, 7) of features (batch, 2 channels + 1)."""
        value = features
        for weights, bias in self.layers[:-1]:
            value = np.tanh(value @ weights + bias)
        weights, bias = self.layers[-1]
        return value @ weights + bias

    @property
    def position_scale(self) -> tuple[float, float]:
        """Centre and half width of the position range: position = centre + half width x raw."""
        low, high = self.position_mm
        return (low + high) / 2, (high - low) / 2


@dataclass(frozen=True)
class Truth:
    """A training batch."""

    deflection_mm: Float32
    valid: Bools
    touched: Bools
    position: Float32
    """-1 .. 1 over the position range."""
    log_force: Float32
    """Logarithm of the force over the length of the deflection; without meaning where nothing touches."""


class Contacts(NamedTuple):
    """Simulated samples."""

    deflection_mm: Float32
    """(samples, channels), with noise."""
    valid: Bools
    touched: Bools
    position_mm: Float32
    force_n: Float32
    """Of a contact; without meaning where nothing touches."""


@dataclass(frozen=True)
class Simulator:
    """Endless training samples of a scene: contacts, drawn uniformly from its ranges, and rest, half and half."""

    scene: Scene
    sensor_mm: NDArray[np.float64]
    noise_mm: float
    may_miss_one: bool
    """Whether one channel is missing now and then."""

    @cached_property
    def influence(self) -> CubicSpline:
        """Influence of a load at a position, mm/N per sensor; off by less than 1e-7 of the largest.

        A table, as beam elements take longer for a batch than a training step does.
        """
        grid = np.linspace(*self.scene.contact.position_mm, TABLE)
        return CubicSpline(grid, scene_influence(self.scene, self.sensor_mm, grid))

    def draw(self, rng: np.random.Generator, size: int, *, touched: bool | None = None) -> Contacts:
        """Draw samples; `touched` fixes the state of all."""
        position = rng.uniform(*self.scene.contact.position_mm, size=size)
        force = rng.uniform(*self.scene.contact.force_range_n, size=size)
        state = rng.random(size) < 0.5 if touched is None else np.full(size, touched)
        clean = (force * state)[:, None] * self.influence(position)
        deflection = (clean + rng.normal(scale=self.noise_mm, size=clean.shape)).astype(np.float32)
        valid = np.ones(deflection.shape, np.bool_)
        if self.may_miss_one:
            lacking = np.flatnonzero(rng.random(size) < MISSING_FRACTION)
            valid[lacking, rng.integers(len(self.sensor_mm), size=len(lacking))] = False
        return Contacts(deflection, valid, state, position.astype(np.float32), force.astype(np.float32))


def train(simulator: Simulator, seed: int, steps: int, progress: Callable[[int], None]) -> Network:
    """Train a network by Adam with a cosine schedule; the same seed gives the same weights.

    `progress` is called with the number of steps done, about a hundred times.
    """
    # The matrices are small: a second thread costs more than it saves, and leaves the order of sums to chance.
    with threadpool_limits(1, user_api="blas"):
        return _train(simulator, seed, steps, progress)


def _train(simulator: Simulator, seed: int, steps: int, progress: Callable[[int], None]) -> Network:
    rng = np.random.default_rng(seed)
    network = _initial(simulator, rng)
    parameters = [array.copy() for layer in network.layers for array in layer]
    mean = [np.zeros_like(array) for array in parameters]
    square = [np.zeros_like(array) for array in parameters]
    for step in range(1, steps + 1):
        network = replace(network, layers=tuple(zip(parameters[::2], parameters[1::2], strict=True)))
        gradients = _gradients(network, _truth(network, simulator, rng))
        rate = LEARNING_RATE * (1 + np.cos(np.pi * step / steps)) / 2
        corrected = rate * np.sqrt(1 - 0.999**step) / (1 - 0.9**step)
        for index, gradient in enumerate(gradients):
            mean[index] += 0.1 * (gradient - mean[index])
            square[index] += 0.001 * (gradient**2 - square[index])
            parameters[index] -= np.float32(corrected) * mean[index] / (np.sqrt(square[index]) + np.float32(1e-8))
        if step % max(1, steps // 100) == 0:
            progress(step)
    return network


def _initial(simulator: Simulator, rng: np.random.Generator) -> Network:
    """Scales from simulated contacts, weights at random (Glorot)."""
    scaled = simulator.draw(rng, 20_000, touched=True).deflection_mm / np.float32(simulator.noise_mm)
    length = np.sqrt((scaled**2).sum(axis=1, keepdims=True) + 1)
    direction = scaled / length
    centre = direction.mean(axis=0)
    _, spread, rows = np.linalg.svd(direction - centre, full_matrices=False)
    axes = rows.T / np.maximum(spread / np.sqrt(len(direction)), 1e-6)
    log_length = np.log(length)
    inputs = Inputs(
        simulator.noise_mm,
        centre.astype(np.float32),
        axes.astype(np.float32),
        float(log_length.mean()),
        float(max(log_length.std(), 1e-3)),
    )
    sizes = [2 * len(centre) + 1, HIDDEN, HIDDEN, 7]
    layers = tuple(
        (
            rng.normal(scale=np.sqrt(2 / (fan_in + fan_out)), size=(fan_in, fan_out)).astype(np.float32),
            np.zeros(fan_out, np.float32),
        )
        for fan_in, fan_out in pairwise(sizes)
    )
    return Network(inputs, layers, simulator.scene.contact.position_mm, simulator.scene.contact.force_range_n)


def _truth(network: Network, simulator: Simulator, rng: np.random.Generator) -> Truth:
    drawn = simulator.draw(rng, BATCH)
    centre, half = network.position_scale
    log_force = np.log(drawn.force_n) - network.inputs.log_length(drawn.deflection_mm, drawn.valid)
    position = (drawn.position_mm - np.float32(centre)) / np.float32(half)
    return Truth(drawn.deflection_mm, drawn.valid, drawn.touched, position, log_force)


def _gradients(network: Network, truth: Truth) -> list[Float32]:
    """Gradient of the mean loss by the parameters, in the order weights, bias, weights, bias, ..."""
    value = network.inputs.features(truth.deflection_mm, truth.valid)
    values = [value]
    for weights, bias in network.layers[:-1]:
        value = np.tanh(value @ weights + bias)
        values.append(value)
    weights, bias = network.layers[-1]
    slope: Float32 = _output_gradient(value @ weights + bias, truth) / np.float32(len(value))
    gradients: list[Float32] = []
    for index in range(len(network.layers) - 1, -1, -1):
        gradients[:0] = [values[index].T @ slope, slope.sum(axis=0)]
        if index:
            slope = (slope @ network.layers[index][0].T) * (1 - values[index] ** 2)
    return gradients


def _output_gradient(raw: Float32, truth: Truth) -> Float32:
    """Gradient of each sample's loss by the raw outputs, (batch, 7)."""
    slope = np.zeros_like(raw)
    slope[:, 0:3] = _pinball_gradient(raw[:, 0:3], truth.position) * truth.touched[:, None]
    slope[:, 3] = sigmoid(raw[:, 3]) - truth.touched
    slope[:, 4:7] = _pinball_gradient(raw[:, 4:7], truth.log_force) * truth.touched[:, None]
    return slope


def _pinball_gradient(raw: Float32, target: Float32) -> Float32:
    """Gradient of the three quantile losses by (median, logit of width below, logit of width above)."""
    median, below, above = raw[:, 0], raw[:, 1], raw[:, 2]
    low = (target < median - softplus(below)) - np.float32(QUANTILES[0])
    middle = (target < median) - np.float32(QUANTILES[1])
    high = (target < median + softplus(above)) - np.float32(QUANTILES[2])
    # The outer losses are small where the interval is right; a weight of 4 makes them learn as fast as the median.
    return np.stack([middle, -4 * low * sigmoid(below), 4 * high * sigmoid(above)], axis=1).astype(np.float32)


def sigmoid(value: Float32) -> Float32:
    """1 / (1 + exp(-value)), without overflow."""
    return np.asarray((np.tanh(value / 2) + 1) / 2, np.float32)


def softplus(value: Float32) -> Float32:
    """log(1 + exp(value)), without overflow."""
    return np.asarray(np.maximum(value, 0) + np.log1p(np.exp(-np.abs(value))), np.float32)
