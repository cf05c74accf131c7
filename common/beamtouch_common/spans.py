"""Spans of time in words."""

_UNITS = (("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0), ("s", 1.0))


def span(seconds: float) -> str:
    """Return a span of time in the largest unit of which it has two or more; seconds otherwise."""
    unit, size_s = next((one for one in _UNITS if abs(seconds) >= 2 * one[1]), _UNITS[-1])
    return f"{seconds / size_s:.0f} {unit}"
