"""Which points are worth having, and which one a wish picks."""

from collections.abc import Sequence

from beamtouch_models.errors import InputError
from beamtouch_models.trade.points import Point


class NotToBeHadError(InputError):
    """No point of the trade meets the wish."""


def pareto_front(points: Sequence[Point]) -> list[Point]:
    """Points that no other beats in latency, error and number of sensors at once, the quickest first."""
    return sorted(
        (point for point in points if not any(_beats(other, point) for other in points)),
        key=lambda point: (point.latency_ms, point.error_mm, point.sensors),
    )


def _beats(one: Point, other: Point) -> bool:
    """Whether one is nowhere worse and somewhere better."""
    ours, theirs = ((point.latency_ms, point.error_mm, point.sensors) for point in (one, other))
    return all(a <= b for a, b in zip(ours, theirs, strict=True)) and ours != theirs


def most_accurate(points: Sequence[Point], latency_ms: float) -> Point:
    """Return the point of least error that answers within a latency; NotToBeHadError names the nearest otherwise."""
    kept = [point for point in points if point.latency_ms <= latency_ms]
    if not kept:
        nearest = min(points, key=lambda point: point.latency_ms)
        message = (
            f"nothing answers within {latency_ms:g} ms; the quickest takes {nearest.latency_ms:.3g} ms "
            f"({named(nearest)}); raise sensors.rate_hz"
        )
        raise NotToBeHadError(message)
    return min(kept, key=lambda point: (point.error_mm, point.latency_ms))


def quickest(points: Sequence[Point], error_mm: float) -> Point:
    """Return the quickest point within an error, then that of fewest sensors; NotToBeHadError names the nearest."""
    kept = [point for point in points if point.error_mm <= error_mm]
    if not kept:
        nearest = min(points, key=lambda point: point.error_mm)
        message = (
            f"nothing has a mean error of {error_mm:g} mm; the best has {nearest.error_mm:.3g} mm ({named(nearest)}); "
            "allow more sensors, more requirements.latency_ms, or take sensors with less noise"
        )
        raise NotToBeHadError(message)
    return min(kept, key=lambda point: (point.latency_ms, point.sensors))


def named(point: Point) -> str:
    """Say what a point is, in a few words."""
    smoothing = "no filter" if point.filter.window == 1 else f"mean of {point.filter.window} readings"
    return f"{point.estimator}{', int8' if point.quantised else ''}, {point.sensors} sensors, {smoothing}"
