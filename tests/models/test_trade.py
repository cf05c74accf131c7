"""`design-sensors trade`."""

import contextlib
import io
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamtouch_models import cli, runtime
from support.pages.tags import Tags
from support.programs.in_process import Refusal
from support.surfaces.example_scenes import PAPER, ROUGH, SCENES

pytestmark = pytest.mark.long
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


@dataclass(frozen=True)
class Traded:
    """A scene whose trade was measured by the command, and what that wrote."""

    scene: Path
    folder: Path
    said: str
    noted: str

    @property
    def found(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads((self.folder / "trade.json").read_text())
        return found

    @property
    def page(self) -> str:
        return (self.folder / "trade.md").read_text()

    @property
    def on_front(self) -> int:
        return sum(one["on_front"] for one in self.found["points"])


@pytest.fixture(scope="module")
def traded(tmp_path_factory: pytest.TempPathFactory) -> Traded:
    """Two to four sensors with 150 mm between them, of which three go on 400 mm; the choice answers within 60 ms."""
    folder = tmp_path_factory.mktemp("trade")
    text = PAPER.replace("count = 2", "count = [2, 4]\nmin_distance_mm = 150\ngrid_mm = 25")
    text = text.replace("[sensors]", "[sensors]\nrate_hz = 50")
    scene, out = folder / "narrow.toml", folder / "out"
    scene.write_text(text + "\n[requirements]\nlatency_ms = 40\nposition_error_mm = 1000\n")
    options = ("--draws", "128", "--estimators", "posterior", "paper-network", "--latency-ms", "60", "--workers", "1")
    said, noted = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(noted):
        assert cli.main(["trade", str(scene), "-o", str(out), *options, "--effort", str(ROUGH)]) == 0
    return Traded(scene, out, said.getvalue(), noted.getvalue())


def test_the_folder_has_the_numbers_the_page_the_picture_and_the_choice(traded: Traded) -> None:
    files = {path.name for path in traded.folder.iterdir()}
    assert files == {"trade.json", "trade.md", "trade.svg", "narrow.onnx"}
    points = len(traded.found["points"])
    assert f"all {points} points are in {traded.folder}: trade.svg, " in traded.noted


def test_the_own_model_has_the_fewest_sensors_that_meet_the_requirement_and_each_other_one_change(
    traded: Traded,
) -> None:
    own, *others = traded.found["models"]
    assert (own["changed"], own["sensors"]) == (None, 2)
    changes = ["sensors", "estimator", "noise", "noise", "noise", "noise", "latency"]
    assert [model["changed"] for model in others] == changes
    noises = [model["reading_mm"] / own["reading_mm"] for model in others if model["changed"] == "noise"]
    assert noises == pytest.approx([0.25, 0.5, 2, 4])
    assert others[-1]["filter"]["window"] == 4


def test_a_number_of_sensors_without_a_layout_is_named_with_the_reason(traded: Traded) -> None:
    (failure,) = traded.found["failures"]
    assert (failure["sensors"], failure["varied"]) == (4, "sensors")
    assert "min_distance_mm" in failure["reason"]
    assert failure["reason"] in " ".join(traded.noted.split())


def test_errors_grow_with_the_noise_and_a_trained_network_may_miss_the_limit(traded: Traded) -> None:
    models = traded.found["models"]
    ratios = {model["changed"]: model["ratio"]["value"] for model in models}
    assert min(ratios.values()) > 0.97
    assert ratios["estimator"] > MAX_RATIO
    errors = [model["error_mm"] for model in models if model["changed"] == "noise"]
    assert errors == sorted(errors)


def test_the_page_and_the_command_say_the_same_of_changes_front_and_build(traded: Traded) -> None:
    found = traded.found
    for told in (traded.page, traded.said):
        assert all(f"- {sentence} " in " ".join(told.split()) for sentence in found["sentences"])
        assert f"\ndesign-sensors build {traded.scene} --sensors 2 -o narrow.onnx\n" in told
        assert f"\n{traded.on_front} of {len(found['points'])} points" in told
    assert found["sentences"][0].startswith("2 sensors give a mean error of ")


def test_each_sentence_on_a_change_says_what_its_model_saves_or_costs(traded: Traded) -> None:
    assert_changes_are_told(traded.found)


def test_the_front_is_a_table_on_the_page_and_of_the_command(traded: Traded) -> None:
    assert traded.page.partition("## The front")[2].count("\n| ") == 2 + traded.on_front
    lines = traded.said.partition("the front")[2].splitlines()
    rows = [line for line in lines if re.match(r"\s+[23]\s+(posterior|paper-network)\s", line)]
    assert len(rows) == traded.on_front


def test_answers_since_a_touch_stand_beside_their_limits(traded: Traded) -> None:
    since_touch = traded.found["since_touch"]
    assert [one["readings"] for one in since_touch] == sorted(one["readings"] for one in since_touch)
    assert all(one["limit_mm"]["value"] > 0 for one in since_touch)


def test_the_picture_has_an_axis_for_each_thing_that_is_traded(traded: Traded) -> None:
    picture = (traded.folder / "trade.svg").read_text()
    labels = ("sensors", "since a touch, ms", "noise of a reading, µm", "an inference, µs", "accuracy limit")
    assert all(f">{label}</text>" in picture for label in labels)


def test_errors_stand_at_the_height_of_their_logarithms(traded: Traded) -> None:
    picture = (traded.folder / "trade.svg").read_text()
    own, *others = traded.found["models"]
    models = sorted([own, *(one for one in others if one["changed"] == "noise")], key=lambda one: one["reading_mm"])
    errors = np.log([one["error_mm"] for one in models])
    curves = [re.findall(r",([\d.]+)", curve["points"]) for curve in Tags(picture).of("polyline")]
    heights = [np.array(curve, dtype=float) for curve in curves if len(curve) == len(errors)]
    assert min(np.ptp(one - np.polyval(np.polyfit(errors, one, 1), errors)) for one in heights) < 0.2


def test_the_choice_is_the_most_accurate_that_answers_in_time(traded: Traded) -> None:
    quick = [one for one in traded.found["points"] if one["latency_ms"] <= 60]
    best = min(quick, key=lambda one: (one["error_mm"], one["latency_ms"]))
    path = traded.folder / "narrow.onnx"
    last = traded.said.strip().splitlines()[-1]
    assert last.startswith(f"built {path}: {best['estimator']}, {best['sensors']} sensors, ")
    assert last.endswith(f" mm, {best['latency_ms']:.3g} ms")
    built = runtime.load(path).metadata
    assert (built.estimator, len(built.layout)) == (best["estimator"], best["sensors"])


@pytest.mark.soak
def test_a_plate_is_traded_by_sensors_noise_and_time(tmp_path: Path) -> None:
    scene, out = tmp_path / "table.toml", tmp_path / "out"
    text = (SCENES / "plate-on-springs.toml").read_text(encoding="utf-8")
    scene.write_text(text.replace("count = 4", "count = 4\ngrid_mm = 50"), encoding="utf-8")
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert cli.main(["trade", str(scene), "-o", str(out), "--draws", "200", "--effort", str(ROUGH)]) == 0
    found = json.loads((out / "trade.json").read_text(encoding="utf-8"))
    errors_mm = {one["sensors"]: one["error_mm"] for one in found["models"] if one["changed"] in (None, "sensors")}
    assert errors_mm[3] > errors_mm[4] > errors_mm[5]
    assert all(one["estimator"] == "posterior" for one in found["models"])
    assert all(len(place) == 2 for one in found["models"] for place in one["positions_mm"])
    assert max(one["ratio"]["value"] for one in found["models"]) < MAX_RATIO
    assert "While the plate rings after a sudden force" in " ".join(said.getvalue().split())
