"""The estimators by name. Each is a function from a prior to a graph; the first is the default."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import onnx

from beamtouch_models.estimators.posterior.channels import fewest_channels
from beamtouch_models.estimators.posterior.graph import posterior_graph
from beamtouch_models.prior import Prior

Name = Literal["posterior"]
NAMES: tuple[Name, ...] = get_args(Name)
Progress = Callable[[float], None]
"""Called with the fraction that is done."""


@dataclass(frozen=True)
class Estimator:
    """A finished estimator."""

    name: Name
    graph: onnx.ModelProto
    """Without metadata."""
    min_channels: int
    """With fewer working channels it gives no position."""


def estimator_of(name: Name, prior: Prior, *, with_force: bool, seed: int, progress: Progress) -> Estimator:
    """Make an estimator for a prior; the same seed gives the same graph."""
    match name:
        case "posterior":
            graph = posterior_graph(prior, with_force=with_force)
            return Estimator(name, graph, fewest_channels(prior, seed))
