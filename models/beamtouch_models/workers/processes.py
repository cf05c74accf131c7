"""Worker processes on this machine, and tasks on any executor of `concurrent.futures`."""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, connection, get_context, parent_process
from threading import Thread
from typing import TypeVar

from beamtouch_common.errors import FailedError
from beamtouch_models.sweeps import Spread, on_one_thread

Task = TypeVar("Task")
Found = TypeVar("Found")


def submit(
    executor: Executor,
    wait: Callable[[Future[Found]], Found],
    function: Callable[[Task], Found],
    tasks: Iterable[Task],
) -> Iterator[Found]:
    """Submit all tasks at once, and return an iterator over their results in order."""
    # Processes and threads start with Ctrl-C blocked: a terminal sends it to all, and this process ends the others.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        futures = [executor.submit(on_one_thread, function, task) for task in tasks]
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    futures.reverse()
    # Popped, so that a result is not kept once it is taken.
    return (wait(futures.pop()) for _ in range(len(futures)))


@contextmanager
def processes(workers: int) -> Iterator[Spread]:
    """Spread tasks over processes, which start with the first task; FailedError if one ends before its work is done."""
    before = set(active_children())
    # Workers inherit this. There is one on each core; each would start threads for linear algebra on all of them.
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    # A forked process would share the locks of threads that it does not have: of the progress bar, of linear algebra.
    executor = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_end_with_parent)
    try:
        yield partial(submit, executor, Future.result)
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


def _end_with_parent() -> None:
    """Watch the process that started this one, and end when it is gone: this worker would wait for tasks forever."""
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            connection.wait([parent.sentinel])
            os._exit(1)

    Thread(target=watch, daemon=True).start()
