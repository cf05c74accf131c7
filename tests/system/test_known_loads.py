"""A person's mistakes at the beam, on a rig: what `tare` and `record` make of them."""

import json
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import tomli_w

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from example_scenes import SCENES

pytestmark = pytest.mark.long

PROGRAMS = Path(sys.executable).parent
SCENE = SCENES / "bench.toml"


@contextmanager
def rig(folder: Path, model: Path, script: str = "") -> Iterator[tuple[Path, Callable[[str], None]]]:
    """A rig with a script, or by hand; gives the config of a daemon that reads it, and the hand."""
    (folder / "script.toml").write_text(script)
    command: list[str | Path] = [PROGRAMS / "beamtouch-rig", SCENE, "--model", model, "--modbus-tcp", "127.0.0.1:0"]
    command += ["--script", folder / "script.toml"] if script else ["--by-hand", "--no-ringing"]
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)

    def hand(load: str) -> None:
        """Put a load on in place of the last one, or nothing; it is so when this returns."""
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(f"{load}\n")
        process.stdin.flush()
        assert process.stdout.readline().endswith(" on\n")

    try:
        assert process.stdout is not None
        config = tomllib.loads(daemon_config(modelfile.load(model).metadata))
        (surface,) = config["surfaces"].values()
        surface["source"]["port"] = int(process.stdout.readline().rpartition(":")[2])
        surface["source"]["timeout_ms"] = 5000.0
        surface["rate_hz"] = 50.0
        path = folder / "daemon.toml"
        path.write_text(tomli_w.dumps(config))
        yield path, hand
    finally:
        process.terminate()
        process.communicate(timeout=60)


def daemon(*arguments: str | Path, typed: str = "") -> subprocess.CompletedProcess[str]:
    command: list[str | Path] = [PROGRAMS / "beamtouch-daemon", *arguments]
    return subprocess.run(command, input=typed, capture_output=True, text=True, timeout=120, check=False)


REST = "[[step]]\nseconds = 10\n"
LOADED = "[[step]]\nseconds = 10\nposition_mm = 200\nforce_n = 10\n"
MOVING = "[[step]]\nseconds = 40\nposition_mm = [66, 334]\nforce_n = 10\n"
"""6.7 mm/s."""


@pytest.mark.parametrize("is_tared", [False, True], ids=["the configuration", "the last tare"])
def test_a_beam_under_load_is_not_tared(bench_model: Path, tmp_path: Path, is_tared: bool) -> None:
    tare = tmp_path / "bench.tare.json"
    with rig(tmp_path, bench_model) as (config, hand):
        if is_tared:
            assert daemon("tare", config).returncode == 0
        before = tare.read_bytes() if is_tared else None
        hand("200 10")
        done = daemon("tare", config)
    assert done.returncode == 1
    assert "take everything off the beam and tare again, or add --accept-change" in done.stderr
    assert ("from the last tare" if is_tared else "from its rest_gap_mm") in done.stderr
    assert (tare.read_bytes() if tare.exists() else None) == before


@pytest.mark.parametrize("place_mm", [40, 200])
def test_little_more_than_the_smallest_force_is_not_tared(bench_model: Path, tmp_path: Path, place_mm: int) -> None:
    light = f"{place_mm} 2.5"
    with rig(tmp_path, bench_model) as (config, hand):
        for load, code, what in ((light, 1, "from its rest_gap_mm"), ("", 0, ""), (light, 1, "from the last tare")):
            hand(load)
            done = daemon("tare", config)
            assert (done.returncode, what in done.stderr) == (code, True)


def test_a_tare_at_rest_agrees_with_the_configuration_and_with_the_next(bench_model: Path, tmp_path: Path) -> None:
    with rig(tmp_path, bench_model) as (config, _):
        assert [daemon("tare", config).returncode for _ in range(2)] == [0, 0]
    gaps = json.loads((tmp_path / "bench.tare.json").read_text())["rest_gap_mm"].values()
    standoff_mm = modelfile.load(bench_model).metadata.sensor.standoff_mm
    assert list(gaps) == pytest.approx([standoff_mm] * len(gaps), abs=0.005)


@pytest.mark.parametrize(
    ("script", "typed", "code", "said"),
    [
        (REST, "9999 10\n", 1, "9999 mm is not within"),
        (LOADED, "200 10000\n", 1, "10000 N is more than"),
        (REST, "200 10\n", 1, "no load is seen"),
        (MOVING, "200 10\n", 1, "moved"),
    ],
    ids=["off the beam", "10 000 N", "nothing on it", "6.7 mm/s"],
)
def test_a_load_that_cannot_be_is_not_recorded(
    bench_model: Path, tmp_path: Path, script: str, typed: str, code: int, said: str
) -> None:
    with rig(tmp_path, bench_model, script) as (config, _):
        done = daemon("record", config, "-o", tmp_path / "loads.csv", typed=typed)
    assert done.returncode == code
    assert said in done.stderr
    assert len((tmp_path / "loads.csv").read_text().splitlines()) == 1  # the names of the columns
