"""Sweeps over worker processes and over a Dask cluster: the same results, and an end without remains."""

import json
import logging
import os
import platform
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from beamtouch_models import cli
from models.sweeping import COMMAND, QUICKLY_TIMED, WITHIN_S, at_work, dask, group, sweeping
from support.programs.in_process import Command, command_of
from support.running.waiting import wait_until
from support.surfaces.example_scenes import PAPER

LONG = ("--draws", 2000)
"""Enough work for workers to be interrupted."""
MEASURED = ("inference_us", "latency_ms", "on_front", "sentences")
"""Fields of a trade that are measured times, or follow from them."""


@pytest.fixture
def spread_here(capsys: pytest.CaptureFixture[str]) -> Iterator[Command]:
    """`design-sensors` in this process, with the workers that its arguments name."""
    yield command_of(cli.main, capsys)
    logging.disable(logging.NOTSET)


def untimed(found: Any) -> Any:  # noqa: ANN401  # JSON
    if isinstance(found, dict):
        return {key: untimed(value) for key, value in found.items() if key not in MEASURED}
    return [untimed(one) for one in found] if isinstance(found, list) else found


@pytest.mark.promise("docs/how-to/sweeps.md", "the results are the same for each N, to the byte, except measured times")
def test_an_evaluation_prints_the_same_bytes_at_any_number_of_workers(
    design_sensors_here: Command, spread_here: Command, quick_model: Path
) -> None:
    arguments = ("evaluate", "--draws", 400, "--noise", 0.01, "--noise", 0.02, quick_model, "--json")
    alone = design_sensors_here(*arguments).stdout
    assert len(alone) > 500
    assert alone == spread_here(*arguments, "--workers", 2).stdout


@pytest.mark.soak
def test_two_workers_trade_as_one_alone(design_sensors_here: Command, tmp_path: Path) -> None:
    scene, folder, alone = tmp_path / "plain.toml", tmp_path / "folder", tmp_path / "alone"
    # Few places for sensors, and few readings in a mean.
    text = PAPER.replace("[sensors]", "[sensors]\nrate_hz = 50").replace("count = 2", "count = [2, 2]\ngrid_mm = 57")
    scene.write_text(text + "\n[requirements]\nlatency_ms = 40\n")
    asked = ("trade", str(scene), "--draws", "100", "--estimators", "posterior", "--json")
    command = [*QUICKLY_TIMED, *asked, "-o", str(folder), "--workers", "2"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WITHIN_S)
    assert done.returncode == 0, done.stderr
    told = design_sensors_here(*asked, "-o", alone)
    assert told.returncode == 0, told.stderr
    one, other = json.loads(told.stdout), json.loads(done.stdout)
    assert (one.pop("output"), other.pop("output")) == (str(alone), str(folder))
    assert one["points"]
    assert untimed(one) == untimed(other)


def interrupt_the_group(process: subprocess.Popen[str]) -> None:
    os.killpg(process.pid, signal.SIGINT)


def kill_a_worker(process: subprocess.Popen[str]) -> None:
    os.kill(at_work(process.pid)[0], signal.SIGKILL)


@pytest.mark.soak
@pytest.mark.parametrize(
    ("harm", "code", "said"),
    [
        (interrupt_the_group, 130, "design-sensors: interrupted\n"),
        (kill_a_worker, 1, "design-sensors: a worker process ended before its work was done; if memory was short, use "
            "fewer --workers\n"),
        (subprocess.Popen.kill, -signal.SIGKILL, ""),
    ],
)  # fmt: skip
def test_what_ends_a_sweep_ends_its_workers(
    quick_model: Path, harm: Callable[[subprocess.Popen[str]], None], code: int, said: str
) -> None:
    with sweeping("challenge", quick_model, *LONG, "--workers", 2) as process:
        wait_until(lambda: len(at_work(process.pid)) == 2, WITHIN_S)
        harm(process)
        out, err = process.communicate(timeout=WITHIN_S)
        assert (process.returncode, out) == (code, "")
        # Of what a killed parent leaves, the interpreter itself may complain.
        assert err == said or harm is subprocess.Popen.kill
        wait_until(lambda: not group(process.pid), WITHIN_S)


