"""The pictures of a plate from above, to the pixel: layout, supports, ruler, maps of values and regions."""

import re
from math import degrees
from typing import Any

import numpy as np
import pytest

from beamtouch_models import change_scene, read_scene
from beamtouch_models.design.building.report.plate_pictures import (
    FromAbove,
    Map,
    Region,
    draw_maps,
    draw_regions,
    plate_drawing,
)
from beamtouch_models.design.scene import Scene
from beamtouch_models.runtime.metadata_parts import Channel, Ranges
from support.pages.paths import strokes_of
from support.pages.tags import Tags
from support.surfaces.example_scenes import SCENES
from support.surfaces.small_model import PLATE_OUTPUTS, model_of

WIDTH, MARGIN, LOWER, GAP, TITLE = 640, 48, 52, 40, 22
"""As on a drawing on squared paper, in px."""
PX = (WIDTH - 2 * MARGIN) / 400
"""Of a plate of 400 by 300 mm, whose picture is as wide as it may be: 408 px high at most, and 408 it is."""
BOTTOM = MARGIN / 2 + 300 * PX


def scene_with(plate: dict[str, Any] | None = None, sensors: dict[str, Any] | None = None) -> Scene:
    return change_scene(read_scene(SCENES / "plate-on-springs.toml"), plate=plate or {}, sensors=sensors or {})


def draw(scene: Scene, *places: tuple[float, float]) -> tuple[Tags, str]:
    layout = [Channel(name=f"s{i}", position_mm=x, across_mm=y) for i, (x, y) in enumerate(places, start=1)]
    stated = model_of(outputs=PLATE_OUTPUTS).metadata
    ranges = Ranges(position_mm=(10, 390), across_mm=(20, 280), force_n=(1, 20))
    drawing, caption = plate_drawing(scene, stated.model_copy(update={"layout": layout, "ranges": ranges}))
    return Tags(drawing), caption


def box(rect: dict[str, str]) -> list[float]:
    """Left, right, bottom and top in mm on the plate."""
    x, y, width, height = (float(rect[name]) for name in ("x", "y", "width", "height"))
    return [(x - MARGIN) / PX, (x + width - MARGIN) / PX, (BOTTOM - y - height) / PX, (BOTTOM - y) / PX]


def test_a_plate_is_as_wide_as_the_drawing_or_three_quarters_of_that_high() -> None:
    wide = FromAbove.within((400.0, 100.0), 10.0, 20.0, 200.0)
    assert (wide.factor, wide.left, wide.right, wide.top, wide.bottom) == (0.5, 10, 210, 20, 70)
    high = FromAbove.within((100.0, 400.0), 10.0, 20.0, 200.0)
    assert (high.factor, high.right, high.bottom) == (0.375, 47.5, 170)
    assert (wide.x(100.0), wide.y(30.0)) == (60.0, 55.0)
    assert 'x="60.0" y="35.0" width="30.0" height="20.0"' in wide.area("", (100.0, 160.0), (30.0, 70.0))
    assert 'x="10.0" y="20.0" width="200.0" height="50.0"' in wide.whole("")


def test_the_drawing_shows_plate_contacts_and_what_is_kept_free() -> None:
    kept = [{"x_mm": [150.0, 250.0], "y_mm": [100.0, 180.0]}, {"x_mm": [20.0, 58.2], "y_mm": [30.0, 90.0]}]
    tags, caption = draw(scene_with(sensors={"keep_out": kept}), (40.0, 50.0))
    for name in ("plate", "rim"):
        (rect,) = tags.of("rect", name)
        assert box(rect) == pytest.approx([0, 400, 0, 300], abs=0.1)
    (contacts,) = tags.of("rect", "contacts")
    assert box(contacts) == pytest.approx([10, 390, 20, 280], abs=0.1)
    first, second = tags.of("rect", "keepout")
    assert box(first) == pytest.approx([150, 250, 100, 180], abs=0.1)
    assert box(second) == pytest.approx([20, 58.2, 30, 90], abs=0.1)
    labels = [each for each in tags.of("text") if each.get("text-anchor") == "middle" and float(each["y"]) < BOTTOM]
    assert tags.text.count("keep out") == len(labels) == 1  # 38.2 mm are 51.95 px, too few for it
    assert float(labels[0]["x"]) == pytest.approx(MARGIN + 200 * PX, abs=0.06)
    assert float(labels[0]["y"]) == pytest.approx(BOTTOM - 140 * PX + 4, abs=0.06)
    assert caption == "dashed: contacts lie within; supports are zigzags; shaded with a word: no sensors there"
    kept[1]["x_mm"] = [20.0, 58.3]  # 52.09 px
    assert draw(scene_with(sensors={"keep_out": kept}), (40.0, 50.0))[0].text.count("keep out") == 2
    (svg,) = tags.of("svg")
    assert svg["aria-label"] == "The plate from above, 400 by 300 mm, to scale. Sensors: s1 at 40, 50 mm."
    assert svg["viewbox"] == f"0 0 {WIDTH} {BOTTOM + LOWER:g}"


