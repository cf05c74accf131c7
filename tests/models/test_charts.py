"""Charts: points where their values are, round ticks, bars of errors, and text that is only text."""

import re

import numpy as np
import pytest

from beamtouch_models.design.charts import (
    HEIGHT,
    LEFT,
    RIGHT,
    WIDTH,
    Chart,
    Series,
    draw,
    draw_row,
    round_ticks,
    standalone,
)
from support.pages.tags import Tags


@pytest.mark.parametrize(
    ("x", "y", "log"), [([0.0, 1.0, 2.0, 4.0], [0.0, 1.0, 2.0, 4.0], False), ([1.0, 10, 1e4], [0.01, 1, 1e4], True)]
)
def test_points_stand_where_their_values_are(x: list[float], y: list[float], log: bool) -> None:
    svg = draw(Chart("a", "x", "y", [Series("", x, y, style="points")], log_x=log, log_y=log))
    circles = np.array(re.findall(r'cx="([\d.]+)" cy="([\d.]+)" r="3.5"/>', svg), dtype=float)
    for pixels, values in zip(circles.T, (np.array(x), np.array(y)), strict=True):
        places = np.log(values) if log else values
        expected = pixels[0] + (places - places[0]) / (places[-1] - places[0]) * (pixels[-1] - pixels[0])
        assert pixels == pytest.approx(expected, abs=0.11)
    assert circles[0, 1] > circles[-1, 1]
    assert log or (circles[0, 0], circles[-1, 0]) == (LEFT, WIDTH - RIGHT)
    assert not log or {"1", "10", "100"} <= set(Tags(svg).text)


@pytest.mark.parametrize(
    ("low", "high", "least", "expected"),
    [
        (0.0, 400.0, 0.0, (0, 100, 200, 300, 400)),
        (-55.57, -55.44, 0.0, (-55.55, -55.5, -55.45)),
        (0.0, 1.2e-9, 0.0, (0, 2e-10, 4e-10, 6e-10, 8e-10, 1e-9, 1.2e-9)),
        (1e6, 1e6 + 3, 0.0, (1e6, 1e6 + 0.5, 1e6 + 1, 1e6 + 1.5, 1e6 + 2, 1e6 + 2.5, 1e6 + 3)),
        (1.8, 5.2, 1.0, (2, 3, 4, 5)),  # a count has whole ticks
    ],
)
def test_ticks_are_round(low: float, high: float, least: float, expected: tuple[float, ...]) -> None:
    assert round_ticks(low, high, least) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("values", [[3.0], [0.0, 0.0]])
def test_values_without_a_spread_still_make_a_chart(values: list[float]) -> None:
    svg = draw(Chart("a", "x", "y", [Series("flat", list(range(len(values))), values)]))
    assert "nan" not in svg
    assert Tags(svg).of("polyline")


def test_labels_are_text_and_a_long_legend_takes_rows() -> None:
    series = [Series(f"</svg> a curve with a long name {i}", [0, 1], [0, i]) for i in range(6)]
    tags = Tags(standalone(draw(Chart('<b>"&', "<i>", "y & z", series))))
    assert tags.of("svg")[0]["aria-label"] == '<b>"&'
    assert {"<i>", "y & z", series[0].label} <= set(tags.text)
    assert not tags.of("b")
    assert float(tags.of("svg")[0]["viewbox"].split()[3]) > HEIGHT


def test_a_row_of_charts_has_one_vertical_axis_one_legend_and_bars_of_a_standard_error() -> None:
    since = Series("model", [1.0, 3.0, 20.0, 1000.0], [4.0, 2.0, 1.0, 0.5], errors=[0.5, 0.1, 0.1, 0.0])
    counted = [Series("model", [2.0, 3.0, 4.0, 5.0], [4.0, 2.0, 1.0, 0.5]), Series("own", [4.0], [1.0], style="ring")]
    limit = Series("limit", [1.0, 1000.0], [0.4, 0.4], 1, "dashed")
    noise = [Series("model", [1200.0, 19200.0], [4.0, 1.0])]
    svg = draw_row(
        [
            Chart("a", "sensors", "error, mm", counted, log_y=True, whole_x=True),
            Chart("b", "since a touch, ms", "error, mm", [since, limit], log_x=True, log_y=True),
            Chart("c", "noise, µm", "error, mm", noise, log_x=True, log_y=True),
        ],
        "all",
    )
    tags = Tags(svg)
    assert len({(frame["y"], frame["height"]) for frame in tags.of("rect", "frame")}) == 1
    assert [tags.text.count(label) for label in ("model", "limit", "own", "error, mm")] == [1, 1, 1, 1]
    curves = [re.findall(r",([\d.]+)", line["points"]) for line in tags.of("polyline")]
    curves = [curve for curve in curves if len(curve) > 1]
    assert curves[0][2] == curves[1][2] == curves[3][1]  # 1 mm stands at the same height in each
    per_ratio = (float(curves[0][2]) - float(curves[0][0])) / np.log(4)
    bars = [re.match(r"M[\d.]+ ([\d.]+)V([\d.]+)M", one["d"]) for one in tags.of("path")]
    assert len(bars) == 3  # none where the error is 0
    for bar, value, error in zip(bars, (4.0, 2.0, 1.0), (0.5, 0.1, 0.1), strict=True):
        assert bar is not None
        low, high = map(float, bar.groups())
        assert low - high == pytest.approx(per_ratio * np.log((value + error) / (value - error)), abs=0.2)
