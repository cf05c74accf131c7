"""The beginning of a worker process. Imports nothing that computes, because that reads what is set here when loaded."""

import os
from multiprocessing import connection, parent_process
from threading import Thread


def begin() -> None:
    """Keep linear algebra on one thread, as each core has a worker, and end with the process that started this one."""
    os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End when the parent is gone, however it ended: without it, a worker would wait for tasks forever."""
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
