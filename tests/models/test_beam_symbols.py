"""The symbols of a beam's drawing, to the pixel: supports, foundation, contacts, ruler, and how thick it is drawn."""

import numpy as np
import pytest

from beamtouch_models import make_scene
from beamtouch_models.design.building.build import draw_beam
from beamtouch_models.design.building.report.beam_drawing import Scale, beam_drawing
from beamtouch_models.design.scene import Scene, change_scene, parse_scene
from beamtouch_models.runtime.metadata_parts import BeamDrawing, Channel
from support.pages.paths import strokes_of
from support.pages.tags import Tags
from support.surfaces.example_scenes import PAPER
from support.surfaces.small_model import model_of

Stroke = list[tuple[float, float]]
WIDTH, HEIGHT, MARGIN, BEAM_Y, SCALE_Y = 900, 236, 48, 92, 200
"""As on a drawing on squared paper, in px; the underside of the beam and the ruler from above."""
SENSOR_HEIGHT, BENT_PX = 24, 24
PX = (WIDTH - 2 * MARGIN) / 400


def scene_with(beam: str, rest: str = "", force_n: str = "10.0", thickness: str = "thickness_mm = 3") -> Scene:
    text = PAPER.replace("[beam]", f"[beam]\n{beam}").replace("count = 2", f"count = 2\n{rest}")
    text = text.replace("thickness_mm = 3", thickness).replace("force_n = 10.0", f"force_n = {force_n}")
    return parse_scene(text, "x.toml")


def draw(scene: Scene, *positions: float) -> tuple[Tags, str]:
    layout = [Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(positions or (100.0, 300.0), start=1)]
    metadata = model_of().metadata.model_copy(update={"layout": layout, "drawn": draw_beam(scene)})
    drawing, caption = beam_drawing(scene, metadata)
    return Tags(drawing), caption


def symbol(support: str, other: str = "{ at_mm = 400 }", at_mm: float = 0.0) -> list[Stroke]:
    """The strokes of one support, with x from it and y from the underside of the beam."""
    tags, _ = draw(scene_with(f"supports = [{support}, {other}]"))
    (drawn,) = (
        strokes
        for path in tags.of("path", "support")
        for strokes in [strokes_of(path["d"])]
        if abs(np.mean([x for stroke in strokes for x, _ in stroke]) - MARGIN - at_mm * PX) < 25
    )
    at = round(MARGIN + at_mm * PX, 1)
    return [[(round(x - at, 1), round(y - BEAM_Y, 1)) for x, y in stroke] for stroke in drawn]


def assert_ground(strokes: list[Stroke], y: float, middle: float = 0.0, *, down: float = 1.0) -> None:
    """A level line, about a middle, with four even hatches at 45 degrees below it, from its right end to the left."""
    (left, right), *hatches = strokes
    assert left[1] == right[1] == y
    assert (left[0] - middle, right[0] - middle) == (-13, 13)
    assert [start[0] - middle for start, _ in hatches] == [-8, -1, 6, 13]
    for (x, start_y), (end_x, end_y) in hatches:
        assert (start_y, end_x - x, end_y - y) == (y, -5, 5 * down)


def test_a_pin_is_a_triangle_below_the_beam_on_the_ground() -> None:
    triangle, *ground = symbol('{ at_mm = 0, kind = "simple", slides = false }')
    apex, left, right, closed = triangle
    assert apex == closed == (0, 0)
    assert (left, right) == ((-9, 16), (9, 16))
    assert_ground(ground, 16)


def test_a_roller_is_a_circle_between_the_beam_and_the_ground() -> None:
    circle, *ground = symbol("{ at_mm = 0 }")
    left, right, closed = circle
    assert left == closed
    assert (left, right) == ((-8, 8), (8, 8))  # its radius below the beam
    assert_ground(ground, 16)


def test_a_spring_against_turning_is_an_arc_with_an_arrow() -> None:
    arc, head = symbol("{ at_mm = 0, fixity = 0.5 }")[-2:]
    start, end, one_side = arc
    assert (start, end) == ((-14, 2), (14, 2))
    assert head[0] == end
    assert (one_side[0] - end[0], one_side[1] - end[1]) == (4, 4)
    assert head[1][0] < end[0]
    assert head[1][1] > end[1]
    assert len(symbol("{ at_mm = 0 }")) + 2 == len(symbol("{ at_mm = 0, fixity = 0.5 }"))


