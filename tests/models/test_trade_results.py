"""What a trade says, in sentences, rows and JSON, of models whose figures are known."""

from dataclasses import replace

import pytest

from beamtouch_models.design.accuracy.limit import Reached
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.since_touch import Answer
from beamtouch_models.design.charts import Chart, draw_row
from beamtouch_models.design.printing import Table
from beamtouch_models.design.scene import change_scene, parse_scene
from beamtouch_models.lab.trade import results
from beamtouch_models.lab.trade.measure import (
    AnswerAtTime,
    Failure,
    MeasuredModel,
    Task,
    Varied,
    numbers_of_sensors,
    with_noises,
    with_twice_the_latency,
)
from beamtouch_models.lab.trade.results import blocks, json_of, picture, sentences
from beamtouch_models.lab.trade.trade import (
    Point,
    Trade,
    UnreachableTargetError,
    most_accurate,
    pareto_front,
    quickest,
    transfer_ms,
)
from beamtouch_models.names import EstimatorName
from beamtouch_models.runtime.metadata_parts import FilterChoice
from support.pages.tags import Tags
from support.surfaces.example_scenes import PAPER

SCENE = change_scene(parse_scene(PAPER, "plain"), requirements={"latency_ms": 30.0})
WITHOUT_LATENCY = parse_scene(PAPER, "plain")


def a_model(
    varied: Varied = "sensors",
    sensors: int = 4,
    error_mm: float = 5.0,
    *,
    scatter_mm: float = 0.05,
    reading_um: float = 8.0,
    latency_ms: float = 30.0,
    estimator: EstimatorName = "posterior",
) -> MeasuredModel:
    """A model on a beam of 400 mm, with an accuracy limit of 4.6 mm."""
    scene = change_scene(SCENE, requirements={"latency_ms": latency_ms})
    task = Task(scene, varied, sensors, 100, 0, estimator)
    places = tuple(50.0 * (number + 1) for number in range(sensors))
    error, limit = Measurement(error_mm, scatter_mm), Measurement(4.6, 0.03)
    reached = Reached(error, limit, Measurement(error_mm / 4.6, 0.012))
    return MeasuredModel(task, places, reading_um / 1e3, FilterChoice(window=4), 400.0, reached, (), b"graph")


def answer(readings: int, since_ms: float, error_mm: float, ringing_mm: float | None = None) -> Answer:
    ringing = None if ringing_mm is None else Measurement(ringing_mm, 0.4)
    return Answer(readings, since_ms, Measurement(error_mm, 0.06), ringing)


def moment(readings: int, since_ms: float, error_mm: float, ringing_mm: float | None = None) -> AnswerAtTime:
    return AnswerAtTime(answer(readings, since_ms, error_mm, ringing_mm), Measurement(error_mm - 0.7, 0.02))


OWN = a_model()
MOMENTS = (moment(1, 5.4326, 9.1, 31.0), moment(OWN.filter.window, 12.3456, 5.2, 17.3), moment(40, 212.43, 2.3, 2.4))
OTHERS: tuple[tuple[MeasuredModel, str], ...] = (
    (a_model(sensors=5, error_mm=4.0), "1 sensor more (5): saves 20 ± 1 %"),
    (a_model(sensors=3, error_mm=7.0), "1 sensor fewer (3): costs 40 ± 2 %"),
    (a_model(sensors=2, error_mm=20.0), "2 sensors fewer (2): costs 300 ± 4 %"),
    (a_model(sensors=7, error_mm=5.04), "3 sensors more (7): no difference beyond its standard error, 1 %."),
    (a_model("noise", reading_um=2.0, error_mm=2.5), "A quarter of the noise of a reading: saves 50 ± 1 %"),
    (a_model("noise", reading_um=4.0, error_mm=3.0), "Half the noise of a reading: saves 40 ± 1 %"),
    (a_model("noise", reading_um=16.0, error_mm=6.0), "Twice the noise of a reading: costs 20 ± 2 %"),
    (a_model("noise", reading_um=32.0, error_mm=9.0), "Four times the noise of a reading: costs 80 ± 2 %"),
    (a_model("noise", reading_um=12.0, error_mm=6.0), "1.5 times the noise of a reading: costs 20 ± 2 %"),
    (a_model("latency", latency_ms=60.0, error_mm=4.0), "Twice the latency (60 ms): saves 20 ± 1 %"),
)  # fmt: skip
NETWORK = a_model("estimator", error_mm=6.9, estimator="paper-network")


