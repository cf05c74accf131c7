"""Priors of the shipped scenes for tests of the posterior, and running graphs on contacts."""

from functools import cache, lru_cache

import numpy as np
import onnx

from beamtouch_models import resolve
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.accuracy.prior import MAX_FORCE_RATIO, Forces, Prior
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.physics.influence_function import travel_of
from beamtouch_models.design.scene import load_scene
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.session import runner
from support.surfaces.example_scenes import SCENES

TINY = np.nextafter(np.float32(0), np.float32(1))
"""The smallest subnormal of float32."""


@lru_cache
def prior_of(name: str, sensors: int, noise_percent: float, *, known: bool) -> Prior:
    """Prior of a shipped scene with so many sensors; `noise_percent` of the largest deflection."""
    scene, _ = load_scene(SCENES / f"{name}.toml")
    low, high = scene.contact.force_range_n
    force = (high, high) if known else (min(low, high / 10), high)
    contact = scene.contact.model_copy(update={"force_n": force})
    scene = scene.model_copy(update={"contact": contact})
    noise_mm = travel_of(influence_of(scene)).largest_mm * noise_percent / 100
    return Prior.of(influence_of(scene), on_axis(_positions_mm(name, sensors)), Errors(noise_mm))


@cache
def _positions_mm(name: str, sensors: int) -> Floats:
    """The layout of sensors on a shipped scene, whatever the force and the noise."""
    scene, _ = load_scene(SCENES / f"{name}.toml")
    return resolve(scene).place(sensors, criterion="eigenvalue-product", seed=1).positions_mm


def with_floor(prior: Prior) -> Prior:
    """The prior with the errors of gain and zero that a scene has by default, behind a mean of four readings."""
    return prior.with_floor(0.003, 0.4 * prior.errors.noise_mm)


def answers_of(
    graph: onnx.ModelProto, prior: Prior, deflection_mm: Floats, valid: Bools | None = None
) -> dict[str, Floats]:
    """Answers in float64 to deflections (samples, channels) with the prior's own noise and floor."""
    present = np.ones(deflection_mm.shape, np.bool_) if valid is None else valid
    reading = np.where(present, deflection_mm, 0.0)
    with np.errstate(over="ignore"):
        found = runner(to_bytes(graph))(reading, prior.errors.whitening(np.clip(reading, -1e30, 1e30), valid=present))
    return {name: values.astype(np.float64) for name, values in found.items()}


def graph_of(prior: Prior) -> onnx.ModelProto:
    """The posterior graph, with force where that is not exact."""
    return posterior_graph(prior, with_force=prior.force_n[0] < prior.force_n[1])


def plain_posterior(prior: Prior, reading: Floats, covariance_mm2: Floats, forces: Forces) -> tuple[Floats, Floats]:
    """The posterior of position: a grid of positions (1201,), and its density there, a sum over 400 forces a piece.

    `reading` (channels,) scatters with the whole covariance. From a noise of 2 % on, twenty times as many forces move
    no quantile by more than a ten-thousandth of the interval.
    """
    grid = np.linspace(*prior.extent.range_mm, 1201)
    shape, precision = prior.influence_at(on_axis(grid)), np.linalg.inv(covariance_mm2)
    square, along = np.einsum("gi,ij,gj->g", shape, precision, shape), shape @ precision @ reading
    density = np.zeros(len(grid))
    for piece in forces:
        ends = np.linspace(piece.low_n, piece.high_n, 1 if piece.low_n == piece.high_n else 401)
        force = ends if len(ends) == 1 else (ends[1:] + ends[:-1]) / 2
        # |z - F g|^2 expanded; in float64 that costs no digit that matters at these sizes.
        misfit = reading @ precision @ reading - 2 * np.outer(along, force) + np.outer(square, force**2)
        density += piece.share * np.exp(-misfit / 2).mean(axis=1)
    return grid, density


def quantiles_of(grid: Floats, density: Floats, *levels: float) -> Floats:
    """Quantiles of a density on a grid, by the trapezoidal rule."""
    below = np.append(0.0, np.cumsum(density[1:] + density[:-1]))
    return np.interp(levels, below / below[-1], grid)


def interval_of(grid: Floats, density: Floats) -> Floats:
    """The interval of a density on a grid over the range: an end that leaves out little beside the other tail reaches.

    It goes on to the end of the range, by and by as what it leaves out falls from four times to twice what lies between
    two quantiles of the other tail; and the other end draws in to the inner one of these.
    """
    low, inner_low, inner_high, high = quantiles_of(grid, density, 0.025, 0.035, 0.965, 0.975)
    stays_low, stays_high = np.interp(
        [(low - grid[0]) / (high - inner_high), (grid[-1] - high) / (inner_low - low)], [2.0, 4.0], [0.0, 1.0]
    )
    drawn_in = low + (1 - stays_high) * (inner_low - low), high - (1 - stays_low) * (high - inner_high)
    return np.array([grid[0] + stays_low * (drawn_in[0] - grid[0]), grid[-1] - stays_high * (grid[-1] - drawn_in[1])])


def nonsense(prior: Prior) -> Floats:
    """Readings that no contact explains, and some that one just might."""
    largest = prior.force_n[1] * float(np.abs(prior.influence_table(prior.extent.grid(101))).max())
    channels = prior.channels
    rng = np.random.default_rng(0)
    rows = [np.full(channels, size) for size in (0.0, TINY, -TINY, 1e-30, largest, -largest)]
    rows += [np.full(channels, sign * size) for size in (100 * largest, 1e6, 1e30, np.inf) for sign in (1, -1)]
    rows += [largest * np.eye(channels)[0], -largest * np.eye(channels)[-1]]
    rows += list(rng.normal(size=(50, channels)) * largest) + list(
        rng.normal(size=(50, channels)) * prior.errors.noise_mm
    )
    return np.array(rows)


def check_sane(prior: Prior, answers: dict[str, Floats]) -> None:
    """Every answer is a number, intervals hold their middle and lie in the range."""
    low, high = prior.extent.range_mm
    slack = 1e-5 * prior.diagonal_mm
    for name, values in answers.items():
        assert np.isfinite(values).all(), name
    assert (low - slack <= answers["position_low_mm"]).all()
    assert (answers["position_low_mm"] <= answers["position_mm"] + slack).all()
    assert (answers["position_mm"] <= answers["position_high_mm"] + slack).all()
    assert (answers["position_high_mm"] <= high + slack).all()
    if "force_n" in answers:
        ends = np.stack([answers[f"force{part}_n"] for part in ("_low", "", "_high")])
        assert (np.diff(ends, axis=0) >= 0).all()
        assert ends.min() >= 0
        assert ends.max() <= MAX_FORCE_RATIO * prior.force_n[1] * (1 + 1e-6)
