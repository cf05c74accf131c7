"""Charts: points where their values are, round ticks, and text that is only text."""

import re

import numpy as np
import pytest

from beamtouch_models.charts import HEIGHT, LEFT, RIGHT, WIDTH, Chart, Series, draw, round_ticks
from beamtouch_models.svg import standalone
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
