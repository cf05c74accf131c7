"""The answers of a trade's models, the front of them, and the one that meets a requirement."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.trade.measure import Model
from beamtouch_models.trade.timing import Times

SERIAL_BAUD, FRAME_BYTES, BYTE_BITS = 1_000_000, 13, 10
"""Transfer of a reading by PROTOCOL.md: FRAME_BYTES and two bytes per channel, of ten bits each."""


class NotToBeHadError(InputError):
    """No point of the trade meets the requirement."""


@dataclass(frozen=True)
class Point:
    """A model that `build` makes of the scene, and one time at which it answers."""

    model: Model
    readings: int
    error_mm: Measurement
    """Mean |position error| of the answer on a beam that follows a touch at once."""
    latency_ms: float
    """Time from a touch to the answer: these readings, the transfer of one, and an inference."""
    periods: int
    """The same in reading periods. A touch comes at any time within one, so a fraction of it is no difference."""

    def __str__(self) -> str:
        """Return the point in words."""
        mean = "one reading" if self.readings == 1 else f"mean of {self.readings} readings"
        return f"{self.model.estimator}, {self.model.sensors} sensors, {mean}"


def transfer_ms(sensors: int) -> float:
    """Return the time in which a reading comes over a serial line, in ms."""
    return (FRAME_BYTES + 2 * sensors) * BYTE_BITS / SERIAL_BAUD * 1e3


def points_of(model: Model, times: Times) -> list[Point]:
    """Return a point for each answer of a model."""
    after_ms = transfer_ms(model.sensors) + times.p50_us / 1e3
    return [
        Point(
            model,
            one.readings,
            one.error_mm,
            one.since_ms + after_ms,
            round((one.since_ms + after_ms) / one.since_ms * one.readings),
        )
        for one in model.answers
    ]


def pareto_front(points: Sequence[Point]) -> list[Point]:
    """Return the points that no other one beats in time, error and number of sensors; fewest sensors and fastest first.

    Errors differ if they do so by more than the standard error of their difference, and times by a reading period.
    """
    return sorted(
        (point for point in points if not any(_beats(other, point) for other in points)),
        key=lambda point: (point.model.sensors, point.latency_ms),
    )


def is_smaller(one: Measurement, other: Measurement) -> bool:
    """Return whether one error is smaller than another by more than the standard error of their difference."""
    return one.value < other.value - hypot(one.standard_error, other.standard_error)


def _beats(one: Point, other: Point) -> bool:
    """Return whether a point is better in one respect and worse in none."""
    ours, theirs = ((point.model.sensors, point.periods) for point in (one, other))
    if any(a > b for a, b in zip(ours, theirs, strict=True)) or is_smaller(other.error_mm, one.error_mm):
        return False
    return ours != theirs or is_smaller(one.error_mm, other.error_mm)


def most_accurate(points: Sequence[Point], latency_ms: float) -> Point:
    """Return the point with the smallest error within a latency; otherwise NotToBeHadError names the nearest."""
    kept = [point for point in points if point.latency_ms <= latency_ms]
    if not kept:
        nearest = min(points, key=lambda point: point.latency_ms)
        message = (
            f"no point answers within {latency_ms:g} ms; the fastest takes {digits(nearest.latency_ms, 3)} ms "
            f"({nearest}); raise sensors.rate_hz"
        )
        raise NotToBeHadError(message)
    return min(kept, key=lambda point: (point.error_mm.value, point.latency_ms))


def quickest(points: Sequence[Point], error_mm: float) -> Point:
    """Return the fastest point within an error, ties by sensors; otherwise NotToBeHadError names the nearest."""
    kept = [point for point in points if point.error_mm.value <= error_mm]
    if not kept:
        nearest = min(points, key=lambda point: point.error_mm.value)
        message = (
            f"no point has a mean error of {error_mm:g} mm; the best has {digits(nearest.error_mm.value, 3)} mm "
            f"({nearest}); allow more sensors or a larger requirements.max_mean_ms, or use sensors with less noise"
        )
        raise NotToBeHadError(message)
    return min(kept, key=lambda point: (point.periods, point.model.sensors, point.latency_ms))