@pytest.mark.parametrize(("at_mm", "outwards"), [(0.0, -1), (400.0, 1), (150.0, 1)])
def test_a_clamp_is_a_wall_across_the_beam_with_hatches_outside(at_mm: float, outwards: int) -> None:
    other = "{ at_mm = 250 }"
    wall, *hatches = symbol(f'{{ at_mm = {at_mm}, kind = "fixed" }}', other, at_mm)
    (top_x, top), (bottom_x, bottom) = wall
    assert top_x == bottom_x == 0
    assert top < -3 * PX < 0 < bottom
    assert (bottom, -top) == (20, 28)
    assert [start for start, _ in hatches] == [(0, top + 8 * step) for step in range(6)]
    for start, end in hatches:
        assert end[0] == 8 * outwards
        assert 0 < end[1] - start[1] < 8


@pytest.mark.parametrize(("at_mm", "inwards"), [(0.0, 1), (400.0, -1)])
def test_a_clamp_that_can_slide_holds_the_beam_between_rollers(at_mm: float, inwards: int) -> None:
    other = "{ at_mm = 200 }"
    strokes = symbol(f'{{ at_mm = {at_mm}, kind = "fixed", slides = true }}', other, at_mm)
    circles, below, above = strokes[:4], strokes[4:9], strokes[9:]
    top = -round(3 * PX, 1)
    centres = sorted(((left[0] + right[0]) / 2, left[1]) for left, right, _ in circles)
    radius = (circles[0][1][0] - circles[0][0][0]) / 2
    middle = 9.0 * inwards
    assert radius == 4
    assert all((right[0] - left[0]) / 2 == pytest.approx(radius) for left, right, _ in circles)
    assert sorted({round(y, 1) for _, y in centres}) == pytest.approx([top - radius, radius], abs=0.11)
    assert sorted({round(abs(x), 1) for x, _ in centres}) == [3, 15]
    assert_ground(below, 2 * radius, middle)
    assert_ground(above, round(top - 2 * radius, 1), middle, down=-1)


def test_a_foundation_is_a_row_of_forty_one_springs_below_the_whole_beam() -> None:
    tags, caption = draw(scene_with("foundation_n_mm2 = 0.5"))
    (path,) = (each for each in tags.of("path", "support") if "opacity" in each)
    springs = strokes_of(path["d"])
    assert len(springs) == 41
    assert [spring[0][0] for spring in springs] == pytest.approx(np.linspace(MARGIN, WIDTH - MARGIN, 41), abs=0.06)
    for start, *turns in springs:
        assert start[1] == BEAM_Y
        assert [y - BEAM_Y for _, y in turns] == [3, 6, 9, 12]
        assert [round(x - start[0], 1) for x, _ in turns] == [3, -3, 3, 0]
    assert "It lies on an elastic foundation" in caption
    assert not [each for each in draw(scene_with(""))[0].of("path", "support") if "opacity" in each]


def test_five_arrows_press_on_the_beam_over_the_extent_of_the_contacts() -> None:
    tags, _ = draw(scene_with("", force_n="[2.0, 20.0]"))
    bracket, *shafts = (strokes_of(path["d"]) for path in tags.of("path", "touch"))
    left, left_up, right_up, right = bracket[0]
    ends = [round(MARGIN + at * PX, 1) for at in (1, 399)]
    assert ([left[0], left_up[0]], [right[0], right_up[0]]) == ([ends[0]] * 2, [ends[1]] * 2)
    assert [y for _, y in bracket[0]] == [38, 32, 32, 38]
    assert [shaft[0][0][0] for shaft in shafts] == pytest.approx(np.linspace(ends[0], ends[1], 5), abs=0.06)
    heads = [strokes_of(path["d"])[0] for path in tags.of("path", "tip")]
    for (shaft,), (one, other, tip, closed) in zip(shafts, heads, strict=True):
        (x, top), (same_x, bottom) = shaft
        assert x == same_x == tip[0] == (one[0] + other[0]) / 2
        assert top == left_up[1]
        assert one == closed
        assert one[1] == other[1] == 52 < bottom < tip[1] < BEAM_Y - 3 * PX
        assert other[0] - one[0] == tip[1] - one[1]
    (text,) = (each for each in tags.text if each.startswith("contact"))
    assert text == "contact anywhere from 1 to 399 mm, 2 to 20 N"
    (at,) = (float(each["x"]) for each in tags.of("text") if each["y"] == "20")
    assert at == pytest.approx(WIDTH / 2, abs=0.06)
    apart = change_scene(scene_with(""), contact={"position_mm": (20.0, 300.0)})
    assert float(draw(apart)[0].of("text")[4]["x"]) == pytest.approx(MARGIN + 160 * PX, abs=0.06)
    assert (
        "contact anywhere from 1 to 399 mm, 10 N"
        in draw(scene_with("", force_n="10.0\nforce_tolerance_percent = 0"))[0].text
    )


