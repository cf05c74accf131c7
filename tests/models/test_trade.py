"""`design-sensors trade`: the front, the choice, and the command."""

import json
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_models import modelfile
from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.estimators.posterior.graph import posterior_graph
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.pricing.noise import choose_filter, window_filter
from beamtouch_models.pricing.removal import changed
from beamtouch_models.scene import Scene, load_scene, parse_scene
from beamtouch_models.trade.front import NotToBeHadError, most_accurate, pareto_front, quickest
from beamtouch_models.trade.layouts import counts_of, windows_of
from beamtouch_models.trade.physics import EffectLeftOut, Question, errors_left_out, physics_trade
from beamtouch_models.trade.point import Point, Trade
from beamtouch_models.trade.quantised import quantised
from beamtouch_models.trade.since_touch import Curve, CurveTask, curve
from beamtouch_models.trade.timing import Times
from example_scenes import PAPER, SCENES
from in_process import Command
from posterior_cases import answers_of, prior_of
from sweeping import QUICKLY_TIMED
from traded import points_of

NONE = Measurement(0.0, 0.0)


def point(latency_ms: float, error_mm: float, sensors: int) -> Point:
    times = Times(1.0, 1.0, 1.0)
    return Point("posterior", sensors, FilterChoice(), False, NONE, error_mm, NONE, NONE, times, 0.1, 1, latency_ms)


def left_out(scene: Scene, draws: int) -> list[EffectLeftOut]:
    return physics_trade(scene, errors_left_out(Question(scene, draws, 0)), 0)


POINTS = st.lists(
    st.builds(point, st.sampled_from([1.0, 2.0, 3.0]), st.sampled_from([1.0, 2.0, 3.0]), st.sampled_from([2, 3, 4])),
    min_size=1,
    max_size=12,
)


@given(POINTS)
def test_the_front_has_the_points_that_no_other_dominates(points: list[Point]) -> None:
    front = pareto_front(points)
    assert front
    for one in points:
        beaten = any(
            other.latency_ms <= one.latency_ms
            and other.error_mm <= one.error_mm
            and other.sensors <= one.sensors
            and (other.latency_ms < one.latency_ms or other.error_mm < one.error_mm or other.sensors < one.sensors)
            for other in points
        )
        assert (one in front) != beaten


@given(POINTS, st.sampled_from([0.5, 1.0, 2.5]))
def test_a_requirement_picks_the_best_point_that_meets_it(points: list[Point], wish: float) -> None:
    kept = [one for one in points if one.latency_ms <= wish]
    if kept:
        assert most_accurate(points, wish).error_mm == min(one.error_mm for one in kept)
        assert most_accurate(points, wish).latency_ms <= wish
    else:
        with pytest.raises(NotToBeHadError, match="the fastest takes"):
            most_accurate(points, wish)
    kept = [one for one in points if one.error_mm <= wish]
    if kept:
        assert quickest(points, wish).latency_ms == min(one.latency_ms for one in kept)
        assert quickest(points, wish).error_mm <= wish
    else:
        with pytest.raises(NotToBeHadError, match="the best has"):
            quickest(points, wish)


def test_numbers_of_sensors_and_windows_follow_the_scene() -> None:
    bench, _ = load_scene(SCENES / "bench.toml")
    assert counts_of(bench) == [2, 3, 4, 5]
    assert [chosen.window for chosen in windows_of(bench)] == [1, 2, 4]
    assert windows_of(bench)[-1] == window_filter(bench, choose_filter(bench).window)
    paper = parse_scene(PAPER, "paper")
    assert [chosen.window for chosen in windows_of(paper)] == [1, 2, 4, 8]
    assert windows_of(paper)[0] == choose_filter(paper)


