"""The front of a trade, what a requirement picks from it, and the models on it."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_models.design.accuracy.limit import Reached
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.scene import change_scene, load_scene, parse_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.lab.trade.measure import MeasuredModel, Task, follow, measure, numbers_of_sensors
from beamtouch_models.lab.trade.trade import Point, UnreachableTargetError, most_accurate, pareto_front, quickest
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.metadata_parts import FilterChoice
from support.surfaces.example_scenes import PAPER, ROUGH, SCENES

NONE, PLAIN = Measurement(0.0, 0.0), parse_scene(PAPER, "plain")


def point(latency_ms: float, error_mm: float, sensors: int, standard_error_mm: float = 0.0) -> Point:
    task = Task(PLAIN, "sensors", sensors, 100, 0)
    places, reached = tuple(map(float, range(sensors))), Reached(NONE, NONE, NONE)
    model = MeasuredModel(task, places, 1e-3, FilterChoice(), 400.0, reached, (), b"")
    return Point(model, 1, Measurement(error_mm, standard_error_mm), latency_ms, round(latency_ms))


THREE = st.sampled_from([1.0, 2.0, 3.0])
POINTS = st.lists(st.builds(point, THREE, THREE, st.sampled_from([2, 3, 4])), min_size=1, max_size=12)


@pytest.mark.promise(
    "docs/how-to/design.md",
    "It is on the front if no other point is better in one of error, time and number of sensors and worse in none.",
)
@given(POINTS)
def test_the_front_has_the_points_that_no_other_dominates(points: list[Point]) -> None:
    front = pareto_front(points)
    assert front
    for one in points:
        cost = (one.latency_ms, one.error_mm.value, one.model.sensors)
        others = [(other.latency_ms, other.error_mm.value, other.model.sensors) for other in points]
        beaten = any(all(a <= b for a, b in zip(other, cost, strict=True)) and other != cost for other in others)
        assert (one in front) != beaten


def test_a_sensor_more_that_saves_less_than_its_standard_error_is_not_on_the_front() -> None:
    three, four, five = point(10.0, 1.0, 3, 0.02), point(10.0, 0.98, 4, 0.02), point(10.0, 0.9, 5, 0.02)
    assert pareto_front([three, four, five]) == [three, five]


@pytest.mark.promise("docs/how-to/design.md", "builds the most accurate model that answers within L ms")
@given(POINTS, st.sampled_from([0.5, 1.0, 2.5]))
def test_a_requirement_picks_the_best_point_that_meets_it(points: list[Point], wish: float) -> None:
    kept = [one for one in points if one.latency_ms <= wish]
    if kept:
        assert most_accurate(points, wish).error_mm.value == min(one.error_mm.value for one in kept)
        assert most_accurate(points, wish).latency_ms <= wish
    else:
        with pytest.raises(UnreachableTargetError, match="the fastest takes"):
            most_accurate(points, wish)
    kept = [one for one in points if one.error_mm.value <= wish]
    if kept:
        assert quickest(points, wish).latency_ms == min(one.latency_ms for one in kept)
        assert quickest(points, wish).error_mm.value <= wish
    else:
        with pytest.raises(UnreachableTargetError, match="the best has"):
            quickest(points, wish)


def test_numbers_of_sensors_follow_the_scene() -> None:
    bench, _ = load_scene(SCENES / "bench.toml")
    assert numbers_of_sensors(bench) == [2, 3, 4, 5]
    fixed = parse_scene(PAPER.replace("count = 2", "count = [2, 5]\nfixed_mm = [50, 200, 333]"), "fixed")
    assert numbers_of_sensors(fixed) == [3, 4, 5]
    # The stated number is always among them.
    assert numbers_of_sensors(parse_scene(PAPER.replace("count = 2", "count = 1"), "one")) == [1, 2]


def test_a_model_has_the_layout_and_the_figures_of_build(bench: ModelFile) -> None:
    scene, _ = load_scene(SCENES / "bench.toml")
    layout = tuple(channel.position_mm for channel in bench.metadata.layout)
    found = measure(Task(scene, "sensors", 4, 4096, 0, kept_mm=layout))
    assert isinstance(found, MeasuredModel)
    stated = bench.metadata.accuracy
    percent = 100 / scene.beam.length_mm
    assert found.reached.error_mm.value * percent == pytest.approx(stated.error_percent, rel=1e-9)
    assert found.reached.error_mm.standard_error * percent == pytest.approx(stated.error_standard_error, rel=1e-9)
    assert found.reached.limit_mm.value * percent == pytest.approx(stated.limit_percent, rel=1e-9)
    assert found.filter == bench.metadata.filter
    assert [one.readings for one in found.answers] == [one.readings for one in stated.since_touch]
    # The filter only adds to the error of the plain means, and little once it has settled.
    for answer, since in zip(found.answers, stated.since_touch, strict=True):
        assert answer.error_mm.value * percent < since.error_percent + 4 * (since.error_standard_error or 0.0)
    (window,) = (one for one in found.answers if one.readings == found.filter.window)
    assert window.error_mm == found.reached.error_mm


def test_the_answers_since_a_touch_are_of_the_filter_that_build_writes() -> None:
    stated, _ = load_scene(SCENES / "bench.toml")
    scene = change_scene(stated, requirements={"max_mean_ms": 10.0})  # less than the latency of 20 ms
    model = measure(Task(scene, "sensors", 2, 128, 0, kept_mm=(110.0, 290.0), effort=Effort(ROUGH)))
    assert isinstance(model, MeasuredModel)
    answers = [one.answer for one in follow(model)]
    assert answers[-1].readings == resolve(scene).filter.max_readings == 4
    assert all(answer.ringing_mm is not None for answer in answers)
    without_mass = change_scene(scene, beam={"density_kg_m3": None})
    other = replace(model, task=replace(model.task, scene=without_mass))
    assert all(one.answer.ringing_mm is None for one in follow(other))