def traded(*others: MeasuredModel, own: MeasuredModel = OWN, moments: tuple[AnswerAtTime, ...] = MOMENTS) -> Trade:
    models = (own, *others)
    times = tuple(Measurement(17.0 + 11 * number, 0.3) for number in range(len(models)))
    points = tuple(Point(model, 8, model.reached.error_mm, 41.236 + number, 9) for number, model in enumerate(models))
    failure = Failure("sensors", 6, "posterior", "no room for it")
    return Trade(own, models, times, (failure,), moments, points, points[:2])


@pytest.mark.parametrize(("model", "said"), OTHERS)
def test_a_sentence_says_what_a_change_is_worth(model: MeasuredModel, said: str) -> None:
    first, worth, *_ = sentences(traded(model))
    assert first == (
        "4 sensors give a mean error of 5.00 ± 0.05 mm once the mean has settled; the limit is 4.60 ± 0.03 mm."
    )
    assert worth.removesuffix(" of the error.") == said


@pytest.mark.parametrize(
    ("reading_um", "said"), [(4.03, "Half the"), (4.05, "0.51 times the"), (2.03, "A quarter of the")]
)
def test_a_noise_that_steps_of_the_adc_hardly_change_is_told_as_it_was_meant(reading_um: float, said: str) -> None:
    (_, worth, *_) = sentences(traded(a_model("noise", reading_um=reading_um, error_mm=3.0)))
    assert worth == f"{said} noise of a reading: saves 40 ± 1 % of the error."


def test_scatter_of_either_model_counts_in_what_a_change_is_worth() -> None:
    for scatters in ((0.3, 0.05), (0.05, 0.3)):
        own, other = (
            a_model(sensors=4 + more, scatter_mm=scatters[more], error_mm=5.0 - 0.25 * more) for more in (0, 1)
        )
        (_, worth, *_) = sentences(traded(other, own=own))
        assert worth == "1 sensor more (5): no difference beyond its standard error, 6 %."


def test_a_scene_without_a_latency_is_told_of_two_readings() -> None:
    own = replace(OWN, task=replace(OWN.task, scene=WITHOUT_LATENCY))
    other = a_model("latency", latency_ms=20.0, error_mm=4.0)
    (_, worth, *_) = sentences(traded(other, own=own))
    assert worth == "A latency of two readings (20 ms): saves 20 ± 1 % of the error."


def test_sentences_tell_of_ringing_of_waiting_and_of_other_estimators() -> None:
    *_, rings, waits, network = sentences(traded(NETWORK))
    assert rings == (
        "While the beam rings after a sudden force, the error is 17.3 ± 0.4 mm after 12.3 ms, instead of "
        "5.20 ± 0.06 mm."
    )
    assert waits == (
        "The first answer comes 5.43 ms after a touch with 9.10 ± 0.06 mm; after 212 ms at rest the error is "
        "2.30 ± 0.06 mm."
    )
    assert network == (
        "paper-network: an inference takes 28 µs instead of 17, and the error is 1.50 ± 0.01 times the limit instead "
        "of 1.09 ± 0.01."
    )
    slow = replace(traded(NETWORK), inference_us=(Measurement(123.4, 1.0), Measurement(4567.8, 2.0)))
    assert "an inference takes 4600 µs instead of 120, and" in sentences(slow)[-1]
    still = (moment(OWN.filter.window, 12.5, 5.2),)
    assert len(sentences(traded(moments=still))) == 1


