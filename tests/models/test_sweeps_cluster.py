"""Sweeps over a Dask cluster: a scheduler and workers on loopback."""

import logging
import os
import signal
import subprocess
from importlib import metadata
from pathlib import Path

import pytest

from beamtouch_common.errors import FailedError
from beamtouch_models.workers.cluster import cluster_at
from in_process import Command
from sweeping import COMMAND, WITHIN_S, dask, sweeping, swept
from waiting import wait_until


def refused(*arguments: object) -> str:
    """Run `design-sensors` on wrong input; returns its one line."""
    command = [COMMAND, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WITHIN_S)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    return done.stderr


@pytest.mark.long
def test_a_cluster_of_two_processes_gives_the_same_bytes(
    design_sensors_here: Command, quick_model: Path, tmp_path: Path
) -> None:
    with dask(tmp_path, workers=2) as (address, _):
        for arguments in (("evaluate", "--draws", 400), ("challenge", "--draws", 10)):
            here = design_sensors_here(*arguments, quick_model, "--json").stdout
            assert here == swept(*arguments, quick_model, "--json", "--cluster", address)
            assert len(here) > 500


@pytest.mark.long
def test_a_cluster_that_cannot_work_is_refused_in_one_line(bench_model: Path, tmp_path: Path) -> None:
    with dask(tmp_path, workers=0) as (address, (scheduler,)):
        assert "it has no workers; run `dask worker tcp://" in refused("evaluate", bench_model, "--cluster", address)
        scheduler.send_signal(signal.SIGKILL)
        scheduler.wait()
        assert "no Dask scheduler answers there" in refused("evaluate", bench_model, "--cluster", address)


OTHER_PYTHON = "import platform\nplatform.python_version = lambda: '3.7.1'\n"


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["beamtouch", *(pytest.param(one, marks=pytest.mark.soak) for one in ("Python", "numpy"))]
)
def test_a_cluster_with_another_version_is_refused_in_one_line(bench_model: Path, tmp_path: Path, name: str) -> None:
    first = tmp_path / "first"
    if name == "Python":
        first.mkdir()
        (first / "sitecustomize.py").write_text(OTHER_PYTHON)
        has, ours = "Python 3.7.1", "Python 3."
    else:
        (first / f"{name}-0.0.7.dist-info").mkdir(parents=True)
        (first / f"{name}-0.0.7.dist-info" / "METADATA").write_text(f"Name: {name}\nVersion: 0.0.7\n")
        has, ours = f"{name} 0.0.7", f"{name} {metadata.version(name)}"
    with dask(tmp_path, workers=1, first=first) as (address, _):
        said = refused("evaluate", bench_model, "--cluster", address)
    assert f" has {has}; install 'beamtouch[design,cluster]' there, with {ours}" in said


def work_without_workers(address: str, worker: subprocess.Popen[bytes]) -> None:
    with cluster_at(address, without_workers_s=0.0) as spread:
        worker.kill()
        worker.wait()
        list(spread(abs, [-1]))


@pytest.mark.soak
def test_a_cluster_that_has_no_workers_for_too_long_ends_the_work(tmp_path: Path) -> None:
    try:
        with dask(tmp_path, workers=1) as (address, (_, worker)):
            with cluster_at(address) as spread:
                assert list(spread(abs, [-1, 2, -3])) == [1, 2, 3]
            said = f"--cluster {address}: its scheduler or its workers ended before the work was done"
            with pytest.raises(FailedError, match=said):
                work_without_workers(address, worker)
    finally:
        logging.disable(logging.NOTSET)


@pytest.mark.long
def test_ctrl_c_ends_the_work_on_a_cluster(bench_model: Path, tmp_path: Path) -> None:
    with dask(tmp_path, workers=1) as (address, (_, worker)):
        with sweeping("challenge", bench_model, "--draws", 2000, "--cluster", address) as process:
            maps = Path(f"/proc/{worker.pid}/maps")
            wait_until(lambda: "onnxruntime" in maps.read_text(), WITHIN_S)
            os.killpg(process.pid, signal.SIGINT)
            out, err = process.communicate(timeout=WITHIN_S)
        assert (process.returncode, out, err) == (130, "", "design-sensors: interrupted\n")


@pytest.mark.soak
@pytest.mark.parametrize("lost", ["worker", "scheduler"])
def test_a_cluster_that_loses_a_process(quick_model: Path, tmp_path: Path, lost: str) -> None:
    with dask(tmp_path, workers=2) as (address, (scheduler, worker, _)):
        command = [COMMAND, "challenge", str(quick_model), "--draws", "40", "--json", "--cluster", address]
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