@pytest.mark.long
@pytest.mark.usefixtures("short_timing")
def test_a_point_states_the_error_and_latency_of_its_model() -> None:
    scene = parse_scene(PAPER, "paper")
    kept: list[Trade] = []
    trade = points_of(scene, 512, kept.append)
    every = trade.points
    assert [len(one.points) for one in kept] == list(range(2, 17, 2))
    assert {one.planned for one in kept} == {trade.planned} == {16}
    assert {one.timed_alone for one in kept} == {False}
    assert trade.timed_alone
    assert trade.failures == ()
    assert {one.sensors for one in every} == {2, 3}
    points = [one for one in every if one.sensors == 2]
    assert [(one.filter.window, one.quantised) for one in points] == [
        (window, precision) for window in (1, 2, 4, 8) for precision in (False, True)
    ]
    for one in points[::2]:
        assert one.ratio.value == pytest.approx(1, abs=0.02)
        assert one.ratio.standard_error < one.error_percent.standard_error / one.error_percent.value
        assert one.error_percent.value == pytest.approx(one.error_mm / 4)
        assert one.latency_ms == pytest.approx(5 + 0.17 + one.filter.settling_ms + one.times.p50_us / 1e3)
        assert 0 < one.times.p50_us <= one.times.p99_us
    # The same contacts, with less noise each.
    errors = [one.error_mm for one in points[::2]]
    assert errors == sorted(errors, reverse=True)


def test_quantised_weights_are_integers_and_cost_accuracy() -> None:
    prior = prior_of("bench", 3, 5.0, known=False)
    graph = posterior_graph(prior, with_force=False)
    small = quantised(graph)
    assert onnx.TensorProto.INT8 in {tensor.data_type for tensor in small.graph.initializer}
    drawn = limit.draw(prior, 2000, 3)
    plain, rough = (
        np.abs(answers_of(g, prior, drawn.deflection_mm)["position_mm"] - drawn.position_mm).mean()
        for g in (graph, small)
    )
    assert plain < rough


def test_leaving_out_an_expensive_effect_costs_accuracy() -> None:
    scene, _ = load_scene(SCENES / "short-deep.toml")
    found = {effect.effect: effect for effect in left_out(scene, 400)}
    assert found["shear"].verdict == "in"
    assert found["shear"].error_over_limit.value > 1.5
    assert found["shear"].influence_ms > 0


def test_a_row_of_physics_is_one_effect() -> None:
    scene, _ = load_scene(SCENES / "short-deep.toml")
    stated = scene.model_dump()
    length, thickness = scene.beam.length_mm, scene.beam.thickness_mm or 0.0
    # Steps of half the noise, in a beam whose shear is worth 50 times the noise.
    stated["beam"]["segments"] = [
        {"to_mm": length / 3, "thickness_mm": 1.002 * thickness},
        {"to_mm": length, "thickness_mm": thickness},
    ]
    found = {one.effect: one for one in left_out(Scene.model_validate(stated), 400)}
    assert found["shear"].error_over_limit.value > 1.5
    assert found["steps"].error_over_limit.value < 1.05


def test_an_estimator_without_the_steps_of_the_adc_takes_the_noise_to_be_without_them() -> None:
    scene, _ = load_scene(SCENES / "conveyor.toml")
    # Steps of 60 um beside a noise of 3 um: an estimator that does not know of them trusts its samples too much.
    coarse = changed(scene, "sensors", adc_bits=6)
    found = {one.effect: one for one in left_out(coarse, 400)}
    assert found["ADC steps"].error_over_limit.value > 1.05
    assert found["shear"].error_over_limit.value < 1.01


def test_noise_from_the_adc_alone_has_a_row_for_each_other_effect() -> None:
    scene, _ = load_scene(SCENES / "conveyor.toml")
    quiet = changed(scene, "sensors", noise_mm=0.0)
    assert [one.effect for one in left_out(quiet, 100)] == ["shear"]


def test_a_curve_is_of_the_filter_that_build_writes() -> None:
    stated, _ = load_scene(SCENES / "bench.toml")
    scene = changed(stated, "requirements", max_mean_ms=10.0)  # less than the latency of 20 ms
    found = curve(CurveTask(scene, 2, 4, 0))
    assert isinstance(found, Curve)
    assert found.readings[-1] == choose_filter(scene).max_readings == 4


