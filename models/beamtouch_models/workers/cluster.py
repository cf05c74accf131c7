"""Workers of a Dask cluster."""

import logging
import platform
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from functools import partial
from importlib import metadata
from time import monotonic
from typing import TypeVar

from beamtouch_common.errors import FailedError, InputError
from beamtouch_models.sweeps import Spread
from beamtouch_models.workers.processes import submit

try:
    from distributed import Client, KilledWorker
    from distributed.versions import VersionMismatchWarning
except ModuleNotFoundError as error:
    message = f"--cluster needs {error.name}; run: pip install 'beamtouch[design,cluster]'"
    raise InputError(message) from None

Found = TypeVar("Found")

REACHED_S = 10.0
"""Longest time to reach the scheduler."""
WITHOUT_WORKERS_S = 60.0
"""Longest time without workers before the sweep fails; Dask replaces a worker that died within seconds."""
LOOKED_S = 1.0
"""Time between two looks at whether there are workers."""

_SAME = ("beamtouch", "numpy", "scipy", "onnxruntime", "distributed")
"""Packages whose version decides the bytes of a result, or whether a task arrives at all."""


@contextmanager
def cluster_at(address: str, without_workers_s: float = WITHOUT_WORKERS_S) -> Iterator[Spread]:
    """Spread tasks over the workers of a Dask scheduler, as long as there are some.

    Raises
    ------
    InputError
        The scheduler cannot be reached, or its workers have another Python or other versions of what computes.
    FailedError
        The cluster ended before the work was done.
    """
    logging.disable(logging.CRITICAL)  # `distributed` also logs, at length, the errors that it raises
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # `_check` says it in one line
            client = Client(address, timeout=REACHED_S, set_as_default=False)
    except (OSError, ValueError, RuntimeError):
        message = f"--cluster {address}: no Dask scheduler answers there; start `dask scheduler` or check the address"
        raise InputError(message) from None
    try:
        _check(client, address)
        # Not pure: Dask would have to hash all data to find out whether it has done the same task before.
        yield partial(submit, client.get_executor(pure=False), partial(_result, client, without_workers_s))
    except (KilledWorker, CancelledError):
        message = f"--cluster {address}: its scheduler or its workers ended before the work was done"
        raise FailedError(message) from None
    finally:
        client.close(timeout=REACHED_S)


def _check(client: Client, address: str) -> None:
    """Raise InputError unless there are workers, and each has the Python and the packages of this process."""
    if not _workers(client):
        message = f"--cluster {address}: it has no workers; run `dask worker {address} --nthreads 1` on each machine"
        raise InputError(message)
    asked: dict[str, Callable[[], str]] = {one: partial(metadata.version, one) for one in _SAME}
    for name, ask in {"Python": platform.python_version, **asked}.items():
        ours = ask()
        for worker, theirs in client.run(ask, on_error="return").items():
            if not isinstance(theirs, str) or _relevant(name, theirs) != _relevant(name, ours):
                has = f"{name} {theirs}" if isinstance(theirs, str) else f"no {name}"
                remedy = f"install 'beamtouch[design,cluster]' there, with {name} {ours}"
                message = f"--cluster {address}: its worker {worker} has {has}; {remedy}"
                raise InputError(message)


def _relevant(name: str, version: str) -> str:
    """Return what must be the same of a version: a Python that differs only in its last number computes the same."""
    return version.rpartition(".")[0] if name == "Python" else version


def _workers(client: Client) -> int:
    return len(client.scheduler_info(n_workers=-1)["workers"])


def _result(client: Client, without_workers_s: float, future: Future[Found]) -> Found:
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
