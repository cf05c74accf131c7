"""The workers of a sweep: this process, processes on this machine, or a Dask cluster."""

import logging
import os
import platform
import signal
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from importlib import metadata
from multiprocessing import active_children, connection, get_context, parent_process
from threading import Thread
from time import monotonic
from typing import TYPE_CHECKING, TypeVar

from beamtouch_common.errors import FailedError, InputError
from beamtouch_models.design.sweeps import TaskMap, in_turn, load_with_one_thread, on_one_thread

if TYPE_CHECKING:
    from distributed import Client

Task = TypeVar("Task")
Found = TypeVar("Found")

REACHED_S = 10.0
"""Longest time to reach the scheduler."""
WITHOUT_WORKERS_S = 60.0
"""Longest time without workers before the sweep fails; Dask replaces a worker that died within seconds."""
LOOKED_S = 1.0
"""Time between two looks at whether there are workers."""

_SAME = ("beamtouch", "numpy", "scipy", "onnxruntime", "distributed")
"""Packages whose version decides the bytes of a result, or whether a task arrives at all."""


def spread_over(workers: int | None, cluster: str | None) -> AbstractContextManager[TaskMap]:
    """Return where the tasks of a sweep run; the workers end with the context.

    Parameters
    ----------
    workers : number of processes on this machine, by default one per core; with 1, this process does the work
    cluster : address of a Dask scheduler, to use its workers instead

    Raises
    ------
    InputError
        The cluster cannot be used, or the extra for it is not installed.
    FailedError
        A worker ended before the work was done.
    """
    if cluster is not None:
        return cluster_at(cluster)
    number = workers or len(os.sched_getaffinity(0))
    return nullcontext(in_turn) if number == 1 else processes(number)


def _submit(
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
def processes(workers: int) -> Iterator[TaskMap]:
    """Spread tasks over processes, which start with the first task; FailedError if one ends before its work is done."""
    before = set(active_children())
    load_with_one_thread()  # there is a worker on each core; each would start threads on all of them
    # A forked process would share the locks of threads that it does not have: of the progress bar, of linear algebra.
    executor = ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=_end_with_parent)
    try:
        yield partial(_submit, executor, Future.result)
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


@contextmanager
def cluster_at(address: str, without_workers_s: float = WITHOUT_WORKERS_S) -> Iterator[TaskMap]:
    """Spread tasks over the workers of a Dask scheduler, as long as there are some.

    Raises
    ------
    InputError
        The scheduler cannot be reached, or its workers have another Python or other versions of what computes.
    FailedError
        The cluster ended before the work was done.
    """
    try:
        from distributed import Client, KilledWorker  # noqa: PLC0415  # it is an extra of its own
        from distributed.versions import VersionMismatchWarning  # noqa: PLC0415  # likewise
    except ModuleNotFoundError as error:
        raise InputError(f"--cluster needs {error.name}; run: pip install 'beamtouch[design,cluster]'") from None
    logging.disable(logging.CRITICAL)  # `distributed` also logs, at length, the errors that it raises
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # `_check` says it in one line
            client = Client(address, timeout=REACHED_S, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError):  # TypeError: TLS without certificates
        message = f"--cluster {address}: no Dask scheduler answers there; start `dask scheduler` or check the address"
        raise InputError(message) from None
    try:
        _check(client, address)
        # Not pure: Dask would have to hash all data to find out whether it has done the same task before.
        yield partial(_submit, client.get_executor(pure=False), partial(_result, client, without_workers_s))
    except (KilledWorker, CancelledError):
        raise FailedError(f"--cluster {address}: its scheduler or its workers ended before the work was done") from None
    finally:
        client.close(timeout=REACHED_S)


def _check(client: "Client", address: str) -> None:
    """Raise InputError unless there are workers, and each has the Python and the packages of this process."""
    if not _workers(client):
        message = f"--cluster {address}: it has no workers; run `dask worker {address} --nthreads 1` on each machine"
        raise InputError(message)
    asked: dict[str, Callable[[], str]] = {name: partial(metadata.version, name) for name in _SAME}
    for name, ask in {"Python": platform.python_version, **asked}.items():
        ours = ask()
        for worker, theirs in client.run(ask, on_error="return").items():
            if not isinstance(theirs, str) or _relevant(name, theirs) != _relevant(name, ours):
                has = f"{name} {theirs}" if isinstance(theirs, str) else f"no {name}"
                remedy = f"install 'beamtouch[design,cluster]' there, with {name} {ours}"
                raise InputError(f"--cluster {address}: its worker {worker} has {has}; {remedy}")


def _relevant(name: str, version: str) -> str:
    """Return what must be the same of a version: a Python that differs only in its last number computes the same."""
    return version.rpartition(".")[0] if name == "Python" else version


def _workers(client: "Client") -> int:
    return len(client.scheduler_info(n_workers=-1).get("workers", ()))  # none of a scheduler that is gone


def _result(client: "Client", without_workers_s: float, future: Future[Found]) -> Found:
    """Wait for a result; raises CancelledError once there have been no workers for `without_workers_s`."""
    seen = monotonic()
    while True:
        try:
            return future.result(timeout=LOOKED_S)
        except TimeoutError:
            if future.done():  # at this very moment, or the task itself ran into a timeout
                return future.result()
        if _workers(client):
            seen = monotonic()
        elif monotonic() - seen > without_workers_s:
            raise CancelledError