def test_fixed_sensors_raise_the_least_number_of_sensors() -> None:
    scene = parse_scene(PAPER.replace("count = 2", "count = [2, 5]\nfixed_mm = [50, 200, 333]"), "fixed")
    assert counts_of(scene) == [3, 4, 5]
    loaded = changed(scene, "contact", width_mm=20.0)
    assert [one.effect for one in left_out(loaded, 100)] == ["contact width"]


@pytest.mark.long
@pytest.mark.usefixtures("short_timing", "short_measuring")
def test_the_command_writes_the_folder_and_builds_the_choice(design_sensors_here: Command, tmp_path: Path) -> None:
    scene = tmp_path / "plate.toml"
    text = PAPER.replace("count = 2", "count = [2, 3]").replace("[sensors]", "[sensors]\nrate_hz = 50")
    scene.write_text(text + "\n[requirements]\nlatency_ms = 40\n")
    common = ("trade", scene, "-o", tmp_path / "out", "--draws", 128, "--estimators", "posterior")
    done = design_sensors_here(*common, "--latency-ms", 60, "--json")
    assert done.returncode == 0
    found = json.loads(done.stdout)
    chosen = found["points"][found["picked"]["index"]]
    assert chosen["latency_ms"] <= 60
    built = modelfile.load(Path(found["picked"]["model"]))
    assert built.metadata.filter.window == chosen["filter"]["window"]
    assert len(built.metadata.layout) == chosen["sensors"]
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "trade.json", "trade.md", "trade.svg", "since-touch.svg", "plate.onnx"
    }  # fmt: skip
    assert (tmp_path / "out" / "trade.md").read_text().count("\n| ") > len(found["points"])
    assert found["planned_points"] == len(found["points"])
    # Every point is in the picture, with its number of sensors.
    picture = (tmp_path / "out" / "trade.svg").read_text()
    shown = re.findall(r'<text x="[\d.]+" y="[\d.]+">(\d)(\*?)</text>', picture)
    expected = [(str(one["sensors"]), "*" * one["on_front"]) for one in found["points"]]
    assert sorted(shown) == sorted(expected)
    assert picture.count("<circle") == len(expected) + 2  # two in the legend
    none = design_sensors_here(*common, "--error-mm", 1e-6)
    assert (none.returncode, none.stdout, none.stderr.count("\n")) == (2, "", 1)
    assert "no point has a mean error of 1e-06 mm" in none.stderr


def interrupted(command: list[str], stop: signal.Signals, is_time: Callable[[], bool]) -> tuple[int, str, str]:
    """Run a command with the posterior alone and stop it once it is time; return exit code, output and errors."""
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, "--estimators", "posterior"], stdout=pipe, stderr=pipe, text=True) as process:
        deadline = time.monotonic() + 300
        while not is_time():
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        process.send_signal(stop)
        stdout, stderr = process.communicate(timeout=60)
    return process.returncode, stdout, stderr


@pytest.mark.long
def test_a_terminated_trade_keeps_its_points(tmp_path: Path) -> None:
    out = tmp_path / "out"
    command = [*QUICKLY_TIMED, "trade", str(SCENES / "bench.toml"), "-o", str(out), "--draws", "512", "--json"]
    code, stdout, stderr = interrupted(command, signal.SIGTERM, (out / "trade.svg").exists)
    found = json.loads((out / "trade.json").read_text())
    done = len(found["points"])
    assert (code, stdout) == (130, "")
    assert stderr == f"design-sensors: interrupted; {done} of 24 points are in {out}\n"
    assert 0 < done < found["planned_points"] == 24
    assert all(one["latency_ms"] > 0 and one["error_percent"]["value"] > 0 for one in found["points"])
    # The curves since touch come after the points.
    assert {path.name for path in out.iterdir()} - {"since-touch.svg"} == {"trade.json", "trade.md", "trade.svg"}
    assert f"{done} of 24 points" in (out / "trade.md").read_text()


