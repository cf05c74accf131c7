"""Worker processes on this machine."""

from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from multiprocessing import active_children, get_context

from beamtouch_common.errors import FailedError
from beamtouch_models.sweeps import Spread
from beamtouch_models.workers.beginning import begin
from beamtouch_models.workers.submitted import submitted


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