def test_tables_have_a_row_for_each_model_moment_and_point_of_the_front() -> None:
    trade = traded(OTHERS[0][0], NETWORK)
    told = blocks(trade, "my scene.toml", 3, "out.onnx")
    models, moments, front = (block for block in told if isinstance(block, Table))
    assert [list(row) for row in models.rows] == [
        ["-", "4", "posterior", "8", str(OWN.filter.window), "5.00 ± 0.05", "1.09 ± 0.01", "17.0 ± 0.3"],
        ["sensors", "5", "posterior", "8", str(OWN.filter.window), "4.00 ± 0.05", "0.87 ± 0.01", "28.0 ± 0.3"],
        ["estimator", "4", "paper-network", "8", str(OWN.filter.window), "6.90 ± 0.05", "1.50 ± 0.01", "39.0 ± 0.3"],
    ]
    assert [list(row) for row in moments.rows] == [
        ["5.433", "1", "31.0 ± 0.4", "9.10 ± 0.06", "8.40 ± 0.02"],
        ["12.35", str(OWN.filter.window), "17.3 ± 0.4", "5.20 ± 0.06", "4.50 ± 0.02"],
        ["212.4", "40", "2.4 ± 0.4", "2.30 ± 0.06", "1.60 ± 0.02"],
    ]
    assert [list(row) for row in front.rows] == [
        ["4", "posterior", "8", "41.2", "5.00 ± 0.05"],
        ["5", "posterior", "8", "42.2", "4.00 ± 0.05"],
    ]
    assert any("2 of 3 points" in str(block) for block in told)
    assert told[-1] == [
        ("design-sensors build 'my scene.toml' --sensors 4 --seed 3 -o out.onnx",),
        ("design-sensors build 'my scene.toml' --sensors 5 --seed 3 -o out.onnx",),
    ]
    network = replace(trade, front=(trade.points[2],))
    assert blocks(network, "a.toml", 0, "out.onnx")[-1] == [
        ("design-sensors build a.toml --sensors 4 -o out.onnx",),
        ("design-sensors build a.toml --sensors 4 --estimator paper-network -o out.onnx",),
    ]


def test_json_has_errors_in_percent_of_the_length_and_which_points_are_on_the_front() -> None:
    found = json_of(traded(OTHERS[0][0], NETWORK))
    own, five, _ = found["models"]
    assert (own["changed"], five["changed"]) == (None, "sensors")
    assert own["error_percent"] == pytest.approx({"value": 1.25, "standard_error": 0.0125})
    assert own["limit_percent"] == pytest.approx({"value": 1.15, "standard_error": 0.0075})
    assert (own["error_mm"], own["reading_mm"], own["bytes"]) == (5.0, 0.008, 5)
    assert five["inference_us"] == {"value": 28.0, "standard_error": 0.3}
    assert five["positions_mm"] == [50, 100, 150, 200, 250]
    assert [point["on_front"] for point in found["points"]] == [True, True, False]
    assert found["points"][1]["error_percent"] == pytest.approx({"value": 1.0, "standard_error": 0.0125})
    assert (found["points"][1]["latency_ms"], found["points"][1]["readings"]) == (42.236, 8)
    assert found["failures"] == [
        {"varied": "sensors", "sensors": 6, "estimator": "posterior", "reason": "no room for it"}
    ]
    assert found["since_touch"][0]["limit_mm"]["value"] == pytest.approx(8.4)


def test_models_that_measure_the_same_keep_the_times_of_their_own() -> None:
    twin = a_model()
    trade = traded(twin)
    assert [trade.time_of(model).value for model in (trade.own, twin)] == [17.0, 28.0]


def test_a_failure_is_told_in_a_line() -> None:
    failure = Failure("noise", 6, "paper-network", "no room for it")
    assert str(failure) == "6 sensors, paper-network, another noise: no room for it"


def test_a_frame_takes_its_bytes_at_a_million_baud() -> None:
    """PROTOCOL.md: 13 bytes and two per channel, each of ten bits on the line."""
    assert transfer_ms(4) == pytest.approx(0.21)
    assert transfer_ms(9) == pytest.approx(0.31)
    assert json_of(traded())["models"][0]["poll_ms"] == pytest.approx(0.21)


def test_noises_are_in_order_in_the_picture_and_the_own_model_has_a_ring() -> None:
    trade = traded(*(model for model, _ in OTHERS), NETWORK)
    assert [model.reading_mm for model in trade.varied("noise")] == [0.002, 0.004, 0.008, 0.012, 0.016, 0.032]
    drawn = picture("strip", trade)
    assert "Mean position error of strip with its standard error" in drawn
    assert len(Tags(drawn).of("polyline")) > 6
    assert drawn.count("while it rings") == 1
    assert picture("strip", traded(moments=(moment(OWN.filter.window, 12.5, 5.2),))).count("while it rings") == 0


def point(latency_ms: float, error_mm: float, sensors: int, periods: int, scatter_mm: float = 0.01) -> Point:
    model = a_model(sensors=sensors, error_mm=error_mm)
    return Point(model, 3, Measurement(error_mm, scatter_mm), latency_ms, periods)


