"""Where the parts of a chart stand, beside distances taken from a drawing on squared paper, all in px.

A chart is 640 by 340, and its frame reaches from 64 to 624 and from 14 to 294. Each row of the legend pushes the frame
18 down. Panels of a row are 215 by 240 and 14 apart, and their axes keep 7 from either side.
"""

import re
from collections.abc import Sequence

import numpy as np
import pytest

from beamtouch_models.design.charts import DARK, LIGHT, Chart, Series, draw, draw_row, fill, standalone, stroke
from support.pages.tags import Tags

FOUR_X, FOUR_Y = [0.0, 50.0, 400.0], [0.0, 3.0, 5.0]


def chart_of(*series: Series, **axes: object) -> str:
    return draw(Chart("says", "x, mm", "y, N", series, **axes))  # type: ignore[arg-type]


def texts_in(svg: str) -> dict[str, tuple[float, float]]:
    """Where each text stands, the last of those that are the same."""
    found = re.findall(r'<text x="([-\d.]+)" y="([-\d.]+)"[^>]*>([^<]*)</text>', svg)
    return {text: (float(x), float(y)) for x, y, text in found}


def lines_in(svg: str) -> list[tuple[float, float, float, float]]:
    """The ends of the lines of the grid: x1, x2, y1, y2."""
    grid = Tags(svg).of("line", "grid")
    return [(float(one["x1"]), float(one["x2"]), float(one["y1"]), float(one["y2"])) for one in grid]


def labels_beside(svg: str) -> list[str]:
    """The labels of the vertical axis, from below."""
    return re.findall(r'text-anchor="end">([^<]*)</text>', svg)


def labels_below(svg: str, y: float) -> list[str]:
    """The labels of the horizontal axis, from the left."""
    return re.findall(rf'y="{y:g}" text-anchor="middle">([\d.e+-]+)</text>', svg)


def test_a_chart_has_its_frame_its_grid_and_its_labels_where_they_belong() -> None:
    svg = chart_of(Series("", FOUR_X, FOUR_Y, style="points"))
    tags = Tags(svg)
    assert tags.of("svg")[0]["viewbox"] == "0 0 640 340"
    (frame,) = tags.of("rect", "frame")
    assert [frame[name] for name in ("x", "y", "width", "height")] == ["64", "14", "560", "280"]
    # 0 is an end of the vertical axis; the other one leaves 4 % above the largest value.
    across = [(tick, 64 + 1.4 * tick) for tick in (0, 100, 200, 300, 400)]
    up = [(tick, 294 - 280 * tick / 5.2) for tick in range(6)]
    expected = [(px, px, 294, 14) for _, px in across] + [(64, 624, px, px) for _, px in up]
    assert np.array(lines_in(svg)) == pytest.approx(np.array(expected), abs=0.051)
    texts = texts_in(svg)
    assert texts["x, mm"] == (344, 332)
    assert '<text transform="translate(15 154) rotate(-90)" text-anchor="middle">y, N</text>' in svg
    for tick, px in across[1:]:
        assert texts[f"{tick}"] == pytest.approx((px, 311), abs=0.051)
    for tick, px in up[1:]:
        assert texts[f"{tick}"] == pytest.approx((58, px + 4), abs=0.051)
    circles = [(float(one["cx"]), float(one["cy"])) for one in tags.of("circle")]
    expected_px = [(64 + 1.4 * x, 294 - 280 * y / 5.2) for x, y in zip(FOUR_X, FOUR_Y, strict=True)]
    assert np.array(circles) == pytest.approx(np.array(expected_px), abs=0.051)


def test_a_legend_takes_a_new_row_where_a_label_would_pass_the_frame() -> None:
    fits, too_long = "l" * 37, "l" * 38
    known = (Series("model", [1, 2], [1, 2], style="dashed"), Series("of the paper", [1], [1], 3, "points"))
    marked = (Series("", [1], [1]), Series("found", [1], [1], style="ring"))
    for last, place in ((fits, (348.8 + 32, 18)), (too_long, (96, 36))):
        svg = chart_of(*known, *marked, Series(last, [1, 2], [2, 1], 2), Series("z", [1], [1]))
        texts = texts_in(svg)
        assert [texts[name] for name in ("model", "of the paper", "found")] == [(96, 18), (176, 18), (300.8, 18)]
        assert texts[last] == pytest.approx(place)
        tags = Tags(svg)
        assert tags.of("rect", "frame")[0]["y"] == "50"
        assert tags.of("svg")[0]["viewbox"] == "0 0 640 376"
        keys = [one for one in tags.of("line", "line") if "grid" not in one["class"]]
        assert [keys[0][name] for name in ("x1", "x2", "y1", "y2")] == ["64.0", "90.0", "14.0", "14.0"]
        assert keys[0]["stroke-dasharray"] == "6 4"
        assert "stroke-dasharray" not in keys[1]
        circles = tags.of("circle")[-2:]
        assert [(one["cx"], one["cy"], one["r"]) for one in circles] == [
            ("157.0", "14.0", "3.5"),
            ("281.8", "14.0", "7"),
        ]
        assert "fill-s3" in circles[0]["class"]
        # The next label follows the last: a key of 34, 6.4 a character, and 14 between two.
        after = texts[last][0] + 34 + 6.4 * len(last) + 14
        assert texts["z"] == pytest.approx((96, 36) if last == fits else (after, 36))


