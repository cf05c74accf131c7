"""`design-sensors trade`."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from beamtouch_models import modelfile
from support.programs.in_process import Command, Refusal
from support.surfaces.example_scenes import PAPER

MAX_RATIO = 1.2
"""The largest error over the limit of a model that `build` writes."""


CHANGES: dict[str, Callable[[dict[str, Any], dict[str, Any]], bool]] = {
    "1 sensor more (3)": lambda one, _: (one["changed"], one["sensors"]) == ("sensors", 3),
    "A quarter of the noise of a reading": lambda one, own: one["reading_mm"] == pytest.approx(own["reading_mm"] / 4),
    "Half the noise of a reading": lambda one, own: one["reading_mm"] == pytest.approx(own["reading_mm"] / 2),
    "Twice the noise of a reading": lambda one, own: one["reading_mm"] == pytest.approx(own["reading_mm"] * 2),
    "Four times the noise of a reading": lambda one, own: one["reading_mm"] == pytest.approx(own["reading_mm"] * 4),
    "Twice the latency (80 ms)": lambda one, _: one["changed"] == "latency",
}
"""What a sentence says of a change, and the model that has it."""


def assert_changes_are_told(found: dict[str, Any]) -> None:
    """Require that each sentence on a change says what its model saves or costs."""
    own, *others = found["models"]
    told = dict(sentence.split(": ", 1) for sentence in found["sentences"] if sentence.split(": ")[0] in CHANGES)
    assert set(told) == set(CHANGES)
    said = []
    for change, words in told.items():
        (model,) = (one for one in others if CHANGES[change](one, own))
        percent = 100 * (model["error_mm"] / own["error_mm"] - 1)
        if words.startswith("no difference beyond its standard error"):
            continue
        matched = re.fullmatch(r"(saves|costs) (\S+) ± (\S+) % of the error\.", words)
        assert matched, words
        said.append(matched[1])
        assert matched[1] == ("saves" if percent < 0 else "costs"), change
        assert float(matched[2]) == pytest.approx(abs(percent), rel=0.06)
        assert float(matched[3]) < float(matched[2])
    assert {"saves", "costs"} <= set(said)


def test_a_trade_without_any_point_gives_the_reason(refused: Refusal, tmp_path: Path) -> None:
    scene = tmp_path / "narrow.toml"
    scene.write_text(PAPER.replace("count = 2", "count = [3, 4]\nmin_distance_mm = 250"))
    assert "min_distance_mm" in refused("trade", scene, "-o", tmp_path / "out", "--draws", 100)
    assert not list(tmp_path.rglob("*.onnx"))


@pytest.mark.long
def test_the_command_writes_the_folder_names_what_fails_and_builds_the_choice(
    design_sensors_roughly: Command, tmp_path: Path
) -> None:
    scene, out = tmp_path / "narrow.toml", tmp_path / "out"
    # Three sensors with 150 mm between them go on 400 mm, four do not.
    text = PAPER.replace("count = 2", "count = [2, 4]\nmin_distance_mm = 150\ngrid_mm = 25")
    text = text.replace("[sensors]", "[sensors]\nrate_hz = 50")
    scene.write_text(text + "\n[requirements]\nlatency_ms = 40\nposition_error_mm = 1000\n")
    options = ("--draws", 128, "--estimators", "posterior", "paper-network", "--latency-ms", 60)
    done = design_sensors_roughly("trade", scene, "-o", out, *options)
    assert done.returncode == 0
    assert {path.name for path in out.iterdir()} == {"trade.json", "trade.md", "trade.svg", "narrow.onnx"}
    found = json.loads((out / "trade.json").read_text())
    changes = [model["changed"] for model in found["models"]]
    # The own model has the fewest sensors that meet the requirement.
    assert changes == [None, "sensors", "estimator", "noise", "noise", "noise", "noise", "latency"]
    (failure,) = found["failures"]
    assert (failure["sensors"], failure["varied"]) == (4, "sensors")
    assert "min_distance_mm" in failure["reason"]
    ratios = {model["changed"]: model["ratio"]["value"] for model in found["models"]}
    assert min(ratios.values()) > 0.97
    assert ratios["estimator"] > MAX_RATIO  # a network that is trained may miss the limit, and its error says so
    noisy = [model for model in found["models"] if model["changed"] == "noise"]
    assert [model["error_mm"] for model in noisy] == sorted(model["error_mm"] for model in noisy)
    noises = [model["reading_mm"] / found["models"][0]["reading_mm"] for model in noisy]
    assert noises == pytest.approx([0.25, 0.5, 2, 4])
    assert found["models"][-1]["filter"]["window"] == 4
    points, front = len(found["points"]), sum(one["on_front"] for one in found["points"])
    page = (out / "trade.md").read_text()
    assert failure["reason"] in done.stderr
    build = f"design-sensors build {scene} --sensors 2 -o narrow.onnx"
    for told in (page, done.stdout):
        assert all(f"- {sentence}\n" in told for sentence in found["sentences"])
        assert f"\n{build}\n" in told
        assert f"\n{front} of {points} points" in told
    assert found["sentences"][0].startswith("2 sensors give a mean error of ")
    assert_changes_are_told(found)
    assert page.partition("## The front")[2].count("\n| ") == 2 + front
    since_touch = found["since_touch"]
    assert [one["readings"] for one in since_touch] == sorted(one["readings"] for one in since_touch)
    assert all(one["limit_mm"]["value"] > 0 for one in since_touch)
    picture = (out / "trade.svg").read_text()
    labels = ("sensors", "since a touch, ms", "noise of a reading, µm", "an inference, µs", "accuracy limit")
    assert all(f">{label}</text>" in picture for label in labels)
    lines = done.stdout.partition("the front")[2].splitlines()
    assert sum(bool(re.match(r"\s+[23]\s+(posterior|paper-network)\s", line)) for line in lines) == front
    assert f"all {points} points are in {out}: trade.svg, " in done.stderr
    quick = [one for one in found["points"] if one["latency_ms"] <= 60]
    best = min(quick, key=lambda one: (one["error_mm"], one["latency_ms"]))
    last = done.stdout.strip().splitlines()[-1]
    assert last.startswith(f"built {out / 'narrow.onnx'}: {best['estimator']}, {best['sensors']} sensors, ")
    assert last.endswith(f" mm, {best['latency_ms']:.3g} ms")
    built = modelfile.load(out / "narrow.onnx").metadata
    assert (built.estimator, len(built.layout)) == (best["estimator"], best["sensors"])
