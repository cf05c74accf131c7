"""The drawing of a beam in the report: supports as they are, thickness, the bent beam, and its caption."""

import pytest

from beamtouch_models.design.building.build import draw_beam
from beamtouch_models.design.building.report.beam_drawing import BENT_PX, HEIGHT, MARGIN, WIDTH, beam_drawing
from beamtouch_models.design.scene import Scene, parse_scene
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.metadata_parts import Channel
from support.pages.tags import Tags
from support.surfaces.example_scenes import PAPER

SUPPORTS = {
    'kind = "simple"': "roller that can turn and slide",
    'kind = "simple", slides = false': "pin that can turn, not slide",
    'kind = "simple", fixity = 0.5': "roller that can turn against a spring and slide",
    'kind = "fixed"': "clamp",
    'kind = "fixed", slides = true': "clamp that can slide",
}


def scene_with(beam: str, rest: str = "") -> Scene:
    return parse_scene(PAPER.replace("[beam]", f"[beam]\n{beam}").replace("count = 2", f"count = 2\n{rest}"), "x.toml")


def draw(bench: ModelFile, scene: Scene, *positions: float) -> tuple[Tags, str]:
    """Return the drawing and its caption."""
    layout = [Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(positions or (100.0, 300.0), start=1)]
    metadata = bench.metadata.model_copy(update={"layout": layout, "drawn": draw_beam(scene)})
    drawing, caption = beam_drawing(scene, metadata)
    return Tags(drawing), caption


def test_each_kind_of_support_has_its_own_symbol_and_words(bench: ModelFile) -> None:
    symbols = set()
    for stated, words in SUPPORTS.items():
        tags, caption = draw(bench, scene_with(f"supports = [{{ at_mm = 0, {stated} }}, {{ at_mm = 400 }}]"))
        first, _ = tags.of("path", "support")
        symbols.add(first["d"])
        for told in (caption, tags.of("svg")[0]["aria-label"]):
            assert f"Supports: at 0 mm a {words}; at 400 mm a roller that can turn and slide" in told
    assert len(symbols) == len(SUPPORTS)


def test_a_thin_beam_is_drawn_thicker_by_the_stated_factor_and_keeps_its_steps(bench: ModelFile) -> None:
    scale = (WIDTH - 2 * MARGIN) / 400
    segments = "segments = [{ to_mm = 150, thickness_mm = 0.5 }, { to_mm = 400, thickness_mm = 1.5 }]"
    tags, caption = draw(bench, scene_with(segments))
    thin, thick = (float(one["height"]) for one in tags.of("rect", "beam"))
    assert thick == pytest.approx(3 * thin, rel=0.05)
    times = float(caption.split("drawn ")[1].split()[0])
    assert caption.startswith(f"0.5 and 1.5 mm thick, drawn {times:g} times thicker. ")
    assert thin == pytest.approx(0.5 * scale * times, rel=0.05)
    assert draw(bench, scene_with(""))[1].startswith("3 mm thick. ")


def test_the_drawing_is_to_scale(bench: ModelFile) -> None:
    rules = "size_mm = 30\nfixed_mm = [100]\nkeep_out_mm = [[200, 240]]"
    (tags, caption), scale = draw(bench, scene_with("", rules), 100.0, 170.0, 330.0), (WIDTH - 2 * MARGIN) / 400
    assert "Shaded: no sensors there" in caption
    sensors, (beam,), (keep_out,) = (tags.of("rect", kind) for kind in ("sensor", "beam", "keepout"))
    assert [float(one["width"]) for one in sensors] == pytest.approx([30 * scale] * 3, abs=0.06)
    middles = [float(one["x"]) + float(one["width"]) / 2 for one in sensors]
    assert middles == pytest.approx([MARGIN + x * scale for x in (100, 170, 330)], abs=0.1)
    assert ["fixed" in one["class"] for one in sensors] == [True, False, False]
    assert float(beam["width"]) == pytest.approx(400 * scale, abs=0.1)
    assert float(beam["height"]) == pytest.approx(3 * scale, abs=0.1)
    gap = float(sensors[0]["y"]) - float(beam["y"]) - float(beam["height"])
    assert gap == pytest.approx(bench.metadata.sensor.standoff_mm * scale, abs=0.2)
    assert float(keep_out["x"]) == pytest.approx(MARGIN + 200 * scale, abs=0.1)
    assert float(keep_out["width"]) == pytest.approx(40 * scale, abs=0.1)
    assert {"s1 (fixed)", "s2", "keep out"} <= set(tags.text)


def test_labels_of_close_sensors_do_not_overlap(bench: ModelFile) -> None:
    tags, _ = draw(bench, scene_with(""), *(10.0 + 12 * i for i in range(8)))
    rows = {float(line["y2"]) for line in tags.of("line", "lead")}
    assert len(tags.of("line", "lead")) == 8
    assert len(rows) == 2
    assert max(rows) + 25 < HEIGHT - 36


@pytest.mark.parametrize("ends", ["simply-supported", "cantilever", "propped"])
def test_the_bent_beam_has_the_shape_of_the_model(bench: ModelFile, ends: str) -> None:
    scene = parse_scene(
        PAPER.replace("[beam]", f'[beam]\nsupports = "{ends}"').replace("10.0", "1.0\nforce_tolerance_percent = 0"),
        "x.toml",
    )
    (tags, caption), shape = draw(bench, scene), draw_beam(scene)
    (line,) = tags.of("polyline", "bent")
    points = [tuple(map(float, pair.split(","))) for pair in line["points"].split()]
    rest = points[0][1]
    depth = [y - rest for _, y in points]
    best = max(shape.deflection_mm_per_n, key=max)
    assert depth == pytest.approx([max(depth) * mm / max(best) for mm in best], abs=0.15)
    assert BENT_PX / 2 <= max(depth) <= BENT_PX + 0.1
    (words,) = (part for part in caption.split(". ") if part.startswith("Dashed: bent by 1 N at "))
    times, scale = float(words.split(", drawn ")[1].split()[0]), (WIDTH - 2 * MARGIN) / 400
    assert max(depth) == pytest.approx(max(best) * scale * times, abs=0.1)
