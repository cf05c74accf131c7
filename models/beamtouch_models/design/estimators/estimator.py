"""The estimators by name. Each is a function from a prior to a graph."""

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
import onnx

from beamtouch_models.design.accuracy.limit import limits_without
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.estimators.paper_network import paper_graph, trained_as_in_the_paper
from beamtouch_models.design.estimators.posterior.window import posterior_graph, windowed_graph
from beamtouch_models.design.estimators.small_network import first_stage, train
from beamtouch_models.design.sweeps import Fraction
from beamtouch_models.errors import SceneError
from beamtouch_models.names import ESTIMATORS, EstimatorName

ENOUGH = 0.5
"""A set of channels determines a position if its error is at most this share of the error of a guess without any."""
DRAWS, PLATE_DRAWS, LEAST_DRAWS = 512, 128, 64
"""Usual number of simulated contacts on a beam and on a plate, whose posteriors take longer, and the smallest."""
MAX_SETS = 70
"""Up to this many sets of one size are all evaluated; of more, only sets of neighbours, which have the least
information."""


def fewest_channels(prior: Prior, seed: int, effort: Effort = USUAL) -> int:
    """Return the smallest number such that any set of as many channels determines a position.

    More channels never have less information, so the first sufficient number is the answer. All channels together
    always count as sufficient, because their answer comes with its interval.
    """
    # The mean distance from the median of a uniform distribution is a quarter of its range.
    guess_percent = float(np.linalg.norm(prior.extent.size_mm)) / 4 / prior.diagonal_mm * 100
    every = range(prior.channels)
    usual = DRAWS if prior.extent.axes == 1 else PLATE_DRAWS
    for size in range(prior.extent.axes, prior.channels):  # fewer channels than axes tell no place
        neighbours = (tuple(range(start, start + size)) for start in range(prior.channels - size + 1))
        sets = neighbours if comb(prior.channels, size) > MAX_SETS else combinations(every, size)
        missing = (sorted(set(every) - set(working)) for working in sets)
        limits = limits_without(prior, missing, effort.of(usual, LEAST_DRAWS), seed)
        if all(compared.limit.value <= ENOUGH * guess_percent for compared in limits):
            return size
    return prior.channels


@dataclass(frozen=True)
class Estimator:
    """A finished estimator."""

    name: EstimatorName
    graph: onnx.ModelProto
    """Without metadata."""
    min_channels: int
    """Smallest number of working channels with which it gives a position."""


def estimator_of(
    name: EstimatorName,
    prior: Prior,
    *,
    min_noise_mm: float,
    with_force: bool,
    seed: int,
    progress: Fraction,
    effort: Effort = USUAL,
) -> Estimator:
    """Make an estimator for a prior; the same seed gives the same graph.

    `min_noise_mm` is the noise of samples of the most readings, which a posterior must still resolve.

    Raises
    ------
    SceneError
        A network is asked for on two axes.
    """
    if prior.extent.axes > 1 and name != ESTIMATORS[0]:
        raise SceneError(f"estimator: {name} knows one axis only, and contacts have two; take {ESTIMATORS[0]}")
    match name:
        case "posterior":
            finest = prior.at_noise(min_noise_mm)
            graph = posterior_graph(prior, with_force=with_force, finest=finest)
            fewest = fewest_channels(prior, seed, effort)
        case "small-network":
            # A single channel leaves several places far apart, and the network looks around one.
            fewest = min(max(2, fewest_channels(prior, seed, effort)), prior.channels)
            network = train(prior, seed, progress, fewest=fewest)
            graph = windowed_graph(prior, network.table, first_stage(network), with_force=with_force)
        case "paper-network":
            graph, fewest = paper_graph(trained_as_in_the_paper(prior, seed, effort)), prior.channels
    progress(1.0)
    return Estimator(name, graph, fewest)