@pytest.mark.long
def test_an_interrupted_build_of_the_choice_says_what_is_kept(tmp_path: Path) -> None:
    scene, out = tmp_path / "conveyor.toml", tmp_path / "out"
    text = (SCENES / "conveyor.toml").read_text().replace("count = 4", "count = [3, 3]")
    scene.write_text(text.replace("latency_ms = 50", "latency_ms = 10").replace("position_error_mm = 20", ""))
    command = [*QUICKLY_TIMED, "trade", str(scene), "-o", str(out), "--draws", "100", "--error-mm", "300"]

    def has_physics() -> bool:
        """Say whether the last results before the choice is built are there; building it takes seconds."""
        results = out / "trade.json"
        return results.exists() and bool(json.loads(results.read_text())["physics"])

    code, stdout, stderr = interrupted(command, signal.SIGINT, has_physics)
    found = json.loads((out / "trade.json").read_text())
    done = len(found["points"])
    assert (code, stdout, done) == (130, "", found["planned_points"])
    assert stderr.splitlines()[-1] == f"design-sensors: interrupted; {done} of {done} points are in {out}"
    assert found["physics"]
    # The curves since touch come after the points.
    assert {path.name for path in out.iterdir()} - {"since-touch.svg"} == {"trade.json", "trade.md", "trade.svg"}


@pytest.mark.usefixtures("short_timing", "short_measuring")
def test_points_that_fail_are_named_and_the_others_are_shown_in_a_table(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    scene = tmp_path / "narrow.toml"
    # Three sensors with 150 mm between them go on 400 mm, four do not.
    text = PAPER.replace("count = 2", "count = [3, 4]\nmin_distance_mm = 150")
    scene.write_text(text + "\n[requirements]\nlatency_ms = 10\n")
    options = ("--draws", 128, "--estimators", "posterior", "--error-mm", 300)
    done = design_sensors_here("trade", scene, "-o", tmp_path / "out", *options)
    assert done.returncode == 0
    found = json.loads((tmp_path / "out" / "trade.json").read_text())
    assert {one["sensors"] for one in found["points"]} == {3}
    (failure,) = found["failures"]
    assert (failure["sensors"], failure["estimator"]) == (4, None)
    assert "min_distance_mm" in failure["reason"]
    assert failure["reason"] in (tmp_path / "out" / "trade.md").read_text()
    assert failure["reason"] in done.stderr
    points, front = len(found["points"]), sum(one["on_front"] for one in found["points"])
    title, *table, last = done.stdout.strip().splitlines()
    assert title.rstrip() == f"narrow: the front, {front} of {points} points"
    assert sum("posterior" in line for line in table) == front
    assert f"all {points} points are in {tmp_path / 'out'}: trade.md, " in done.stderr
    assert last.startswith(f"built {tmp_path / 'out' / 'narrow.onnx'}: ")
    # The quickest one, unless it is one of 8-bit weights whose answers depend on how this machine rounds.
    ahead = sorted(one["latency_ms"] for one in found["points"])[: 1 + done.stderr.count("note: not built: ")]
    assert last.endswith(f" mm, {ahead[-1]:.3g} ms")
    assert len(modelfile.load(tmp_path / "out" / "narrow.onnx").metadata.layout) == 3


@pytest.mark.parametrize(
    "wish", [["--latency-ms", "0"], ["--error-mm", "nan"], ["--error-mm", "1", "--latency-ms", "1"]]
)
def test_a_requirement_that_is_not_positive_is_refused_at_once(
    design_sensors_here: Command, tmp_path: Path, wish: list[str]
) -> None:
    done = design_sensors_here("trade", SCENES / "bench.toml", "-o", tmp_path / "out", *wish)
    assert (done.returncode, done.stdout) == (2, "")
    assert not (tmp_path / "out").exists()