def test_a_row_has_its_panels_side_by_side_and_the_numbers_of_the_vertical_axis_once() -> None:
    one = Chart("a", "first", "y, N", [Series("m", [0.0, 60.0], [1.0, 2.0])])
    other = Chart("b", "second", "y, N", [Series("m", [100.0, 700.0], [1.0, 2.0])], x_range=(100.0, 700.0))
    svg = draw_row([one, other], "both")
    tags, texts = Tags(svg), texts_in(svg)
    assert tags.of("svg")[0]["viewbox"] == "0 0 524 318"
    frames = [(each["x"], each["y"], each["width"], each["height"]) for each in tags.of("rect", "frame")]
    assert frames == [("71", "32", "201", "240"), ("300", "32", "201", "240")]
    assert (texts["first"], texts["second"]) == ((171.5, 310), (400.5, 310))
    assert texts["60"] == pytest.approx((272, 289))
    assert texts["100"] == pytest.approx((300, 289))
    beside = labels_beside(svg)
    assert len(beside) == len(set(beside)) > 2
    assert len([line for line in lines_in(svg) if line[2] == line[3]]) == 2 * len(beside)
    (title,) = re.findall(r"translate\(15 ([\d.]+)\)", svg)
    assert float(title) == 152
    curves = [curve["points"] for curve in tags.of("polyline")]
    assert [re.findall(r"([\d.]+),", points) for points in curves] == [["71.0", "272.0"], ["300.0", "501.0"]]
    assert curves[0].split(",")[1:2] != curves[0].split(",")[2:]


@pytest.mark.parametrize(
    ("y", "options", "ends"),
    [
        ([2.0, 4.5], {}, (1.9, 4.6)),  # 4 % of the range to either side
        ([2.0, 4.5], {"y_from_zero": True}, (0.0, 4.68)),
        ([-3.0, 2.0], {"y_from_zero": True}, (-3.2, 2.2)),
        ([3.0, 3.0], {}, (1.38, 4.62)),  # half of a lone value to either side
        ([-4.0, -4.0], {}, (-6.16, -1.84)),
        ([0.0, 0.0], {}, (-0.54, 0.54)),
        ([2.0, 50.0], {"log_y": True}, (2 / 1.15, 50 * 1.15)),
        ([0.0, 2.0, 50.0], {"log_y": True}, (2 / 1.15, 50 * 1.15)),  # nothing has no logarithm
    ],
)
def test_the_vertical_axis_spans_the_values_with_a_little_room(
    y: Sequence[float], options: dict[str, bool], ends: tuple[float, float]
) -> None:
    svg = chart_of(Series("", [float(place) for place in range(len(y))], y, style="points"), **options)
    values = np.maximum(np.array(y), ends[0])
    low, high = np.log(ends) if options.get("log_y") else ends
    places = np.log(values) if options.get("log_y") else values
    found = [float(one["cy"]) for one in Tags(svg).of("circle")]
    assert found == pytest.approx(294 - 280 * (places - low) / (high - low), abs=0.051)


