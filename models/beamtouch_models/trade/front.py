"""The Pareto front of the trade, and the point that meets a requirement."""

from collections.abc import Sequence

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models.trade.point import Point


class NotToBeHadError(InputError):
    """No point of the trade meets the requirement."""


def pareto_front(points: Sequence[Point]) -> list[Point]:
    """Return the points that no other dominates in latency, error and number of sensors; fastest first."""
    return sorted(
        (point for point in points if not any(_beats(other, point) for other in points)),
        key=lambda point: (point.latency_ms, point.error_mm, point.sensors),
    )


def _beats(one: Point, other: Point) -> bool:
    """Return whether a point is better in one respect and worse in none."""
    ours, theirs = ((point.latency_ms, point.error_mm, point.sensors) for point in (one, other))
    return all(a <= b for a, b in zip(ours, theirs, strict=True)) and ours != theirs


def most_accurate(points: Sequence[Point], latency_ms: float) -> Point:
    """Return the point with the smallest error within a latency; otherwise NotToBeHadError names the nearest."""
    kept = [point for point in points if point.latency_ms <= latency_ms]
    if not kept:
        nearest = min(points, key=lambda point: point.latency_ms)
        message = (
            f"no point answers within {latency_ms:g} ms; the fastest takes {digits(nearest.latency_ms, 3)} ms "
            f"({named(nearest)}); raise sensors.rate_hz"
        )
        raise NotToBeHadError(message)
    return min(kept, key=lambda point: (point.error_mm, point.latency_ms))


def quickest(points: Sequence[Point], error_mm: float) -> Point:
    """Return the fastest point within an error, ties by sensors; otherwise NotToBeHadError names the nearest."""
    kept = [point for point in points if point.error_mm <= error_mm]
    if not kept:
        nearest = min(points, key=lambda point: point.error_mm)
        message = (
            f"no point has a mean error of {error_mm:g} mm; the best has {digits(nearest.error_mm, 3)} mm "
            f"({named(nearest)}); allow more sensors or more requirements.latency_ms, or use sensors with less noise"
        )
        raise NotToBeHadError(message)
    return min(kept, key=lambda point: (point.latency_ms, point.sensors))


def named(point: Point) -> str:
    """Return a short description of a point."""
    smoothing = "no filter" if point.filter.window == 1 else f"mean of {point.filter.window} readings"
    return f"{point.estimator}{', int8' if point.quantised else ''}, {point.sensors} sensors, {smoothing}"
