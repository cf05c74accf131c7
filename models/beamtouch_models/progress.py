"""The types of progress callbacks."""

from collections.abc import Callable

Fraction = Callable[[float], None]
"""Called with the fraction of a piece of work that is done, 0 to 1."""
Progress = Callable[[str, float], None]
"""Called with the current step, and the fraction of the whole that is done."""


def silent(*_: object) -> None:
    """Report no progress."""
