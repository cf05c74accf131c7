"""Which models a trade measures and what it makes of them, where each measurement is known."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from beamtouch_models.design.accuracy.limit import Reached
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.since_touch import Answer
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.scene import Scene, change_scene, parse_scene
from beamtouch_models.errors import SceneError
from beamtouch_models.lab.trade import trade as traded
from beamtouch_models.lab.trade.measure import AnswerAtTime, Failure, MeasuredModel, Task
from beamtouch_models.lab.trade.trade import Trade, trade
from beamtouch_models.names import ESTIMATORS, EstimatorName
from beamtouch_models.runtime.metadata_parts import FilterChoice
from support.surfaces.example_scenes import PAPER

SCENE = change_scene(
    parse_scene(PAPER, "scene"),
    sensors={"count": 4, "noise_mm": 0.004, "noise_percent_of_max": None, "rate_hz": 100.0},
    requirements={"latency_ms": 30.0},
)
ANSWERS = ((2, 20.0, 9.0), (4, 40.0, 6.0))
"""Readings, times in ms and errors in mm of a model."""


@dataclass
class Workers:
    """Stands for the workers: a model has a limit of 12 mm over its number of sensors."""

    fails: Callable[[Task], bool] = lambda _: False
    tasks: list[Task] = field(default_factory=list)
    followed: list[MeasuredModel] = field(default_factory=list)

    def __call__(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Any]:
        for task in tasks:
            if function.__name__ == "follow":
                self.followed.append(task)
                yield [AnswerAtTime(answer, Measurement(1.0, 0.1)) for answer in task.answers]
                continue
            self.tasks.append(task)
            if self.fails(task):
                yield Failure(task.varied, task.sensors, task.estimator, f"no room for {task.sensors}")
                continue
            reached = Reached(Measurement(5.0, 0.1), Measurement(12 / task.sensors, 0.1), Measurement(1.2, 0.1))
            answers = tuple(Answer(count, ms, Measurement(mm, 0.1)) for count, ms, mm in ANSWERS)
            places = tuple(10.0 * place for place in range(1, task.sensors + 1))
            noise_mm = task.scene.sensors.noise_mm or 0.0
            yield MeasuredModel(task, places, noise_mm, FilterChoice(window=4), 400.0, reached, answers, b"")


Steps = list[tuple[str, float]]


def measured(
    monkeypatch: pytest.MonkeyPatch,
    workers: Workers,
    scene: Scene = SCENE,
    estimators: Sequence[EstimatorName] = ESTIMATORS,
    steps: Steps | None = None,
) -> Trade:
    told: Steps = [] if steps is None else steps
    monkeypatch.setattr(
        traded, "inference_times", lambda models: [Measurement(50.0 + place, 1.0) for place in range(len(models))]
    )
    return trade(
        scene, estimators, draws=77, seed=5, spread=workers, effort=Effort(0.5),
        progress=lambda text, share: told.append((text, share)),
    )  # fmt: skip


def test_numbers_of_sensors_come_first_and_then_one_change_each_of_the_scenes_own_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    workers, steps = Workers(), Steps()
    found = measured(monkeypatch, workers, steps=steps)
    assert [task.varied for task in workers.tasks] == ["sensors"] * 4 + ["estimator"] * 2 + ["noise"] * 4 + ["latency"]
    assert [task.sensors for task in workers.tasks] == [2, 3, 4, 5] + [4] * 7
    assert {(task.draws, task.seed, task.effort.share) for task in workers.tasks} == {(77, 5, 0.5)}
    others = workers.tasks[4:]
    assert [task.estimator for task in others] == [*ESTIMATORS[1:], *[ESTIMATORS[0]] * 5]
    # A network is trained for the layout of the own model; the others are placed anew.
    own_mm = (10.0, 20.0, 30.0, 40.0)
    assert [task.kept_mm for task in others] == [own_mm] * 2 + [()] * 5
    assert [task.scene.sensors.noise_mm for task in others[2:6]] == pytest.approx([0.001, 0.002, 0.008, 0.016])
    assert [task.scene.requirements.latency_ms for task in others[5:]] == [30.0, 60.0]
    assert found.own.task is workers.tasks[2]
    assert workers.followed == [found.own]
    assert [model.task for model in found.models] == workers.tasks
    assert [one.answer.readings for one in found.since_touch] == [2, 4]
    # Thirteen steps: eleven models, the touches, and the times of inferences.
    shares = [number / 13 for number in range(1, 13)]
    assert [share for _, share in steps] == pytest.approx(shares)
    assert [text for text, _ in steps] == ["measuring models"] * 11 + ["following touches"]


def test_points_are_the_answers_of_models_that_build_makes_of_the_scene_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """Known after the readings, a transfer of 13 bytes and two a channel at 0.1 Mbyte a second, and an inference."""
    found = measured(monkeypatch, Workers())
    assert [(point.model.sensors, point.readings) for point in found.points] == [
        (sensors, readings) for sensors in (2, 3, 4, 5, 4, 4) for readings in (2, 4)
    ]
    for place, point in enumerate(found.points):
        readings, since_ms, error_mm = ANSWERS[place % 2]
        latency_ms = since_ms + (13 + 2 * point.model.sensors) / 100 + (50 + place // 2) / 1e3
        assert point.latency_ms == pytest.approx(latency_ms)
        assert (point.periods, point.error_mm.value) == (readings, error_mm)
    # Nothing is gained by more than two sensors here, nor by another estimator.
    assert [(point.model.sensors, point.readings) for point in found.front] == [(2, 2), (2, 4)]
    assert [time.value for time in found.inference_us] == [50.0 + place for place in range(11)]


def test_a_transfer_that_takes_more_than_half_a_period_is_one_more(monkeypatch: pytest.MonkeyPatch) -> None:
    found = measured(monkeypatch, Workers())
    slow = [Measurement(7000.0 + place, 1.0) for place in range(11)]
    monkeypatch.setattr(traded, "inference_times", lambda _: slow)
    later = trade(SCENE, ESTIMATORS, draws=7, seed=1, spread=Workers(), progress=lambda *_: None)
    assert [point.periods for point in found.points[:2]] == [2, 4]
    assert [point.periods for point in later.points[:2]] == [3, 5]


def test_failures_are_kept_and_the_first_one_is_the_reason_if_nothing_can_be_placed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = measured(monkeypatch, Workers(lambda task: task.sensors == 3 or task.varied == "latency"))
    assert [(one.varied, one.sensors) for one in found.failures] == [("sensors", 3), ("latency", 4)]
    assert len(found.models) == 9
    with pytest.raises(SceneError, match=r"^no room for 2$"):
        measured(monkeypatch, Workers(lambda _: True))


@pytest.mark.parametrize(
    ("count", "wanted_mm", "fails", "own"),
    [
        (4, 3.5, (), 4),  # as the scene states
        (4, None, (4,), 5),  # or the most that can be placed
        ((2, 6), 3.0, (), 4),  # the fewest whose limit, 12 mm over their number, is enough
        ((2, 6), 2.9, (), 5),
        ((2, 6), 3.0, (4,), 5),
        ((2, 6), 1.9, (), 6),
        ((2, 6), None, (), 6),
    ],
)
def test_the_own_model_is_the_one_that_build_makes(
    monkeypatch: pytest.MonkeyPatch,
    count: int | tuple[int, int],
    wanted_mm: float | None,
    fails: tuple[int, ...],
    own: int,
) -> None:
    scene = change_scene(SCENE, sensors={"count": count}, requirements={"position_error_mm": wanted_mm})
    workers = Workers(lambda task: task.varied == "sensors" and task.sensors in fails)
    found = measured(monkeypatch, workers, scene, ESTIMATORS[:1])
    assert found.own.sensors == own
    assert [task.sensors for task in workers.tasks if task.varied != "sensors"] == [own] * 5
    assert "estimator" not in {task.varied for task in workers.tasks}
