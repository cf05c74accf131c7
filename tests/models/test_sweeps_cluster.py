"""Sweeps over a Dask cluster: a scheduler and workers on loopback."""

import signal
import subprocess
from pathlib import Path

import pytest

from sweeping import COMMAND, WITHIN_S, dask, swept
from waiting import wait_until


def refused(*arguments: object) -> str:
    """Run `design-sensors` on wrong input; returns its one line."""
    command = [COMMAND, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WITHIN_S)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    return done.stderr


@pytest.mark.long
def test_a_cluster_of_two_processes_gives_the_same_bytes(bench_model: Path, tmp_path: Path) -> None:
    with dask(tmp_path, workers=2) as (address, _):
        for arguments in (("evaluate", "--draws", 4000), ("challenge", "--draws", 10)):
            here, there = (
                swept(*arguments, bench_model, "--json", *where) for where in (("--workers", 1), ("--cluster", address))
            )
            assert here == there


@pytest.mark.long
def test_a_cluster_that_cannot_work_is_refused_in_one_line(bench_model: Path, tmp_path: Path) -> None:
    with dask(tmp_path, workers=0) as (address, (scheduler,)):
        assert "it has no workers; run `dask worker tcp://" in refused("evaluate", bench_model, "--cluster", address)
        scheduler.send_signal(signal.SIGKILL)
        scheduler.wait()
        assert "no Dask scheduler answers there" in refused("evaluate", bench_model, "--cluster", address)


@pytest.mark.long
@pytest.mark.parametrize("lost", ["worker", "scheduler"])
def test_a_cluster_that_loses_a_process(bench_model: Path, tmp_path: Path, lost: str) -> None:
    with dask(tmp_path, workers=2) as (address, (scheduler, worker, _)):
        command = [COMMAND, "challenge", str(bench_model), "--draws", "40", "--json", "--cluster", address]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
            try:
                maps = Path(f"/proc/{worker.pid}/maps")
                wait_until(lambda: "onnxruntime" in maps.read_text(), WITHIN_S)
                (worker if lost == "worker" else scheduler).kill()
                out, err = process.communicate(timeout=WITHIN_S)
            finally:
                process.kill()
    if lost == "worker":  # the other one does its work
        assert (process.returncode, err) == (0, "")
        assert out.startswith('{"model": ')
    else:
        said = f"--cluster {address}: its scheduler or its workers ended before the work was done\n"
        assert (process.returncode, out, err) == (1, "", f"design-sensors: {said}")