def test_a_ruler_has_round_numbers_below_the_drawing() -> None:
    tags, _ = draw(scene_with(""))
    line, *ticks = tags.of("line", "thin")
    assert (float(line["x1"]), float(line["x2"])) == (MARGIN, WIDTH - MARGIN)
    assert line["y1"] == line["y2"] == str(SCALE_Y)
    assert {tick["y2"] for tick in ticks} == {str(SCALE_Y + 5)}
    assert [float(tick["x1"]) for tick in ticks] == pytest.approx(MARGIN + PX * np.arange(0, 401, 100), abs=0.06)
    assert all(
        tick["x1"] == tick["x2"] and float(tick["y1"]) == float(line["y1"]) < float(tick["y2"]) for tick in ticks
    )
    labels = [each for each in tags.of("text") if float(each["y"]) > float(line["y1"])]
    assert [float(label["x"]) for label in labels[:-1]] == [float(tick["x1"]) for tick in ticks]
    assert [text for text in tags.text if text.strip()][-6:] == ["0", "100", "200", "300", "400", "mm"]
    assert float(labels[-1]["x"]) == WIDTH - 4
    assert {float(label["y"]) for label in labels} == {float(line["y1"]) + 19}
    assert float(line["y1"]) + 19 < HEIGHT


def test_sensors_stand_off_the_beam_each_with_a_line_to_its_name() -> None:
    tags, _ = draw(scene_with("", "size_mm = 12"), 50.0, 120.0, 260.0)
    sensors, lines = tags.of("rect", "sensor"), tags.of("line", "lead")
    labels = [each for each in tags.of("text") if BEAM_Y + 40 < float(each["y"]) < 200]
    assert [each for each in tags.text if each in {"s1", "s2", "s3", "50", "120", "260"}] == [
        "s1",
        "50",
        "s2",
        "120",
        "s3",
        "260",
    ]
    for number, (sensor, line, at_mm) in enumerate(zip(sensors, lines, (50, 120, 260), strict=True)):
        x, name, place = round(MARGIN + at_mm * PX, 1), labels[2 * number], labels[2 * number + 1]
        assert float(sensor["y"]) == pytest.approx(BEAM_Y + 3 * PX, abs=0.06)  # 3 mm off at rest
        assert float(sensor["height"]) == SENSOR_HEIGHT
        assert float(sensor["x"]) + float(sensor["width"]) / 2 == pytest.approx(x, abs=0.1)
        assert (float(line["x1"]), float(line["x2"]), float(name["x"]), float(place["x"])) == (x, x, x, x)
        assert float(line["y1"]) == pytest.approx(float(sensor["y"]) + SENSOR_HEIGHT, abs=0.06)
        assert float(line["y1"]) < float(line["y2"]) == float(name["y"]) - 11
        assert float(place["y"]) == float(name["y"]) + 14
    assert [labels[name]["y"] for name in (0, 2, 4)] == ["148", "178", "148"]
    small = draw(scene_with("", "size_mm = 1"), 50.0)[0].of("rect", "sensor")[0]
    assert float(small["width"]) == 3.0


