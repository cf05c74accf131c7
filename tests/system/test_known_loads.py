"""A person's mistakes at the beam, on a rig: what `tare` and `record` make of them."""

import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import tomli_w

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from example_scenes import SCENES

pytestmark = pytest.mark.long

PROGRAMS = Path(sys.executable).parent
SCENE = SCENES / "bench.toml"


@dataclass(frozen=True)
class Bench:
    """A rig, and the configuration of a daemon that reads it."""

    process: subprocess.Popen[str]
    config: Path
    tare: Path

    def hand(self, load: str) -> None:
        """Put a load on in place of the last one, or nothing; it is so when this returns."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{load}\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline().endswith(" on\n")


@contextmanager
def rig(folder: Path, model: Path, *options: str | Path) -> Iterator[Bench]:
    """Start a rig."""
    command: list[str | Path] = [PROGRAMS / "beamtouch-rig", SCENE, "--model", model, "--modbus-tcp", "127.0.0.1:0"]
    process = subprocess.Popen([*command, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        config = tomllib.loads(daemon_config(modelfile.load(model).metadata))
        (surface,) = config["surfaces"].values()
        surface["source"]["port"] = int(process.stdout.readline().rpartition(":")[2])
        surface["source"]["timeout_ms"] = 5000.0
        surface["rate_hz"] = 50.0
        path = folder / "daemon.toml"
        path.write_text(tomli_w.dumps(config))
        yield Bench(process, path, folder / "bench.tare.json")
    finally:
        process.terminate()
        process.communicate(timeout=60)


@pytest.fixture(scope="module")
def shared(bench_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """A rig by hand for all tests."""
    with rig(tmp_path_factory.mktemp("by-hand"), bench_model, "--by-hand", "--no-ringing") as bench:
        yield bench


@pytest.fixture
def by_hand(shared: Bench) -> Bench:
    """That rig, at rest, and a configuration without a tare."""
    shared.hand("")
    shared.tare.unlink(missing_ok=True)
    return shared


def daemon(*arguments: str | Path, typed: str = "") -> subprocess.CompletedProcess[str]:
    command: list[str | Path] = [PROGRAMS / "beamtouch-daemon", *arguments]
    return subprocess.run(command, input=typed, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize("load", ["200 10", "40 2.5"], ids=["a load", "little more than the smallest force"])
def test_a_beam_under_load_is_not_tared(by_hand: Bench, load: str) -> None:
    for what in ("from its rest_gap_mm", "from the last tare"):
        before = by_hand.tare.read_bytes() if by_hand.tare.exists() else None
        by_hand.hand(load)
        done = daemon("tare", by_hand.config)
        assert done.returncode == 1
        assert "take everything off the beam and tare again, or add --accept-change" in done.stderr
        assert what in done.stderr
        assert (by_hand.tare.read_bytes() if by_hand.tare.exists() else None) == before
        by_hand.hand("")
        assert daemon("tare", by_hand.config).returncode == 0


def test_a_tare_at_rest_states_the_gaps_of_the_configuration(bench_model: Path, by_hand: Bench) -> None:
    assert daemon("tare", by_hand.config).returncode == 0
    gaps = json.loads(by_hand.tare.read_text())["rest_gap_mm"].values()
    standoff_mm = modelfile.load(bench_model).metadata.sensor.standoff_mm
    assert list(gaps) == pytest.approx([standoff_mm] * len(gaps), abs=0.005)


def check_that_nothing_is_recorded(bench: Bench, path: Path, typed: str, said: str) -> None:
    done = daemon("record", bench.config, "-o", path, typed=typed)
    assert done.returncode == 1
    assert said in done.stderr
    assert len(path.read_text().splitlines()) == 1  # the names of the columns


@pytest.mark.parametrize(
    ("load", "typed", "said"),
    [
        ("", "9999 10\n", "9999 mm is not within"),
        ("200 10", "200 10000\n", "10000 N is more than"),
        ("", "200 10\n", "no load is seen"),
    ],
    ids=["off the beam", "10 000 N", "nothing on it"],
)
def test_a_load_that_cannot_be_is_not_recorded(
    by_hand: Bench, tmp_path: Path, load: str, typed: str, said: str
) -> None:
    by_hand.hand(load)
    check_that_nothing_is_recorded(by_hand, tmp_path / "loads.csv", typed, said)


def test_a_load_that_moves_at_7_mm_per_second_is_not_recorded(bench_model: Path, tmp_path: Path) -> None:
    script = tmp_path / "script.toml"
    script.write_text("[[step]]\nseconds = 40\nposition_mm = [66, 334]\nforce_n = 10\n")
    with rig(tmp_path, bench_model, "--script", script) as bench:
        check_that_nothing_is_recorded(bench, tmp_path / "loads.csv", "200 10\n", "moved")