def test_bars_reach_a_standard_error_to_either_side_and_end_at_the_axis() -> None:
    svg = chart_of(Series("", [0.0, 1.0, 3.0], [4.0, 2.0, 2.5], 4, errors=[0.5, 0.0, 0.25]))
    px = [294 - 280 * (value - 1.9) / 2.7 for value in (3.5, 4.5, 2.25, 2.75)]
    bars = [re.findall(r"-?[\d.]+", one["d"]) for one in Tags(svg).of("path")]
    pixels = [[float(number) for number in bar] for bar in bars]
    expected = [
        [at, low, high, at - 3, low, 6, -6, high - low, 6]
        for at, low, high in ((64.0, px[0], px[1]), (624.0, px[2], px[3]))
    ]
    assert np.array(pixels) == pytest.approx(np.array(expected), abs=0.11)
    assert all("stroke-s4" in one["class"] and one["stroke-width"] == "1.2" for one in Tags(svg).of("path"))
    # On a logarithmic axis, what would reach below nothing ends at the axis.
    svg = chart_of(Series("", [0.0, 1.0], [1.0, 50.0], errors=[1.5, 0.0]), log_y=True)
    (bar,) = Tags(svg).of("path")
    _, low, *_ = (float(number) for number in re.findall(r"-?[\d.]+", bar["d"]))
    assert low == pytest.approx(294, abs=0.051)


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [
        (1.3, 80.0, "2 5 10 20 50"),
        (2.4, 500.0, "5 10 20 50 100 200 500"),
        (1.3, 5000.0, "10 100 1000"),
        (0.5, 2000.0, "1 10 100 1000"),
        (2.0, 5e6, "10 100 1000 10000 100000 1e+06"),
        (2e-9, 5e6, "1e-07 1e-05 0.001 0.1 10 1000 100000"),
        (2e-12, 5e12, "1e-09 1e-06 0.001 1 1000 1e+06 1e+09 1e+12"),
    ],
)
def test_a_logarithmic_axis_has_powers_of_ten_and_twos_and_fives_where_there_is_room(
    low: float, high: float, labels: str
) -> None:
    svg = chart_of(Series("", [0.0, 1.0], [low * 1.15, high / 1.15]), log_y=True)
    assert labels_beside(svg) == labels.split()


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0.0, 6.003, 7),  # a thousandth more than six steps are six
        (0.0, 6.012, 4),
        (0.30000000000000004, 0.7, 5),  # the ends are ticks in spite of rounding
        (0.0, 11.0, 6),
        (0.0, 25.0, 6),
        (0.0, 55.0, 6),
    ],
)
def test_about_six_steps_of_one_two_five_or_ten(low: float, high: float, ticks: int) -> None:
    svg = chart_of(Series("", [low, high], [0.0, 1.0]))
    assert len([line for line in lines_in(svg) if line[0] == line[1]]) == ticks


@pytest.mark.parametrize(
    ("first", "expected"),
    [
        (100, "100 200 300 400 500 600 700"),
        (10_000, "10000 10200 10400 10600"),
    ],
)
def test_labels_that_would_touch_are_left_out(first: float, expected: str) -> None:
    """In a panel of 201 px a hundred takes 33.5 px, three digits and room for two characters 32 px."""
    svg = draw_row([Chart("a", "x", "y", [Series("", [first, first + 600], [0.0, 1.0])])], "one")
    assert labels_below(svg, 271) == expected.split()


def test_lines_and_points_have_the_colour_of_their_series_on_paper_and_on_a_dark_screen() -> None:
    svg = chart_of(
        Series("", [0, 1], [0, 1], 6), Series("", [0, 1], [1, 0], 7, "points"), Series("", [0.5], [0.5], style="ring")
    )
    tags = Tags(svg)
    (curve,) = tags.of("polyline")
    assert (curve["class"], curve["stroke"], curve["fill"]) == ("line stroke-s6", "#a8175b", "none")
    assert (curve["stroke-width"], curve["stroke-linejoin"]) == ("1.8", "round")
    *points, ring = tags.of("circle")
    assert {(point["class"], point["fill"], point["r"]) for point in points} == {("fill-s7", "#0e7c86", "3.5")}
    assert (ring["class"], ring["stroke"], ring["stroke-width"], ring["r"]) == (
        "line stroke-ink",
        "#1b1f24",
        "1.5",
        "7",
    )
    assert [grid["stroke-width"] for grid in tags.of("line", "grid")][:1] == ["1"]
    assert fill("s0", "one", "two") == 'class="one two fill-s0" fill="#0b62a8"'
    assert stroke("muted", width=2.5) == 'class="stroke-muted" fill="none" stroke="#59636e" stroke-width="2.5"'
    assert list(DARK) == list(LIGHT)
    alone = standalone(svg)
    for name, colour in DARK.items():
        assert f".fill-{name} {{ fill: {colour}; }} .stroke-{name} {{ stroke: {colour}; }}\n" in alone
    assert alone.count("</title><style>@media screen and (prefers-color-scheme: dark) {\n") == 1
    assert alone.startswith('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 640 340"')
    assert alone.endswith("</svg>\n")
    assert '</style><rect class="fill-ground" fill="#ffffff" width="100%" height="100%"/>' in alone
