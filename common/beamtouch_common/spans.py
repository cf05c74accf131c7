"""Spans of time, and differences of clocks, in words."""

_UNITS = (("days", 86_400.0), ("hours", 3600.0), ("minutes", 60.0), ("s", 1.0))
APART_S = 60.0
"""Clocks that differ by more are named."""


def span(seconds: float) -> str:
    """Return a span of time in the largest unit of which it has two or more; seconds otherwise."""
    unit, size_s = next((row for row in _UNITS if abs(seconds) >= 2 * row[1]), _UNITS[-1])
    return f"{seconds / size_s:.0f} {unit}"


def are_apart(ahead_s: float) -> bool:
    """Return whether two clocks differ by so much that it is worth a line in the log."""
    return abs(ahead_s) > APART_S


def apart(ahead_s: float) -> str:
    """Return how far one clock is ahead of another, as in "2 hours ahead of" and "2 minutes behind"."""
    return f"{span(abs(ahead_s))} {'ahead of' if ahead_s > 0 else 'behind'}"
