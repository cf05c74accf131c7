"""Long work in steps, between which the event loop turns: no request may keep the others waiting."""

from asyncio import Lock, get_running_loop, sleep
from collections.abc import Iterable, Iterator
from time import perf_counter

SLICE_S = 0.004
"""Longest time without a turn of the loop, but for the step that ends it. A step takes about a millisecond."""


class Stepper:
    """Does long work, one after another: ten at once would take ten slices between two turns for anything else.

    The first slice of each work waits for no work that is longer, only for a turn of the loop if other first slices
    have taken a slice since the last one. So the loop turns after three slices at the latest, of which one is of the
    long work. The routes and the record have one each, so that no answer to a batch waits until the record has taken
    another.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        """Held by the work that is longer than a slice."""
        self._begun_s = 0.0
        """Time that first slices have taken since the loop turned for them [s]."""

    async def finish(self, steps: Iterable[object]) -> None:
        """Take all steps. What takes no longer than a slice does not wait for longer work."""
        rest = iter(steps)
        while self._begun_s >= SLICE_S:  # noqa: ASYNC110  # for a turn, not for an event
            await sleep(0)
        if self._begin(rest):
            return
        async with self._lock:
            is_done = False
            while not is_done:
                await sleep(0)
                is_done = _is_done(rest)

    def _begin(self, steps: Iterator[object]) -> bool:
        """Take steps for a first slice; return whether there are no more."""
        begin_s = perf_counter()
        try:
            return _is_done(steps)
        finally:
            self._begun_s += perf_counter() - begin_s
            if self._begun_s >= SLICE_S:
                get_running_loop().call_soon(self._turn)

    def _turn(self) -> None:
        self._begun_s = 0.0


def _is_done(steps: Iterator[object]) -> bool:
    """Take steps for a slice; return whether there are no more."""
    end_s = perf_counter() + SLICE_S
    return all(perf_counter() < end_s for _ in steps)