def test_a_cluster_without_its_extra_names_the_extra(
    spread_here: Command, quick_model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # as if it were not installed
    done = spread_here("evaluate", quick_model, "--cluster", "tcp://127.0.0.1:1")
    expected = "design-sensors: --cluster needs distributed; run: pip install 'beamtouch[design,cluster]'\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", expected)


@pytest.mark.parametrize("address", ["tls://127.0.0.1:8786", "tcp://a..b:8786"])
def test_a_cluster_that_cannot_be_is_refused_in_one_line(spread_here: Command, quick_model: Path, address: str) -> None:
    """One for which Dask has no certificates, and one whose name is none."""
    done = spread_here("evaluate", quick_model, "--cluster", address)
    said = f"--cluster {address}: no Dask scheduler answers there; start `dask scheduler` or check the address"
    assert (done.returncode, done.stderr) == (2, f"design-sensors: {said}\n")


def stating(folder: Path, name: str, version: str) -> Path:
    """A folder that makes the Python that finds it first state another version, of itself or of a distribution."""
    if name == "Python":
        folder.mkdir()
        (folder / "sitecustomize.py").write_text(f"import platform\nplatform.python_version = lambda: '{version}'\n")
    else:
        metadata_of = folder / f"{name}-{version}.dist-info"
        metadata_of.mkdir(parents=True)
        (metadata_of / "METADATA").write_text(f"Name: {name}\nVersion: {version}\n")
    return folder


@pytest.mark.promise(
    "docs/how-to/sweeps.md",
    (
        "Workers with another Python, or another version of beamtouch, numpy, scipy, onnxruntime or distributed, are "
        "refused"
    ),
)
@pytest.mark.soak
def test_a_cluster_gives_the_same_bytes_and_is_refused_in_one_line_where_it_cannot_work(
    design_sensors_here: Command, spread_here: Command, quick_model: Path, tmp_path: Path
) -> None:
    """One scheduler: without a worker, with one of another version, with one that fits, and gone.

    A Python that differs only in its last number fits.
    """

    def refusal(address: str) -> str:
        done = spread_here("evaluate", quick_model, "--cluster", address)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
        return done.stderr

    python = platform.python_version()
    with dask(tmp_path, workers=0) as (address, start_worker, (scheduler,)):
        assert "it has no workers; run `dask worker tcp://" in refusal(address)

        for name, theirs, ours in (
            ("beamtouch", "0.0.7", metadata.version("beamtouch")),
            ("numpy", "1.0.0", metadata.version("numpy")),
            ("Python", "3.5.0", python),
        ):
            other = start_worker(stating(tmp_path / name, name, theirs))
            said = f" has {name} {theirs}; install 'beamtouch[design,cluster]' there, with {name} {ours}"
            assert said in refusal(address)
            other.kill()
            other.wait()

        start_worker(stating(tmp_path / "fits", "Python", f"{python.rpartition('.')[0]}.99"))
        arguments = ("challenge", "--draws", 10, quick_model, "--json")
        here = design_sensors_here(*arguments).stdout
        assert here == spread_here(*arguments, "--cluster", address).stdout
        assert len(here) > 500

        scheduler.kill()
        scheduler.wait()
        assert "no Dask scheduler answers there" in refusal(address)


@pytest.mark.soak
@pytest.mark.parametrize("lost", ["worker", "scheduler", "command"])
def test_a_cluster_that_loses_a_process(quick_model: Path, tmp_path: Path, lost: str) -> None:
    with dask(tmp_path, workers=2) as (address, _, (scheduler, worker, _)):
        command = [COMMAND, "challenge", str(quick_model), "--draws", "40", "--json", "--cluster", address]
        pipe = subprocess.PIPE
        with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
            try:
                maps = Path(f"/proc/{worker.pid}/maps")
                wait_until(lambda: "onnxruntime" in maps.read_text(), WITHIN_S)
                if lost == "command":
                    process.send_signal(signal.SIGINT)
                else:
                    (worker if lost == "worker" else scheduler).kill()
                out, err = process.communicate(timeout=WITHIN_S)
            finally:
                process.kill()
    if lost == "worker":  # the other one does its work
        assert (process.returncode, err) == (0, "")
        assert out.startswith('{"model": ')
    elif lost == "command":
        assert (process.returncode, out, err) == (130, "", "design-sensors: interrupted\n")
    else:
        said = f"--cluster {address}: its scheduler or its workers ended before the work was done\n"
        assert (process.returncode, out, err) == (1, "", f"design-sensors: {said}")
