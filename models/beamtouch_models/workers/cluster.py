"""Workers of a Dask cluster."""

import logging
from collections.abc import Iterator
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager
from functools import partial
from time import monotonic
from typing import TypeVar

from beamtouch_common.commands import version
from beamtouch_common.errors import FailedError, InputError
from beamtouch_models.sweeps import Spread
from beamtouch_models.workers.submitted import submitted

try:
    from distributed import Client, KilledWorker
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


@contextmanager
def cluster_at(address: str) -> Iterator[Spread]:
    """Spread tasks over the workers of a Dask scheduler.

    Raises
    ------
    InputError
        The scheduler cannot be reached, or its workers lack this version of Beamtouch.
    FailedError
        The cluster ended before the work was done.
    """
    logging.disable(logging.CRITICAL)  # `distributed` also logs, at length, the errors that it raises
    try:
        client = Client(address, timeout=REACHED_S, set_as_default=False)
    except (OSError, ValueError, RuntimeError):
        message = f"--cluster {address}: no Dask scheduler answers there; start `dask scheduler` or check the address"
        raise InputError(message) from None
    try:
        _check(client, address)
        # Not pure: Dask would have to hash all data to find out whether it has done the same task before.
        yield partial(submitted, client.get_executor(pure=False), partial(_result, client))
    except (KilledWorker, CancelledError):
        message = f"--cluster {address}: its scheduler or its workers ended before the work was done"
        raise FailedError(message) from None
    finally:
        client.close(timeout=REACHED_S)


def _check(client: Client, address: str) -> None:
    """Raise InputError unless there are workers, and each has this version."""
    if not _workers(client):
        message = f"--cluster {address}: it has no workers; run `dask worker {address} --nthreads 1` on each machine"
        raise InputError(message)
    ours = version()
    for worker, theirs in client.run(version, on_error="return").items():
        if theirs != ours:
            has = f"beamtouch {theirs}" if isinstance(theirs, str) else "no beamtouch"
            message = f"--cluster {address}: its worker {worker} has {has}; install 'beamtouch[design,cluster]' {ours}"
            raise InputError(message)


def _workers(client: Client) -> int:
    return len(client.scheduler_info(n_workers=-1)["workers"])


def _result(client: Client, future: Future[Found]) -> Found:
    """Wait for a result as long as there are workers."""
    seen = monotonic()
    while True:
        try:
            return future.result(timeout=LOOKED_S)
        except TimeoutError:
            if future.done():  # at this very moment, or the task itself ran into a timeout
                return future.result()
        if _workers(client):
            seen = monotonic()
        elif monotonic() - seen > WITHOUT_WORKERS_S:
            raise CancelledError
