"""Long work in steps, between which the event loop turns: no request may keep the others waiting."""

from asyncio import Lock, sleep
from collections.abc import Iterable, Iterator
from time import perf_counter

SLICE_S = 0.004
"""Longest time without a turn of the loop, but for the step that ends it. A step takes about a millisecond."""


class Stepper:
    """Does long work, one after another: ten at once would take ten slices between two turns for anything else.

    The routes and the record have one each, so that no answer to a batch waits until the record has taken another. So
    the loop turns after two slices at the latest.
    """

    def __init__(self) -> None:
        self._lock = Lock()

    async def finish(self, steps: Iterable[object]) -> None:
        """Take all steps. What takes no longer than a slice waits for nothing."""
        rest = iter(steps)
        if _is_done(rest):
            return
        async with self._lock:
            is_done = False
            while not is_done:
                await sleep(0)
                is_done = _is_done(rest)


def _is_done(steps: Iterator[object]) -> bool:
    """Take steps for a slice; return whether there are no more."""
    end_s = perf_counter() + SLICE_S
    return all(perf_counter() < end_s for _ in steps)
