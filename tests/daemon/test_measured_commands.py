"""`record`, `noise` and `scan` from what comes to what they print, in the process of the test."""

import json
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_daemon.cli import main
from beamtouch_daemon.commands import noise, record
from beamtouch_daemon.config.tare_file import NOT_TARED
from support.programs.in_process import Outcome, command_of
from support.surfaces import configs

from .acquiring import Beam, Gone

Run = Callable[..., Outcome]
NOISE = np.rint(30 * np.random.default_rng(4).standard_normal((500, 2))).tolist()
"""Of 0.003 mm, as a count is 0.0001 mm."""


def noisy(deflection_mm: float = 0.0) -> Beam:
    """Return a beam with noise, of which the first sensor deflects by so much."""
    return Beam(lambda at: (20_000 + 10_000 * deflection_mm + NOISE[at % 500][0], 20_000 + NOISE[at % 500][1]))


@pytest.fixture
def run_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """A function that runs a command on a beam of the surface `bench`, with options; Enter is pressed once."""
    run = command_of(main, capsys)
    config = configs.write(tmp_path, configs.surface())

    def run_it(command: str, beam: Beam, *options: object, answers: tuple[str, ...] = ("\n",)) -> Outcome:
        left = list(answers)
        for module in (record, noise):
            monkeypatch.setattr(module, "source_of", lambda *_: beam)
        monkeypatch.setattr(record, "typed_line", lambda: left.pop(0) if left else "")
        return run(command, config, *options)

    return run_it


def test_a_load_is_recorded_and_the_next_command_is_told(run_on: Run, tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    beam = noisy(0.1)
    outcome = run_on("record", beam, "-o", path, "--at", 150, 10, "--seconds", 0.25)
    assert outcome.returncode == 0, outcome.stderr
    calibrate = f"design-sensors calibrate MODEL {path} -o MODEL"
    build = f"design-sensors build --loads {path} -o bench.onnx"
    assert outcome.stdout == f"1 loads in {path}; next: {calibrate}, or without a model {build}\n"
    assert outcome.stderr.splitlines() == [
        "without [surfaces.bench.loads], positions and forces are not checked",
        f"bench: {NOT_TARED}",
        "load 1: put 10 N at 150 mm on, then press Enter (undo): ",
        "load 1: 10 N at 150 mm, 50 samples",
    ]
    assert beam.given == 100 + 50  # half a second at rest before
    assert len(path.read_text().splitlines()) == 1 + 50


def test_what_was_not_recorded_is_told(run_on: Run, tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    options = ("-o", path, "--at", 150, 10, "--seconds", 0.25)
    unseen = run_on("record", noisy(0.001), *options)
    assert unseen.returncode == 1
    assert "10 N at 150 mm not recorded: no load is seen: the largest deflection is 0.00" in unseen.stderr
    assert unseen.stderr.endswith("beamtouch-daemon: bench: not recorded: 10 N at 150 mm; put them on again\n")
    ended = run_on("record", noisy(0.1), *options, answers=())
    said = f"beamtouch-daemon: bench: no load is recorded, so {path} is not written\n"
    assert (ended.returncode, ended.stderr.endswith(said)) == (1, True)
    gone = run_on("record", Gone(), *options)
    assert gone.stderr.endswith("beamtouch-daemon: bench: it is gone; no load is recorded\n")
    assert not path.exists()


@pytest.mark.parametrize("seconds", ["0", "-1", "3600.5", "nan"])
def test_a_time_to_record_that_cannot_be_is_refused(run_on: Run, tmp_path: Path, seconds: str) -> None:
    outcome = run_on("record", noisy(), "-o", tmp_path / "x.csv", "--seconds", seconds)
    said = "beamtouch-daemon: --seconds: give more than 0 and at most 3600\n"
    assert (outcome.returncode, outcome.stderr) == (2, said)


def test_the_noise_of_a_beam_at_rest_is_measured(run_on: Run) -> None:
    beam = noisy()
    outcome = run_on("noise", beam, "--seconds", 2.5)
    assert (outcome.returncode, beam.given) == (0, 500)
    assert outcome.stderr == "bench: recording 2.5 s at rest; keep everything off the beam\n"
    assert "bench: 500 readings in 2.5 s; effective noise for the mean of 1 readings" in outcome.stdout
    found = json.loads(run_on("noise", noisy(), "--seconds", 2.5, "--json").stdout)["surfaces"]["bench"]
    assert found["daemon"]["noise_mm"] == pytest.approx(0.003, rel=0.15)
    assert f"noise_mm = {found['daemon']['noise_mm']!r}" in outcome.stdout


def test_a_surface_that_was_not_measured_is_told(run_on: Run) -> None:
    outcome = run_on("noise", Gone(), "--json")
    assert json.loads(outcome.stdout) == {"surfaces": {"bench": {"error": "it is gone"}}}
    assert outcome.returncode == 1
    assert outcome.stderr.splitlines() == [
        "bench: recording 60 s at rest; keep everything off the beam",
        "beamtouch-daemon: bench: not measured: it is gone",
    ]
    assert run_on("noise", Gone()).stdout == ""


def test_of_several_surfaces_one_is_recorded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = configs.write(tmp_path, configs.surface("bench"), configs.surface("press"))
    outcome = command_of(main, capsys)("record", config, "-o", tmp_path / "x.csv")
    said = "beamtouch-daemon: --surface: choose one of bench, press\n"
    assert (outcome.returncode, outcome.stderr) == (2, said)


def test_a_scan_that_finds_nothing_fails_with_what_to_check(capsys: pytest.CaptureFixture[str]) -> None:
    run = command_of(main, capsys)
    closed = run("scan", "/dev/null")
    said = "beamtouch-daemon: /dev/null cannot be opened (Inappropriate ioctl for device); correct the path\n"
    assert (closed.returncode, closed.stdout, closed.stderr) == (1, "", said)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        target = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        options = ("scan", target, "--units", "1", "--timeout-ms", "10")
        plain, as_json = run(*options), run(*options, "--json")
    assert (plain.returncode, plain.stdout) == (1, "")
    assert plain.stderr.splitlines()[-1].startswith(
        f"beamtouch-daemon: nothing answers: {target} accepts connections; "
    )
    assert (as_json.returncode, json.loads(as_json.stdout)) == (1, {"target": target, "units": [], "board": None})
