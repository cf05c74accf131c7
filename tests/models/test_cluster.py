"""A Dask cluster that ends before the work is done."""

import logging
from collections.abc import Iterator
from pathlib import Path

import pytest

from beamtouch_common.errors import FailedError
from beamtouch_models.commands.workers import cluster_at
from models.sweeping import dask


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    """Undo what `cluster_at` does to the logs."""
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.soak
@pytest.mark.parametrize("lost", ["worker", "scheduler"])
def test_a_cluster_that_is_gone_for_too_long_ends_the_work(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], lost: str
) -> None:
    with dask(tmp_path, workers=1) as (address, _, (scheduler, worker)):
        process = worker if lost == "worker" else scheduler
        said = f"--cluster {address}: its scheduler or its workers ended before the work was done"

        def work() -> None:
            with cluster_at(address, without_workers_s=0.0) as spread:
                assert list(spread(abs, [1, -2, -3])) == [1, 2, 3]
                process.kill()
                process.wait()
                list(spread(abs, [-1]))

        capfd.readouterr()
        with pytest.raises(FailedError, match=said):
            work()
        assert "distributed.client" not in capfd.readouterr().err
