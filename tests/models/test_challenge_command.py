"""The command `design-sensors challenge`."""

import json
import sys
from pathlib import Path

import onnx
import pytest

from beamtouch_models.challenge.challenge import challenge
from beamtouch_models.challenge.scoring import Row
from beamtouch_models.progress import Progress
from beamtouch_models.sweeps import Spread
from in_process import Command
from waiting import interrupted

COMMAND = str(Path(sys.executable).parent / "design-sensors")


def test_the_command_prints_both_groups_and_one_json_object(
    design_sensors_here: Command, bench_model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[list[Row]] = []

    def once(content: bytes, *, draws: int, seed: int, progress: Progress, spread: Spread) -> list[Row]:
        kept.extend([] if kept else [challenge(content, draws=draws, seed=seed, progress=progress, spread=spread)])
        return kept[0]

    monkeypatch.setattr("beamtouch_models.challenge.challenge.challenge", once)
    done = design_sensors_here("challenge", bench_model, "--draws", 10, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["draws"], found["seed"]) == (10, 0)
    names = [row["name"] for row in found["rows"]]
    assert len(set(names)) == len(names) > 50
    assert [row["honest"] for row in found["rows"]] == sorted((row["honest"] for row in found["rows"]), reverse=True)
    assert all(row["power"] is not None for row in found["rows"] if not row["honest"])
    named = {row["name"]: row["naming"] for row in found["rows"] if row["naming"]}
    assert named["one channel wedged, no contact"] == {"named": 1.0, "misnamed": 0.0}
    assert named["two contacts at the quarters"] == {"named": 0.0, "misnamed": 0.0}
    gains = {row["name"]: row["honest"] for row in found["rows"] if row["name"].startswith("gains")}
    assert gains == {"gains 0.3 % off": True, "gains 1 % off": False, "gains 3 % off": False}
    # The same rows once more, for people.
    table = design_sensors_here("challenge", bench_model, "--draws", 10)
    assert table.returncode == 0
    assert "one contact, honestly measured" in table.stdout
    assert "faults and other worlds" in table.stdout
    assert "Rows that miss the goals" in table.stdout
    assert "…" not in table.stdout  # neither a heading nor a number is cut


def test_a_model_that_states_no_log_odds_is_refused(
    design_sensors_here: Command, bench_model: Path, tmp_path: Path
) -> None:
    graph = onnx.load(bench_model)
    for output in [one for one in graph.graph.output if one.name == "contact_log_odds"]:
        graph.graph.output.remove(output)
    path = tmp_path / "silent.onnx"
    onnx.save(graph, path)
    done = design_sensors_here("challenge", path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "contact_log_odds" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "said_so"),
    [
        (("--help",), 0, "--draws"),
        (("no.onnx",), 2, "No such file"),
        (("no.onnx", "--draws", "9"), 2, "from 10 to 10000"),
        ((), 2, "required: MODEL"),
    ],
)
def test_help_and_bad_requests(
    design_sensors_here: Command, arguments: tuple[str, ...], code: int, said_so: str
) -> None:
    done = design_sensors_here("challenge", *arguments)
    assert done.returncode == code
    assert said_so in (done.stdout if code == 0 else done.stderr)
    assert done.stderr.count("\n") == (1 if code else 0)


def test_ctrl_c_is_130(bench_model: Path) -> None:
    def is_at_work(pid: int) -> bool:
        # The command loads the runtime only once it is at work.
        return "onnxruntime" in Path(f"/proc/{pid}/maps").read_text()

    words = [COMMAND, "challenge", str(bench_model), "--draws", "10000"]
    assert interrupted(words, is_at_work) == (130, "", "design-sensors: interrupted\n")
