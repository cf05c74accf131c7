"""A Dask cluster that ends before the work is done."""

import logging
import subprocess
from pathlib import Path

import pytest

from beamtouch_common.errors import FailedError
from beamtouch_models.commands.workers import cluster_at
from models.sweeping import dask


def work_without_workers(address: str, worker: subprocess.Popen[bytes]) -> None:
    with cluster_at(address, without_workers_s=0.0) as spread:
        worker.kill()
        worker.wait()
        list(spread(abs, [-1]))


@pytest.mark.soak
def test_a_cluster_that_has_no_workers_for_too_long_ends_the_work(tmp_path: Path) -> None:
    try:
        with dask(tmp_path, workers=1) as (address, _, (_, worker)):
            with cluster_at(address) as spread:
                assert list(spread(abs, [-1, 2, -3])) == [1, 2, 3]
            said = f"--cluster {address}: its scheduler or its workers ended before the work was done"
            with pytest.raises(FailedError, match=said):
                work_without_workers(address, worker)
    finally:
        logging.disable(logging.NOTSET)