@pytest.mark.parametrize(("to_mm", "label"), [(225.9, True), (225.8, False)])  # 52.06 and 51.86 px
def test_a_stretch_without_sensors_is_named_where_it_has_room(to_mm: float, label: bool) -> None:
    tags, _ = draw(scene_with("", f"keep_out_mm = [[200, {to_mm}]]"))
    (rect,) = tags.of("rect", "keepout")
    assert float(rect["x"]) == pytest.approx(MARGIN + 200 * PX, abs=0.06)
    assert float(rect["width"]) == pytest.approx((to_mm - 200) * PX, abs=0.06)
    assert float(rect["y"]) == BEAM_Y
    assert ("keep out" in tags.text) == label
    if label:
        (text,) = (each for each in tags.of("text") if float(each["y"]) == BEAM_Y + 36)
        assert float(text["x"]) == pytest.approx(MARGIN + 212.95 * PX, abs=0.06)
        assert rect["height"] == "40.0"


@pytest.mark.parametrize(
    ("thickness_mm", "thicker", "heights_px"),
    [
        ([3.0], 1.0, [6.03]),
        ([1.0], 3 / 2.01, [3.0]),
        ([0.5, 2.0], 3 / 1.005, [3.0, 12.0]),
        ([0.1, 8.0], 40 / 16.08, [1.0, 40.0]),  # the thickest ends at 40 px, the thinnest is seen
        ([0.5, 30.0], 1.0, [1.005, 60.3]),
        ([None], 1.0, [3.0]),
        ([None, 1.0], 3 / 2.01, [3.0, 3.0]),
    ],
)
def test_a_thin_beam_is_drawn_thicker_as_far_as_its_thickest_section_leaves_room(
    thickness_mm: list[float | None], thicker: float, heights_px: list[float]
) -> None:
    px = Scale(400.0, thickness_mm)
    assert px.factor == pytest.approx(2.01)
    assert px.thicker == pytest.approx(thicker)
    assert [px.height(each) for each in thickness_mm] == pytest.approx(heights_px)


def test_a_support_touches_the_section_that_it_holds() -> None:
    beam = scene_with("segments = [{ to_mm = 150, thickness_mm = 3 }, { to_mm = 400, thickness_mm = 5 }]").beam
    px = Scale(400.0, [3.0, 5.0])
    tops = [BEAM_Y - px.top(at_mm, beam) for at_mm in (0.0, 149.0, 151.0, 400.0)]
    assert tops == pytest.approx([3 * PX, 3 * PX, 5 * PX, 5 * PX])


@pytest.mark.parametrize(
    ("force_n", "times"),
    [(1000.0, 1), (10.0, 10), (12.0, 8), (15.0, 6), (19.0, 5), (23.0, 4), (30.0, 3), (40.0, 2), (75.0, 1), (0.3, 300)],
)
def test_a_beam_is_drawn_bent_further_by_a_round_factor(force_n: float, times: float) -> None:
    """10 N bend the middle by F l^3 / (48 E I) = 1.1287 mm, which are 2.27 px, and drawn ten times larger 22.7."""
    scene = scene_with("", force_n=f"{force_n}\nforce_tolerance_percent = 0")
    tags, caption = draw(scene)
    (line,) = tags.of("polyline", "bent")
    points = np.array([pair.split(",") for pair in line["points"].split()], float)
    largest_px = force_n * 400**3 / (48 * 210e3 * 25 * 27 / 12) * PX
    assert points[:, 1].max() - BEAM_Y == pytest.approx(times * largest_px, rel=2e-3, abs=0.06)
    assert points[:, 0] == pytest.approx(np.linspace(MARGIN, WIDTH - MARGIN, len(points)), abs=0.06)
    assert times == 1 or times * largest_px <= BENT_PX
    larger = "to scale" if times == 1 else f"drawn {times} times larger and behind the sensors"
    assert f"Dashed: bent by {force_n:g} N at 200 mm, {larger}. " in caption


