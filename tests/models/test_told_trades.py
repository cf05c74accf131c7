"""What `design-sensors trade` writes and says of a trade whose figures are known."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.layout import Layout, keep_sensors
from beamtouch_models.design.surface import Surface
from beamtouch_models.lab.trade.results import json_of, picture
from beamtouch_models.lab.trade.trade import Point, Trade
from beamtouch_models.names import ESTIMATORS
from models.test_trade_results import NETWORK, a_model, traded
from support.programs.in_process import Command, Outcome
from support.surfaces.example_scenes import PAPER, SCENES

THREE, FIVE = a_model(sensors=3, error_mm=7.0), a_model(sensors=5, error_mm=4.0)
KNOWN = traded(THREE, FIVE, NETWORK)
POINTS = tuple(
    Point(model, readings, Measurement(error_mm, 0.05), latency_ms, readings)
    for model, readings, error_mm, latency_ms in (
        (THREE, 2, 9.0, 21.234), (THREE, 4, 7.0, 41.2), (FIVE, 2, 6.0, 22.2), (FIVE, 4, 4.0, 42.3456),
        (NETWORK, 4, 6.9, 41.1),
    )
)  # fmt: skip
TRADE = Trade(
    KNOWN.own, KNOWN.models, KNOWN.inference_us, KNOWN.failures, KNOWN.since_touch, POINTS, (POINTS[0], POINTS[3])
)

Told = Callable[..., tuple[Outcome, dict[str, Any]]]


@pytest.fixture
def told(design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Told:
    """Runs the command; returns what it says, and what it asks for."""

    def run(*options: object, scene: str = PAPER) -> tuple[Outcome, dict[str, Any]]:
        asked = dict[str, Any]()

        def trade(_scene: object, estimators: Sequence[str], **how: object) -> Trade:
            asked.update(how, estimators=tuple(estimators))
            return TRADE

        def place(surface: Surface, *, count: int, seed: int, **how: object) -> Layout:
            asked.update(count=count, place_seed=seed, aim=how["aim"])
            return keep_sensors(surface, [60.0, 340.0])

        def build(_layout: Layout, name: str, **how: object) -> SimpleNamespace:
            asked.update(name=name, text=how["text"], estimator=how["estimator"], build_seed=how["seed"])
            return SimpleNamespace(content=b"the model")

        for name, stand_in in (("trade", trade), ("place_sensors", place), ("build_model", build)):
            monkeypatch.setattr(f"beamtouch_models.commands.trade.{name}", stand_in)
        path = tmp_path / "press 7.toml"
        path.write_text(scene)
        return design_sensors_here("trade", path, "-o", tmp_path / "out", *options), asked

    return run


def test_the_folder_has_numbers_a_page_and_a_picture_and_no_model_unless_one_is_asked_for(
    told: Told, tmp_path: Path
) -> None:
    done, asked = told("--draws", 300, "--seed", 4, "--effort", 0.5)
    assert done.returncode == 0
    assert (asked["draws"], asked["seed"], asked["effort"].share, asked["estimators"]) == (300, 4, 0.5, ESTIMATORS)
    folder = tmp_path / "out"
    assert sorted(path.name for path in folder.iterdir()) == ["trade.json", "trade.md", "trade.svg"]
    assert (folder / "trade.json").read_text() == json.dumps(json_of(TRADE), indent=1) + "\n"
    assert (folder / "trade.svg").read_text() == picture("press-7", TRADE)
    page = (folder / "trade.md").read_text()
    assert page.startswith(
        "# Accuracy against speed: press-7\n\n![error over sensors, time, noise and inference](trade.svg)"
    )
    assert "note: 6 sensors, posterior, another sensors: no room for it" in done.noted
    assert f"the picture and all 5 points are in {folder}: trade.svg, trade.json" in done.noted
    assert "built" not in done.stdout
    assert "--seed 4 -o press-7.onnx" in done.stdout


@pytest.mark.parametrize(
    ("options", "index", "line"),
    [
        (("--latency-ms", 30), 2, "posterior, 5 sensors, 6 mm, 22.2 ms"),
        (("--latency-ms", 42.4), 3, "posterior, 5 sensors, 4 mm, 42.3 ms"),
        (("--latency-ms", 21.3), 0, "posterior, 3 sensors, 9 mm, 21.2 ms"),
        (("--error-mm", 7), 2, "posterior, 5 sensors, 6 mm, 22.2 ms"),
        (("--error-mm", 9), 0, "posterior, 3 sensors, 9 mm, 21.2 ms"),
        (("--error-mm", 4.5), 3, "posterior, 5 sensors, 4 mm, 42.3 ms"),
    ],
)
def test_the_point_that_is_asked_for_is_built(
    told: Told, tmp_path: Path, options: tuple[object, ...], index: int, line: str
) -> None:
    done, asked = told(*options, "--seed", 3, "--effort", 0.25)
    path = tmp_path / "out" / "press-7.onnx"
    assert done.stdout.splitlines()[-1] == f"built {path}: {line}"
    assert path.read_bytes() == b"the model"
    path.unlink()  # it is none, and would not be replaced
    point = POINTS[index]
    assert (asked["count"], asked["estimator"]) == (point.model.sensors, point.model.task.estimator)
    assert (asked["place_seed"], asked["build_seed"], asked["name"], asked["text"]) == (3, 3, "press-7", PAPER)
    assert asked["aim"].effort.share == 0.25
    found = json.loads(told(*options, "--json")[0].stdout)
    assert found["picked"] == {"index": index, "model": str(path)}
    assert (found["output"], found["scene"]) == (str(tmp_path / "out"), str(tmp_path / "press 7.toml"))


@pytest.mark.parametrize("option", ["--latency-ms", "--error-mm"])
@pytest.mark.parametrize("value", ["0", "-1", "inf", "nan"])
def test_a_bound_is_a_positive_number(told: Told, option: str, value: str) -> None:
    done, _ = told(f"{option}={value}")
    assert done.returncode == 2
    assert done.stderr.endswith(f"{option} {value}: give a positive number\n")


def test_a_plate_is_traded_with_the_estimator_that_knows_two_axes(told: Told) -> None:
    plate = (SCENES / "plate-on-springs.toml").read_text()
    assert told(scene=plate)[1]["estimators"] == ESTIMATORS[:1]
    assert told("--estimators", "paper-network")[1]["estimators"] == ("paper-network",)
    assert json.loads(told("--json")[0].stdout)["picked"] is None


def test_a_file_that_is_no_model_is_not_replaced_by_the_one_that_is_asked_for(told: Told, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "press-7.onnx").write_text("mine")
    assert told()[0].returncode == 0
    for option in ("--latency-ms", "--error-mm"):
        done, asked = told(option, 50)
        assert (done.returncode, asked) == (2, {})
        assert "name another folder" in done.stderr
    assert (tmp_path / "out" / "press-7.onnx").read_text() == "mine"
