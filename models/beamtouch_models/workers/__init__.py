"""The workers of a sweep: this process, processes on this machine, or a Dask cluster."""

import os
from contextlib import AbstractContextManager, nullcontext

from beamtouch_models.sweeps import Spread, in_turn
from beamtouch_models.workers.processes import processes

__all__ = ["spread_over"]


def spread_over(workers: int | None, cluster: str | None) -> AbstractContextManager[Spread]:
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
        from beamtouch_models.workers.cluster import cluster_at  # noqa: PLC0415  # needs an extra of its own

        return cluster_at(cluster)
    number = workers or len(os.sched_getaffinity(0))
    return nullcontext(in_turn) if number == 1 else processes(number)
