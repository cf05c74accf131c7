"""Waiting for what another process does."""

import time
from collections.abc import Callable


def wait_until(condition: Callable[[], bool], within_s: float = 60, pause_s: float = 0.01) -> None:
    """Poll until a condition holds."""
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, f"it did not come true within {within_s:g} s"
        time.sleep(pause_s)
