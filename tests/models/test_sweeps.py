"""Sweeps over worker processes: the same results, and an end without remains."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from example_scenes import PAPER
from in_process import Command
from sweeping import COMMAND, QUICKLY_TIMED, WITHIN_S, at_work, group, sweeping, swept
from waiting import wait_until

LONG = ("--draws", 2000)
"""Enough work for workers to be interrupted."""
MEASURED = ("times", "latency_ms", "on_front", "sentences")
"""Fields of a trade that are measured times, or follow from them."""


def untimed(found: Any) -> Any:  # noqa: ANN401  # JSON
    if isinstance(found, dict):
        return {key: untimed(value) for key, value in found.items() if key not in MEASURED}
    return [untimed(one) for one in found] if isinstance(found, list) else found


def scenes_in(folder: Path) -> Path:
    """Make a folder with two small scenes, one of whose layouts cannot be placed."""
    folder.mkdir()
    # Few places for sensors, and few readings in a mean.
    text = PAPER.replace("[sensors]", "[sensors]\nrate_hz = 50") + "\n[requirements]\nlatency_ms = 40\n"
    (folder / "plain.toml").write_text(text.replace("count = 2", "count = [2, 2]\ngrid_mm = 57"))
    narrow = "count = [3, 4]\nmin_distance_mm = 150\ngrid_mm = 25"  # three sensors go on 400 mm, four do not
    (folder / "narrow.toml").write_text(text.replace("count = 2", narrow))
    return folder


def test_evaluate_and_challenge_print_the_same_bytes_at_any_number_of_workers(
    design_sensors_here: Command, quick_model: Path
) -> None:
    for arguments in (("evaluate", "--draws", 400, "--noise", 0.01, "--noise", 0.02), ("challenge", "--draws", 10)):
        alone = design_sensors_here(*arguments, quick_model, "--json")
        assert alone.stdout == swept(*arguments, quick_model, "--json", "--workers", 2)
        assert len(alone.stdout) > 500


@pytest.mark.long
@pytest.mark.usefixtures("short_timing")
def test_a_folder_of_scenes_is_traded_into_a_folder_each(design_sensors_here: Command, tmp_path: Path) -> None:
    scenes, folder, alone = scenes_in(tmp_path / "scenes"), tmp_path / "folder", tmp_path / "alone"
    options = ("--draws", "100", "--estimators", "posterior", "--json")
    command = [*QUICKLY_TIMED, "trade", str(scenes), *options, "-o", str(folder), "--workers", "2"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WITHIN_S)
    assert done.returncode == 0, done.stderr
    assert "min_distance_mm" in done.stderr
    objects = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one.pop("output") for one in objects] == [str(folder / name) for name in ("narrow", "plain")]
    assert [one["scene"] for one in objects] == [str(scenes / f"{name}.toml") for name in ("narrow", "plain")]
    assert all(one["points"] for one in objects)
    for name in ("narrow", "plain"):
        assert json.loads((folder / name / "trade.json").read_text())["points"]

    # In this process; times are no part of what is compared.
    told = design_sensors_here("trade", scenes / "plain.toml", *options, "-o", alone, "--workers", 1)
    assert told.returncode == 0, told.stderr
    one = json.loads(told.stdout)
    assert one.pop("output") == str(alone)
    assert untimed([one]) == untimed(objects[1:])


def interrupt_the_group(process: subprocess.Popen[str]) -> None:
    os.killpg(process.pid, signal.SIGINT)


def kill_a_worker(process: subprocess.Popen[str]) -> None:
    os.kill(at_work(process.pid)[0], signal.SIGKILL)


@pytest.mark.parametrize(
    ("harm", "code", "said"),
    [
        (interrupt_the_group, 130, "design-sensors: interrupted\n"),
        (kill_a_worker, 1, "design-sensors: a worker process ended before its work was done; if memory was short, use "
            "fewer --workers\n"),
    ],
)  # fmt: skip
def test_what_ends_a_sweep_ends_its_workers(
    bench_model: Path, harm: Callable[[subprocess.Popen[str]], None], code: int, said: str
) -> None:
    with sweeping("challenge", bench_model, *LONG, "--workers", 2) as process:
        wait_until(lambda: len(at_work(process.pid)) == 2, WITHIN_S)
        harm(process)
        out, err = process.communicate(timeout=WITHIN_S)
        assert (process.returncode, out, err) == (code, "", said)
        wait_until(lambda: not group(process.pid), WITHIN_S)


def test_workers_end_when_their_command_is_killed(bench_model: Path) -> None:
    with sweeping("challenge", bench_model, *LONG, "--workers", 2) as process:
        wait_until(lambda: len(at_work(process.pid)) == 2, WITHIN_S)
        process.kill()
        wait_until(lambda: not group(process.pid), WITHIN_S)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--workers", "0"), "'0' is not a whole number from 1 to 1024"),
        (("--workers", "2", "--cluster", "tcp://127.0.0.1:1"), "not allowed with argument --workers"),
        (("--cluster", "127.0.0.1:8786"), "'127.0.0.1:8786' is not tcp://HOST:PORT"),
        (("--cluster", "tcp://127.0.0.1:high"), "is not tcp://HOST:PORT"),
    ],
)
@pytest.mark.parametrize("command", ["trade", "evaluate", "challenge"])
def test_wrong_workers_are_refused_in_one_line(command: str, options: tuple[str, ...], said: str) -> None:
    done = subprocess.run([COMMAND, command, "FILE", *options], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr


def test_a_cluster_without_its_extra_names_the_extra(bench_model: Path) -> None:
    # As if it were not installed: an entry of None is not found.
    program = "import sys; sys.modules['distributed'] = None; from beamtouch_models.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "evaluate", str(bench_model), "--cluster", "tcp://127.0.0.1:1"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=WITHIN_S)
    expected = "design-sensors: --cluster needs distributed; run: pip install 'beamtouch[design,cluster]'\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", expected)


def test_a_folder_without_scenes_and_a_wrong_scene_are_refused_before_any_work(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    done = design_sensors_here("trade", empty, "-o", tmp_path / "out")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "no scenes (*.toml)" in done.stderr
    scenes = scenes_in(tmp_path / "scenes")
    (scenes / "wrong.toml").write_text(PAPER.replace("count = 2", "count = 0"))
    done = design_sensors_here("trade", scenes, "-o", tmp_path / "out")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "wrong.toml" in done.stderr
    assert not (tmp_path / "out").exists()