def test_the_beam_is_drawn_as_it_bends_most_whichever_way() -> None:
    metadata = model_of().metadata
    bends = [[0.0, 0.3, 0.2], [0.0, -0.5, 0.2], [0.1, 0.4, 0.45]]
    drawn = BeamDrawing(
        at_mm=[0.0, 150.0, 400.0], load_mm=[80.0, 170.0, 260.0], deflection_mm_per_n=bends, supports=[], sensor_mm=12.0
    )
    scene = scene_with("", force_n="2.0\nforce_tolerance_percent = 0")
    drawing, caption = beam_drawing(scene, metadata.model_copy(update={"drawn": drawn}))
    (line,) = Tags(drawing).of("polyline", "bent")
    assert line["stroke-width"] == "1.4"
    points = [[float(number) for number in pair.split(",")] for pair in line["points"].split()]
    expected = [(MARGIN, BEAM_Y), (MARGIN + 150 * PX, BEAM_Y - 10 * PX), (WIDTH - MARGIN, BEAM_Y + 4 * PX)]
    assert np.array(points) == pytest.approx(np.array(expected), abs=0.06)  # 1 mm is 2.01 px, and 20.1 ten times larger
    assert "Dashed: bent by 2 N at 170 mm, drawn 10 times larger and behind the sensors" in caption
    still = drawn.model_copy(update={"deflection_mm_per_n": np.zeros((3, 3)).tolist()})
    drawing, caption = beam_drawing(scene, metadata.model_copy(update={"drawn": still}))
    assert Tags(drawing).of("polyline", "bent") == []
    assert "ashed" not in caption


def test_a_sensor_close_to_the_beam_keeps_a_gap_that_is_seen() -> None:
    metadata = model_of().metadata
    close = metadata.sensor.model_copy(update={"standoff_mm": 0.9})
    drawing, _ = beam_drawing(scene_with(""), metadata.model_copy(update={"sensor": close}))
    assert {sensor["y"] for sensor in Tags(drawing).of("rect", "sensor")} == {"94.0"}


def test_a_measured_structure_is_a_line_whose_supports_are_not_known() -> None:
    rows = [f"{at},{0.01 + at * 1e-5:g},{0.02 - at * 1e-5:g}" for at in range(10, 500, 60)]
    scene = make_scene(
        measured={"influence": "\n".join(["position_mm,a_mm_per_n,b_mm_per_n", *rows]), "length_mm": 500},
        contact={"force_n": [2, 8], "position_mm": [20, 470]},
        sensors={"noise_mm": 0.004, "range_mm": [1, 9]},
    )
    layout = [Channel(name="a", position_mm=80.5), Channel(name="b", position_mm=210.0)]
    drawing, caption = beam_drawing(scene, model_of().metadata.model_copy(update={"layout": layout}))
    tags = Tags(drawing)
    (line,) = tags.of("rect", "beam")
    assert [line[name] for name in ("x", "y", "width", "height")] == ["48.0", "89.0", "804.0", "3.0"]
    (svg,) = tags.of("svg")
    assert svg["viewbox"] == f"0 0 {WIDTH} {HEIGHT}"
    assert svg["aria-label"] == "The structure, 500 mm long, as a line. Sensors: a at 80.5 mm, b at 210 mm."
    assert [float(each["x"]) + float(each["width"]) / 2 for each in tags.of("rect", "sensor")] == pytest.approx(
        [MARGIN + at * 804 / 500 for at in (80.5, 210)], abs=0.1
    )
    assert caption == "The structure as a line: its shape and supports are not known, as its influence was measured"
    assert {"contact anywhere from 20 to 470 mm, 2 to 8 N", "500"} <= set(tags.text)


def test_thickness_is_told_in_words() -> None:
    def told(thicknesses: list[float]) -> str:
        ends = np.linspace(0, 400, len(thicknesses) + 1)[1:]
        parts = ", ".join(
            f"{{ to_mm = {end:g}, thickness_mm = {mm} }}" for end, mm in zip(ends, thicknesses, strict=True)
        )
        return draw(scene_with(f"segments = [{parts}]"))[1].split(". ")[0]

    assert told([4, 3, 4]) == "3 and 4 mm thick"
    assert told([4, 3, 5]) == "3 and 4 and 5 mm thick"
    assert told([4, 3, 5, 6]) == "3 to 6 mm thick, in steps"
    assert told([1.2]) == "1.2 mm thick, drawn 1.2 times thicker"
    bare = {"youngs_modulus_gpa": None, "width_mm": None, "thickness_mm": None, "flexural_rigidity_n_mm2": 1e7}
    assert draw(change_scene(scene_with(""), beam=bare))[1].startswith("Its thickness is not stated. ")
