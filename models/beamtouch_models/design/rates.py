"""The largest rate at which rest may be taken for a contact."""

SECONDS_PER_DAY = 86_400
MAX_FALSE = 0.01
"""Largest share of samples at rest that may be taken for a contact; above it, nothing tells a contact from rest."""


def max_false_per_day(rate_hz: float) -> float:
    """Return the largest number of false contacts per day that a threshold can be chosen for."""
    return MAX_FALSE * SECONDS_PER_DAY * rate_hz