def test_ties_of_a_choice_fall_to_the_faster_point_and_to_fewer_sensors() -> None:
    slow, fast, many = point(12.0, 2.0, 4, 3), point(11.0, 2.0, 4, 3), point(10.5, 3.0, 6, 3)
    assert most_accurate([slow, fast, many], 12.0) is fast
    assert most_accurate([slow, fast, many], 10.5) is many
    assert quickest([many, slow, fast], 3.0) is fast
    assert quickest([slow, fast, many, point(14.0, 2.5, 2, 2)], 3.0).model.sensors == 2
    with pytest.raises(
        UnreachableTargetError, match=r"no point answers within 10 ms; the fastest takes 10\.5 ms; raise"
    ):
        most_accurate([slow, fast, many], 10.0)
    with pytest.raises(UnreachableTargetError, match=r"no point has a mean error of 1\.5 mm; the best has 2 mm; allow"):
        quickest([many, slow, fast], 1.5)


def test_the_front_is_in_order_of_sensors_and_then_of_time() -> None:
    points = [point(9.0, 1.0, 5, 9), point(12.0, 1.5, 3, 12), point(7.0, 3.0, 3, 7), point(30.0, 1.0, 5, 30)]
    assert pareto_front(points) == [points[2], points[1], points[0]]


def test_errors_within_their_scatter_do_not_differ_on_the_front() -> None:
    # The standard error of a difference of two of 0.03 and 0.04 is 0.05.
    near, alike, worse = (
        point(9.0, mm, n, 9, scatter) for mm, n, scatter in ((1.0, 5, 0.03), (1.049, 4, 0.04), (1.051, 4, 0.04))
    )
    assert pareto_front([near, alike]) == [alike]
    assert pareto_front([near, worse]) == [worse, near]


def test_a_touch_known_in_the_same_period_is_known_at_the_same_time() -> None:
    sooner, better = point(9.0, 1.0, 4, 9), point(9.4, 0.5, 4, 9)
    assert pareto_front([sooner, better]) == [better]
    assert pareto_front([sooner, replace(better, periods=10)]) == [sooner, replace(better, periods=10)]


@pytest.mark.parametrize(
    ("sensors", "numbers"),
    [
        ("count = 6", [4, 5, 6, 7]),
        ("count = 3", [2, 3, 4]),
        ("count = 5\nfixed_mm = [50, 120, 200, 300]", [4, 5, 6]),
        ("count = [3, 6]", [3, 4, 5, 6]),
    ],
)
def test_numbers_around_the_stated_one_are_measured(sensors: str, numbers: list[int]) -> None:
    assert numbers_of_sensors(parse_scene(PAPER.replace("count = 2", sensors), "scene")) == numbers


def test_noise_and_latency_are_changed_by_factors() -> None:
    noisy = parse_scene(PAPER.replace("noise_percent_of_max = 2", "noise_mm = 0.03\nrate_hz = 40"), "scene")
    assert [one.sensors.noise_mm for one in with_noises(noisy)] == pytest.approx([0.0075, 0.015, 0.06, 0.12])
    assert with_twice_the_latency(noisy).requirements.latency_ms == pytest.approx(50.0)
    assert with_twice_the_latency(SCENE).requirements.latency_ms == pytest.approx(60.0)
    assert with_noises(parse_scene(PAPER.replace("percent_of_max = 2", "mm = 0"), "scene")) == []


def test_charts_leave_room_beside_numbers_of_sensors_and_times_and_noises_fill_their_axis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn = list[Chart]()

    def draw(charts: list[Chart], says: str) -> str:
        drawn.extend(charts)
        return draw_row(charts, says)

    monkeypatch.setattr(results, "draw_row", draw)
    picture("press-7", traded(a_model(sensors=5, error_mm=4.0), *(model for model, _ in OTHERS[4:8]), NETWORK))
    sensors, since, noise, inference = drawn
    assert (sensors.x_range, sensors.log_x, sensors.whole_x) == ((3.5, 5.5), False, True)
    assert (noise.x_range, noise.log_x, noise.whole_x) == (None, True, False)
    assert (since.x_range, since.log_x) == (None, True)
    # The own model takes 17 us, and the network, which comes last of seven, 83 us.
    assert inference.x_range == pytest.approx((17 / 1.5, 83 * 1.5))
    assert all(chart.log_y for chart in drawn)
