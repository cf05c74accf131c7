"""Charts: points where their values are, round ticks, and text that is only text."""

import re

import numpy as np
import pytest

from beamtouch_models.charts import (
    CHARACTER,
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
from tags import Tags


def circles(chart: Chart) -> list[tuple[float, float]]:
    svg = draw(chart)
    return [(float(x), float(y)) for x, y in re.findall(r'cx="([\d.]+)" cy="([\d.]+)" r="3.5"/>', svg)]


def test_points_stand_where_their_values_are() -> None:
    points = circles(Chart("a", "x", "y", [Series("", [0, 1, 2, 4], [0, 1, 2, 4], style="points")]))
    x, y = np.array(points).T
    assert (x[0], x[-1]) == (LEFT, WIDTH - RIGHT)
    assert x[1] - x[0] == pytest.approx((x[3] - x[0]) / 4, abs=0.1)
    assert y[0] - y[1] == pytest.approx((y[0] - y[3]) / 4, abs=0.1)
    assert (np.diff(y) < 0).all()


def test_logarithmic_axes_space_by_ratio() -> None:
    series = [Series("", [1, 10, 100], [0.01, 1, 100], style="points")]
    x, y = np.array(circles(Chart("a", "x", "y", series, log_x=True, log_y=True))).T
    assert x[1] - x[0] == pytest.approx(x[2] - x[1], abs=0.11)
    assert y[1] - y[0] == pytest.approx(y[2] - y[1], abs=0.11)
    assert {"1", "10", "100"} <= set(Tags(draw(Chart("a", "x", "y", series, log_x=True, log_y=True))).text)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0, 400.0, (0, 100, 200, 300, 400)),
        (0.0, 1.0, (0, 0.2, 0.4, 0.6, 0.8, 1)),
        (-55.57, -55.44, (-55.55, -55.5, -55.45)),
        (0.0, 1.2e-9, (0, 2e-10, 4e-10, 6e-10, 8e-10, 1e-9, 1.2e-9)),
        (1e6, 1e6 + 3, (1e6, 1e6 + 0.5, 1e6 + 1, 1e6 + 1.5, 1e6 + 2, 1e6 + 2.5, 1e6 + 3)),
    ],
)
def test_ticks_are_round(low: float, high: float, expected: tuple[float, ...]) -> None:
    assert round_ticks(low, high) == pytest.approx(expected, rel=1e-12)


def test_whole_numbers_get_whole_ticks() -> None:
    assert round_ticks(1.8, 5.2, 1.0) == pytest.approx((2, 3, 4, 5))


@pytest.mark.parametrize("values", [[3.0], [0.0, 0.0], [5.0, 5.0, 5.0]])
def test_values_without_a_spread_still_make_a_chart(values: list[float]) -> None:
    svg = draw(Chart("a", "x", "y", [Series("flat", list(range(len(values))), values)]))
    assert "nan" not in svg
    assert Tags(svg).of("polyline")


def test_a_long_legend_takes_rows_and_the_plot_keeps_its_height() -> None:
    series = [Series(f"a curve with a long name {i}", [0, 1], [0, i]) for i in range(6)]
    tags = Tags(draw(Chart("a", "x", "y", series)))
    (frame,) = tags.of("rect", "frame")
    (bare,) = Tags(draw(Chart("a", "x", "y", [Series("", [0, 1], [0, 1])]))).of("rect", "frame")
    assert frame["height"] == bare["height"]
    assert float(tags.of("svg")[0]["viewbox"].split()[3]) > HEIGHT


def test_labels_are_text() -> None:
    tags = Tags(standalone(draw(Chart('<b>"&', "<i>", "y & z", [Series("</svg>", [0, 1], [0, 1])]))))
    assert tags.of("svg")[0]["aria-label"] == '<b>"&'
    assert {"<i>", "y & z", "</svg>"} <= set(tags.text)
    assert not tags.of("b")
    assert len(tags.of("style")) == 1


def row_of_charts() -> str:
    wide = Series("model", [1.0, 3.0, 20.0, 1000.0], [4.0, 2.0, 1.0, 0.5], errors=[0.5, 0.1, 0.1, 0.0])
    counted = Series("model", [2.0, 3.0, 4.0, 5.0], [4.0, 2.0, 1.0, 0.5])
    limit = Series("limit", [1.0, 1000.0], [0.4, 0.4], 1, "dashed")
    charts = [
        Chart(
            "a", "sensors", "error, mm", [counted, Series("own", [4.0], [1.0], style="ring")], log_y=True, whole_x=True
        ),
        Chart("b", "since a touch, ms", "error, mm", [wide, limit], log_x=True, log_y=True),
        Chart("c", "noise, µm", "error, mm", [Series("model", [1200.0, 19200.0], [4.0, 1.0])], log_x=True, log_y=True),
    ]
    return draw_row(charts, "all")


def test_a_row_of_charts_has_one_vertical_axis_and_one_legend() -> None:
    svg = row_of_charts()
    tags = Tags(svg)
    assert len({(frame["y"], frame["height"]) for frame in tags.of("rect", "frame")}) == 1
    assert len(tags.of("rect", "frame")) == 3
    assert [tags.text.count(label) for label in ("model", "limit", "own", "error, mm")] == [1, 1, 1, 1]
    # 1 mm stands at the same height in each.
    curves = [
        re.findall(r"[\d.]+,([\d.]+)", line["points"]) for line in tags.of("polyline") if line["points"].count(",") > 1
    ]
    assert curves[0][2] == curves[1][2] == curves[3][1]


def test_bars_reach_a_standard_error_to_either_side() -> None:
    tags = Tags(row_of_charts())
    paths = [one["d"] for one in tags.of("path")]
    assert len(paths) == 3  # none where the error is 0
    for path, value, error in zip(paths, (4.0, 2.0, 1.0), (0.5, 0.1, 0.1), strict=True):
        found = re.match(r"M[\d.]+ ([\d.]+)V([\d.]+)M", path)
        assert found is not None
        low, high = map(float, found.groups())
        four, one = (float(y) for y in re.findall(r"[\d.]+,([\d.]+)", tags.of("polyline")[0]["points"])[0:3:2])
        per_ratio = (one - four) / np.log(4)
        assert low - high == pytest.approx(per_ratio * np.log((value + error) / (value - error)), abs=0.2)


def test_labels_of_a_row_do_not_overprint() -> None:
    boxes = []
    for x, y, anchor, text in re.findall(
        r'<text x="([\d.]+)" y="([\d.]+)"(?: text-anchor="(\w+)")?>([^<]*)</text>', row_of_charts()
    ):
        width = CHARACTER * len(text)
        left = float(x) - {"middle": width / 2, "end": width}.get(anchor, 0.0)
        boxes.append((left, left + width, float(y), text))
    assert len(boxes) > 15
    for number, (left, right, y, text) in enumerate(boxes):
        for other_left, other_right, other_y, other in boxes[:number]:
            assert abs(y - other_y) >= 11 or right <= other_left or other_right <= left, (text, other)
