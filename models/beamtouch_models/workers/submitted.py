"""Tasks on any executor of `concurrent.futures`, and worker processes on this machine."""

import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context
from typing import TypeVar

from beamtouch_common.errors import FailedError
from beamtouch_models.sweeps import Spread, on_one_thread
from beamtouch_models.workers.beginning import begin

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


@contextmanager
def processes(workers: int) -> Iterator[Spread]:
    """Spread tasks over processes, which start with the first task; FailedError if one ends before its work is done."""
    before = set(active_children())
    # A forked process would share the locks of threads that it does not have: of the progress bar, of linear algebra.
    executor = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=begin)
    try:
        yield partial(submitted, executor, Future.result)
        executor.shutdown()
    except BrokenProcessPool:
        message = "a worker process ended before its work was done; if memory was short, use fewer --workers"
        raise FailedError(message) from None
    finally:
        # After an error or Ctrl-C they would first finish all tasks. These are not cancelled: the executor fails them
        # when it finds its workers gone, and complains in a thread of its own about one that is cancelled.
        for worker in set(active_children()) - before:
            worker.terminate()
        executor.shutdown()