def test_sensors_are_as_wide_as_their_housings_with_labels_that_stay_on_the_plate() -> None:
    places = [(15.0, 145.0), (205.0, 15.0), (195.0, 285.0), (385.0, 155.0)]
    scene = scene_with(sensors={"fixed": [{"x_mm": 205.0, "y_mm": 15.0}]})
    tags, _ = draw(scene, *places)
    circles = tags.of("circle", "sensor")
    labels = [each for each in tags.of("text") if float(each["y"]) < BOTTOM and float(each["x"]) > MARGIN]
    names = ["s1 15, 145", "s2 (fixed) 205, 15", "s3 195, 285", "s4 385, 155"]
    assert [text for text in tags.text if text.startswith("s")] == names
    assert ["fixed" in circle["class"] for circle in circles] == [False, True, False, False]
    for circle, label, (x, y) in zip(circles, labels, places, strict=True):
        radius = 6 * PX
        centre = MARGIN + x * PX, BOTTOM - y * PX
        assert (float(circle["cx"]), float(circle["cy"]), float(circle["r"])) == pytest.approx(
            (*centre, radius), abs=0.06
        )
        side = 1 if x < 200 else -1
        assert label["text-anchor"] == ("start" if x < 200 else "end")
        assert float(label["x"]) == pytest.approx(centre[0] + side * (radius + 4), abs=0.06)
        above = centre[1] - radius - 6 if y < 150 else centre[1] + radius + 16
        assert float(label["y"]) == pytest.approx(above, abs=0.06)
    tiny, _ = draw(scene_with(sensors={"size_mm": 1}), (40.0, 50.0))
    assert tiny.of("circle", "sensor")[0]["r"] == "3.0"


def test_a_ruler_runs_along_both_edges() -> None:
    tags, _ = draw(scene_with(), (40.0, 50.0))
    ticks = [strokes_of(path["d"])[0] for path in tags.of("path", "thin")]
    below, beside = ticks[:5], ticks[5:]
    assert [start[0] for start, _ in below] == pytest.approx(MARGIN + PX * np.arange(0, 401, 100), abs=0.06)
    for start, end in below:
        assert (start[0], end[1] - start[1]) == (end[0], 5)
        assert start[1] == pytest.approx(BOTTOM + 2, abs=0.06)
    assert [start[1] for start, _ in beside] == pytest.approx(BOTTOM - PX * np.arange(0, 301, 50), abs=0.06)
    for start, end in beside:
        assert (start, end) == ((MARGIN - 2, start[1]), (MARGIN - 7, start[1]))
    words = [text for text in tags.text if text.strip()][-13:]
    assert words == ["0", "100", "200", "300", "400", "0", "50", "100", "150", "200", "250", "300", "x and y in mm"]
    labels = tags.of("text")[-13:]
    assert [float(label["x"]) for label in labels[:5]] == [start[0] for start, _ in below]
    assert {float(label["y"]) for label in labels[:5]} == {round(BOTTOM + 31, 1)}
    assert {(float(label["x"]), label["text-anchor"]) for label in labels[5:-1]} == {(MARGIN - 10, "end")}
    assert [float(label["y"]) - 4 for label in labels[5:-1]] == pytest.approx(
        [start[1] for start, _ in beside], abs=0.11
    )
    last = labels[-1]
    assert (float(last["x"]), float(last["y"]), last["text-anchor"]) == (WIDTH - MARGIN, round(BOTTOM + 46, 1), "end")


def shape_at(tags: Tags, x_mm: float, y_mm: float) -> list[tuple[float, float]]:
    """The stroke of a support at a point, from there."""
    at = MARGIN + x_mm * PX, BOTTOM - y_mm * PX
    (stroke,) = (
        strokes[0]
        for path in tags.of("path", "support")
        for strokes in [strokes_of(path["d"])]
        if np.allclose(strokes[0][0], at, atol=0.06)
    )
    return [(round(x - stroke[0][0], 1), round(y - stroke[0][1], 1)) for x, y in stroke]


