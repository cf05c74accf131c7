"""Tasks on any executor of `concurrent.futures`."""

import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import TypeVar

from beamtouch_models.sweeps import on_one_thread

Task = TypeVar("Task")
Found = TypeVar("Found")


def submitted(
    executor: Executor,
    wait: Callable[[Future[Found]], Found],
    function: Callable[[Task], Found],
    tasks: Iterable[Task],
) -> Iterator[Found]:
    """Submit all tasks at once, and yield their results in order."""
    with _interrupts_stay_here():
        futures = [executor.submit(on_one_thread, function, task) for task in tasks]
    return _results(futures, wait)


def _results(futures: list[Future[Found]], wait: Callable[[Future[Found]], Found]) -> Iterator[Found]:
    futures.reverse()
    while futures:
        yield wait(futures.pop())  # popped, so that a result is not kept once it is taken


@contextmanager
def _interrupts_stay_here() -> Iterator[None]:
    """Start processes and threads with Ctrl-C blocked: a terminal sends it to all, and this process ends the others."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
