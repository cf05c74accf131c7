"""A point of the trade: estimator, sensors, filter and precision, with its error and cost."""

from dataclasses import dataclass

from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.estimators.estimator import Name
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.trade.timing import Times


@dataclass(frozen=True)
class Point:
    """One way to build the model of a scene."""

    estimator: Name
    sensors: int
    filter: FilterChoice
    quantised: bool
    error_percent: Measurement
    """Mean |position error| in percent of the length."""
    error_mm: float
    limit_percent: Measurement
    """Accuracy limit of this layout and filter, on the same contacts."""
    ratio: Measurement
    times: Times
    poll_ms: float
    """Time from a reading until the daemon has it."""
    bytes: int
    latency_ms: float
    """Time from a touch to the first answer for it alone: half a period on average, poll, filter, inference."""


@dataclass(frozen=True)
class Failure:
    """A point, or all points of a layout, that could not be built."""

    estimator: Name | None
    """None if the layout failed, for every estimator."""
    sensors: int
    filter: FilterChoice
    reason: str


@dataclass(frozen=True)
class Trade:
    """The points so far."""

    points: tuple[Point, ...]
    failures: tuple[Failure, ...]
    planned: int
    """Number of points at the end, if none fails."""
    timed_alone: bool
    """Whether nothing else ran while inferences were timed; False as long as layouts are being measured."""