def test_springs_are_zigzags_rigid_supports_triangles_and_lines_lines() -> None:
    springs, told = draw(scene_with(), (40.0, 50.0))
    assert told == "dashed: contacts lie within; supports are zigzags"
    start, *turns, last, end = shape_at(springs, 400, 300)
    assert start == (0, 0)
    assert [x for x, _ in (last, end)] == [0, 0]
    sides = [x for x, _ in turns[1:]]
    assert sides == [7, -7, 7]
    heights = [y for _, y in (start, *turns, last, end)]
    assert heights == sorted(heights)
    assert turns[0][0] == 0
    assert heights[1] - heights[0] == heights[-1] - heights[-2]  # straight ends of the same length
    assert heights[2] - heights[1] == heights[-2] - heights[-3]
    rigid, told = draw(scene_with({"support_stiffness_n_per_mm": None}), (40.0, 50.0))
    assert told == "dashed: contacts lie within; supports are triangles"
    apex, right, left, closed = shape_at(rigid, 0, 300)
    assert apex == closed == (0, 0)
    assert right[0] == -left[0] == 7
    assert right[1] == left[1] == 11.2
    point = {"x_mm": 100.0, "y_mm": 200.0}
    supports = [{"x_mm": 0.0}, {"y_mm": 90.0}, {"x_mm": 300.0, "y_mm": 200.0, "stiffness_n_per_mm": 8.0}, point]
    mixed, told = draw(scene_with({"supports": supports, "support_stiffness_n_per_mm": None}), (40.0, 50.0))
    assert told == "dashed: contacts lie within; supports are triangles, on springs zigzags, thick lines"
    lines = [strokes_of(path["d"])[0] for path in mixed.of("path", "support") if "L" in path["d"]]
    ends = [[((x - MARGIN) / PX, (BOTTOM - y) / PX) for x, y in line] for line in lines]
    assert np.sort(np.array(ends), axis=1) == pytest.approx(
        np.array([[[0, 0], [0, 300]], [[0, 90], [400, 90]]]), abs=0.1
    )


def test_lines_are_the_thicker_the_more_they_hold() -> None:
    lines = {"support_stiffness_n_per_mm": None, "supports": [{"x_mm": 0.0}, {"x_mm": 300.0, "y_mm": 200.0}]}
    tags, _ = draw(scene_with(lines), (40.0, 50.0))
    assert [path["stroke-width"] for path in tags.of("path", "support")] == ["4", "1.6"]
    assert [tags.of("rect", name)[0]["stroke-width"] for name in ("rim", "contacts")] == ["1.4", "1.2"]


def test_maps_stand_side_by_side_and_row_by_row_under_their_titles() -> None:
    edges = np.linspace(0, 400, 3), np.linspace(0, 300, 3)
    maps = [Map(f"map {number}", edges, np.arange(4.0)) for number in range(3)]
    tags = Tags(draw_maps(maps, (400.0, 300.0), "three", across=2))
    width = WIDTH / 2
    factor = (width - GAP) / 400
    frames = tags.of("rect", "frame")
    height = TITLE + 300 * factor + 14
    for number, frame in enumerate(frames):
        row, column = divmod(number, 2)
        place = [float(frame[name]) for name in ("x", "y", "width", "height")]
        assert place == pytest.approx(
            [column * width + GAP / 2, row * height + TITLE, width - GAP, 300 * factor], abs=0.06
        )
    titles = [
        each for each, text in zip(tags.of("text"), [t for t in tags.text if t.strip()], strict=True) if "map" in text
    ]
    assert [float(title["x"]) for title in titles] == [width / 2, 1.5 * width, width / 2]
    assert [float(title["y"]) for title in titles] == pytest.approx(
        [TITLE - 7, TITLE - 7, height + TITLE - 7], abs=0.06
    )
    assert tags.of("svg")[0]["viewbox"] == f"0 0 {WIDTH} {2 * height:g}"
    one = Tags(draw_maps(maps[:1], (400.0, 300.0), "one"))
    assert float(one.of("rect", "frame")[0]["width"]) == WIDTH - GAP


def shades(values: list[float]) -> list[str]:
    edges = np.linspace(0, 400, len(values) + 1), np.array([0.0, 300.0])
    return re.findall(r'opacity="([\d.]+)"', draw_maps([Map("", edges, np.array(values))], (400.0, 300.0), "shades"))


def test_a_map_is_the_darker_the_larger_its_value() -> None:
    assert shades([2.0, 4.0, 3.0, np.nan, 2.6]) == ["0.06", "0.60", "0.33", "0.22"]
    assert shades([5.0, 5.0]) == ["0.06", "0.06"]
    assert shades([np.nan, np.nan]) == []


def test_a_map_prints_its_values_where_they_have_room_and_marks_a_place() -> None:
    edges = np.array([0.0, 19.9, 40.1, 400.0]), np.array([0.0, 100.0, 300.0])
    values = np.array([1.0, 2.0, 31.4159, 4.0, np.nan, 6.0])
    tags = Tags(draw_maps([Map("title", edges, values, marked_mm=(100.0, 60.0))], (400.0, 300.0), "numbers"))
    factor, top = (WIDTH - GAP) / 400, TITLE
    texts = [text for text in tags.text if text.strip()]
    assert texts == ["title", "31", "4", "-", "6"]  # 19.9 mm are 29.85 px, 20.2 mm are 30.3
    labels = tags.of("text")[1:]
    bottom = top + 300 * factor
    expected = [(30, 50), (30, 200), (220.05, 50), (220.05, 200)]
    for label, (x, y) in zip(labels, expected, strict=True):
        assert float(label["x"]) == pytest.approx(GAP / 2 + x * factor, abs=0.06)
        assert float(label["y"]) == pytest.approx(bottom - y * factor + 4, abs=0.06)
    (ring,) = tags.of("circle")
    assert (ring["r"], ring["stroke-width"]) == ("5", "1.5")
    assert float(ring["cx"]) == pytest.approx(GAP / 2 + 100 * factor, abs=0.06)
    assert float(ring["cy"]) == pytest.approx(bottom - 60 * factor, abs=0.06)
    bare = Tags(draw_maps([Map("title", edges, values, with_numbers=False)], (400.0, 300.0), "none"))
    assert [text for text in bare.text if text.strip()] == ["title"]
    assert bare.of("circle") == []


@pytest.mark.parametrize(
    ("deviation_mm", "times"),
    [(1.0, 10), (1.3, 10), (1.31, 5), (2.6, 5), (2.62, 2), (6.5, 2), (6.6, 1), (80.0, 1), (0.0129, 1000)],
)
def test_regions_are_drawn_larger_by_one_two_or_five_and_tens(deviation_mm: float, times: float) -> None:
    """So that the longest, of 2 times 2.4477 deviations, has at most 0.16 of 400 mm."""
    _, drawn = draw_regions([Region((200, 150), 10, (deviation_mm, 0.3 * deviation_mm), 0.0)], (400.0, 300.0), "a")
    assert drawn == pytest.approx(times)


def test_regions_lie_at_their_places_turned_against_the_clock_and_those_of_weak_forces_are_dashed() -> None:
    regions = [
        Region((120.0, 80.0), 20.0, (2.0, 1.0), 0.0),
        Region((300.0, 220.0), 3.0, (2.0, 2.0), 0.6),
        Region((200.0, 150.0), 20.0, (1.0, 1e-9), 0.0),
    ]
    picture, times = draw_regions(regions, (400.0, 300.0), "regions")
    tags, bottom = Tags(picture), 12 + 300 * PX
    ellipses, dots = tags.of("ellipse"), tags.of("circle")
    for ellipse, dot, region in zip(ellipses, dots, regions, strict=True):
        x, y = MARGIN + region.place_mm[0] * PX, bottom - region.place_mm[1] * PX
        assert (float(ellipse["cx"]), float(ellipse["cy"])) == pytest.approx((x, y), abs=0.06)
        assert (float(dot["cx"]), float(dot["cy"])) == pytest.approx((x, y), abs=0.06)
        turned = re.findall(r"rotate\((-?[\d.]+) ([\d.]+) ([\d.]+)\)", ellipse["transform"])[0]
        assert (float(turned[1]), float(turned[2])) == pytest.approx((x, y), abs=0.06)
        slant = -float(turned[0]) % 180
        assert slant == pytest.approx(degrees(region.semi_axes_mm[2]) % 180, abs=0.06)
        long, short = (max(1.0, half * times * PX) for half in region.semi_axes_mm[:2])
        assert (float(ellipse["rx"]), float(ellipse["ry"])) == pytest.approx((long, short), abs=0.06)
    assert -float(re.findall(r"rotate\((-?[\d.]+)", ellipses[1]["transform"])[0]) % 180 == 45
    assert ["stroke-dasharray" in ellipse for ellipse in ellipses] == [False, True, False]
    assert {ellipse["stroke-width"] for ellipse in ellipses} == {"1.6"}
    assert ["stroke-s0" in ellipse["class"] for ellipse in ellipses] == [True, False, True]
    assert float(ellipses[2]["ry"]) == 1.0
    (frame,) = tags.of("rect", "frame")
    assert [float(frame[name]) for name in ("x", "y", "width", "height")] == pytest.approx(
        [MARGIN, 12, 400 * PX, 300 * PX], abs=0.06
    )
    assert tags.of("svg")[0]["viewbox"] == f"0 0 {WIDTH} {bottom + LOWER:g}"
    assert "x and y in mm" in tags.text
