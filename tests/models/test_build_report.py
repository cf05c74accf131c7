"""The report of a build: one complete page with true statements and without requests to the network."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.accuracy.prior import SampleErrors
from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.building.build import Built
from beamtouch_models.building.report import facts as facts_module
from beamtouch_models.building.report.beam_drawing import HEIGHT, MARGIN, WIDTH, beam_drawing
from beamtouch_models.building.report.facts import Facts, gather
from beamtouch_models.building.report.page import page
from beamtouch_models.metadata import Channel
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.placing import Aim, Placement, place, place_by_position_error
from beamtouch_models.scene import Scene, load_scene, parse_scene
from beamtouch_models.surface import Surface
from example_scenes import PAPER, SCENES
from in_process import Command
from stated_problems import problem_in
from tags import Tags

pytestmark = pytest.mark.long


def built_of(path: Path, model: ModelFile, scene: Scene) -> Built:
    physics = Surface.of(scene, model.metadata.filter)
    placement = place(*problem_in(scene), len(model.metadata.layout), 0)
    return Built(path.read_bytes(), model.metadata, placement, physics, Aim("eigenvalue-product"))


@pytest.fixture(scope="module", autouse=True)
def searched_once() -> Iterator[None]:
    """The search by position error takes seconds; here the same question is asked several times."""
    found: dict[object, Placement] = {}

    def search(
        influence: InfluenceFunction, rules: Candidates, count: int, seed: int, errors: SampleErrors
    ) -> Placement:
        # The scene as the search sees it: all deflections at the places that its rules allow.
        scene = influence.matrix(rules.position_mm).tobytes(), rules.fixed.tobytes(), rules.min_distance_mm
        key = (scene, influence.force_n, influence.position_mm, count, seed, errors)
        found[key] = found.get(key) or place_by_position_error(influence, rules, count, seed, errors)
        return found[key]

    with pytest.MonkeyPatch.context() as remembering:
        remembering.setattr(facts_module, "place_by_position_error", search)
        yield


@pytest.fixture(scope="module")
def facts(bench_model: Path, bench: ModelFile) -> Facts:
    scene, _ = load_scene(SCENES / "bench.toml")
    with pytest.MonkeyPatch.context() as fewer:
        fewer.setattr(facts_module, "PROFILE_DRAWS", 4000)
        fewer.setattr(facts_module, "LAYOUT_DRAWS", 1000)
        return gather(scene, built_of(bench_model, bench, scene), lambda _doing, _done: None)


def test_the_page_is_complete_and_makes_no_requests(facts: Facts) -> None:
    text = page(facts)
    tags = Tags(text)
    assert tags.of("html")[0]["lang"] == "en"
    assert not {"script", "link", "img", "iframe", "object"} & {tag for tag, _ in tags.found}
    assert not re.search(r"https?:|//\w|@import|url\(", text)
    assert not [value for _, attributes in tags.found for name, value in attributes.items() if name in {"src", "href"}]
    assert "prefers-color-scheme: dark" in text
    assert "@media print" in text
    assert not re.search(r"\b(nan|inf|None)\b", " ".join(tags.text))


def test_every_figure_and_table_is_described_for_screen_readers(facts: Facts) -> None:
    tags = Tags(page(facts))
    figures = tags.of("svg")
    assert len(figures) == len(tags.of("figure")) == len(tags.of("figcaption")) == 7
    assert all(figure["role"] == "img" and len(figure["aria-label"]) > 30 for figure in figures)
    assert len(tags.of("caption")) == len(tags.of("table"))
    assert all(cell["scope"] in {"row", "col"} for cell in tags.of("th"))


def test_the_page_states_the_layout_and_the_accuracy(facts: Facts) -> None:
    words = " ".join(Tags(page(facts)).text)
    metadata = facts.model.metadata
    for channel in metadata.layout:
        assert re.search(rf"\b{channel.name}\b.*\b{channel.position_mm:g}\b", words)
    assert facts.model.identity in words
    assert f"{metadata.accuracy.ratio:.2f}" in words
    assert f"{metadata.accuracy.limit_percent:.3f} ± {metadata.accuracy.limit_standard_error:.3f}" in words
    assert "youngs_modulus_gpa = 210" in words


def test_the_error_along_the_beam_adds_up_to_the_mean(facts: Facts) -> None:
    accuracy, profile = facts.model.metadata.accuracy, facts.profile
    length = facts.model.metadata.length_mm
    for curve, percent, error in (
        (profile.model_mm, accuracy.error_percent, accuracy.error_standard_error),
        (profile.limit_mm, accuracy.limit_percent, accuracy.limit_standard_error),
    ):
        assert abs(curve.mean() / length * 100 - percent) < 5 * error
    # The ends are where the error lives.
    assert profile.limit_mm[[0, -1]].min() > 3 * profile.limit_mm[len(profile.limit_mm) // 2]
    assert profile.position_mm[0] + profile.position_mm[-1] == pytest.approx(400)


def test_the_interval_along_the_beam_is_shown_if_the_model_has_one(facts: Facts) -> None:
    profile = facts.profile
    assert profile.held is not None
    assert profile.width_mm is not None
    assert profile.held.mean() == pytest.approx(0.95, abs=0.01)
    assert profile.width_mm[[0, -1]].min() > 3 * profile.width_mm[len(profile.width_mm) // 2]
    words = " ".join(Tags(page(facts)).text)
    assert profile.held_in is not None
    assert [part.value for part in profile.held_in[1:]] == pytest.approx(profile.held[[0, -1]], abs=1e-9)
    whole, first, last = (f"{part.value * 100:.1f} ± {part.standard_error * 100:.1g} %" for part in profile.held_in)
    assert f"held {whole} of the contacts" in words
    assert f"{first} and {last}." in words
    silent = replace(facts, profile=replace(profile, held=None, width_mm=None))
    assert "Interval along the beam" in words
    assert "Interval along the beam" not in " ".join(Tags(page(silent)).text)


def test_layouts_are_compared_on_the_same_contacts(facts: Facts) -> None:
    equal, best = facts.layouts[:2]
    assert equal.positions_mm == pytest.approx([80, 160, 240, 320])
    assert not equal.taken
    assert best.taken
    assert best.positions_mm == pytest.approx([68, 156, 244, 332])
    assert best.log_eigenvalue_product == pytest.approx(-55.4483, abs=1e-3)
    assert best.log_eigenvalue_product > equal.log_eigenvalue_product
    accuracy = facts.model.metadata.accuracy
    off = abs(best.limit.percent - accuracy.limit_percent)
    assert off < 5 * np.hypot(best.limit.standard_error, accuracy.limit_standard_error)
    by_error = facts.layouts[2]
    assert by_error.name == "position error"
    assert by_error.limit.percent < best.limit.percent + 3 * by_error.limit.standard_error
    assert len(Tags(page(facts)).of("tr", "taken")) == 1


def test_the_error_is_stated_with_each_sensor_failed_and_without_each_kind_of_error(facts: Facts) -> None:
    words = " ".join(Tags(page(facts)).text)
    placed, prices = facts.model.metadata.placed, {price.name: price for price in facts.prices}
    assert placed is not None
    assert len(placed.limit_without_percent) == 4
    # The outer sensors are worth more than the inner ones.
    assert min(placed.limit_without_percent[::3]) > 1.2 * max(placed.limit_without_percent[1:3])
    limit_percent = facts.model.metadata.accuracy.limit_percent
    assert min(placed.limit_without_percent) > limit_percent
    for percent in (limit_percent, *placed.limit_without_percent):
        assert f"{percent:.3f}" in words
    for name in ("gain error", "zero drift"):
        more = prices[name].more_percent
        assert more.value > max(1.0, 3 * more.standard_error)
        assert f"{prices[name].without.percent:.3f}" in words
        assert f"{more.value:.1f} ± " in words
    assert prices["mounting tolerance"].more_percent == Measurement(0.0, 0.0)


def test_a_layout_that_no_search_finds_is_listed_too(
    facts: Facts, bench_model: Path, bench: ModelFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facts_module, "LAYOUT_DRAWS", 100)
    scene = Surface.of_model(facts.model.metadata).scene
    kept = Placement((50.0, 150.0, 250.0, 350.0), 0.0, 0, ())
    layouts = facts_module._layouts(replace(built_of(bench_model, bench, scene), placement=kept))
    assert [layout.taken for layout in layouts] == [False] * (len(layouts) - 1) + [True]
    assert layouts[-1].name == "the model's"


def test_physics_in_and_out_has_a_row_for_each_effect(facts: Facts) -> None:
    words = Tags(page(facts)).text
    assert {effect.name for effect in facts.effects} <= set(words)
    assert {effect.reason for effect in facts.effects} <= set(words)


@pytest.mark.usefixtures("short_measuring")
def test_a_report_leaves_out_the_eigenvalue_product_if_no_layout_has_one(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    scene, report = tmp_path / "scene.toml", tmp_path / "report.html"
    # Contacts at one place have one component, and three sensors need three.
    text = PAPER.replace("count = 2", "count = 3\ngrid_mm = 40").replace("[1, 399]", "[200, 200.001]")
    scene.write_text(text.replace("noise_percent_of_max = 2", "noise_percent_of_max = 0.2"))
    asked = ("--criterion", "position-error", "-o", tmp_path / "model.onnx", "--report", report)
    done = design_sensors_here("build", scene, *asked)
    assert done.returncode == 0, done.stderr
    words = " ".join(Tags(report.read_text()).text)
    assert "ln of the eigenvalue product -∞" in words
    rows = words[words.index("Layouts compared") :]
    assert "position error" in rows
    assert not re.search(r"\b(nan|inf|None)\b|eigenvalue product \d", rows)


def test_components_are_those_of_the_influence_matrix(facts: Facts) -> None:
    matrix = facts.components.transformed @ facts.components.vectors.T
    moment = matrix.T @ matrix / len(matrix)
    assert np.trace(moment) == pytest.approx(facts.components.eigenvalues.sum(), rel=1e-9)
    assert matrix.max() * 20 == pytest.approx(facts.model.metadata.max_deflection_mm, rel=0.2)


def test_text_of_the_user_is_escaped(facts: Facts) -> None:
    scene = "# <script>alert('x')</script> </pre> & more\n"
    metadata = facts.model.metadata.model_copy(update={"scene": scene})
    text = page(replace(facts, model=replace(facts.model, metadata=metadata)))
    assert "<script>" not in text
    assert "<script>alert('x')</script>" in " ".join(Tags(text).text)


def test_the_same_build_gives_the_same_page(facts: Facts, bench_model: Path, bench: ModelFile) -> None:
    with pytest.MonkeyPatch.context() as fewer:
        fewer.setattr(facts_module, "PROFILE_DRAWS", 4000)
        fewer.setattr(facts_module, "LAYOUT_DRAWS", 1000)
        again = gather(facts.scene, built_of(bench_model, bench, facts.scene), lambda _doing, _done: None)
    assert page(again) == page(facts)


def drawn(facts: Facts, scene_text: str, *positions: float) -> Tags:
    layout = [Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(positions, start=1)]
    metadata = facts.model.metadata.model_copy(update={"layout": layout})
    return Tags(beam_drawing(parse_scene(scene_text, "scene.toml"), metadata))


def test_the_drawing_is_to_scale(facts: Facts) -> None:
    rules = "count = 2\nfixed_mm = [100]\nkeep_out_mm = [[200, 240]]"
    tags = drawn(facts, PAPER.replace("count = 2", rules), 100.0, 170.0, 330.0)
    scale = (WIDTH - 2 * MARGIN) / 400
    sensors = tags.of("rect", "sensor")
    middles = [float(sensor["x"]) + float(sensor["width"]) / 2 for sensor in sensors]
    assert middles == pytest.approx([MARGIN + x * scale for x in (100, 170, 330)], abs=0.1)
    assert ["fixed" in sensor["class"] for sensor in sensors] == [True, False, False]
    (beam,) = tags.of("rect", "beam")
    assert float(beam["width"]) == pytest.approx(400 * scale, abs=0.1)
    assert float(beam["height"]) == pytest.approx(3 * scale, abs=0.1)
    gap = float(sensors[0]["y"]) - float(beam["y"]) - float(beam["height"])
    assert gap == pytest.approx(facts.model.metadata.sensor.standoff_mm * scale, abs=0.2)
    (keep_out,) = tags.of("rect", "keepout")
    assert float(keep_out["x"]) == pytest.approx(MARGIN + 200 * scale, abs=0.1)
    assert float(keep_out["width"]) == pytest.approx(40 * scale, abs=0.1)
    assert {"s1 (fixed)", "s2", "keep out"} <= set(tags.text)


@pytest.mark.parametrize(
    ("beam", "supports", "sections"),
    [
        ("", 2, 1),
        ('supports = "cantilever"', 1, 1),
        ('supports = "propped"\nsegments = [{to_mm = 150}, {to_mm = 400, thickness_mm = 8}]', 2, 2),
        ('supports = [{at_mm = 50}, {at_mm = 200, kind = "fixed"}, {at_mm = 350}]', 3, 1),
    ],
)
def test_every_support_and_section_is_drawn(facts: Facts, beam: str, supports: int, sections: int) -> None:
    tags = drawn(facts, PAPER.replace("[beam]", f"[beam]\n{beam}"), 100.0, 300.0)
    assert len(tags.of("path", "support")) == supports
    assert len(tags.of("rect", "beam")) == sections
    assert "Supports: " in tags.of("svg")[0]["aria-label"]


def test_a_foundation_is_drawn_as_springs_under_the_whole_beam(facts: Facts) -> None:
    tags = drawn(facts, PAPER.replace("[beam]", "[beam]\nsupports = []\nfoundation_n_mm2 = 0.01"), 100.0, 300.0)
    (springs,) = tags.of("path", "support")
    tops = [float(start.split()[0]) for start in springs["d"].split("M")[1:]]
    assert tops == pytest.approx(np.linspace(MARGIN, WIDTH - MARGIN, len(tops)), abs=0.1)
    assert len(tops) > 20


def test_labels_of_close_sensors_do_not_overlap(facts: Facts) -> None:
    text = beam_drawing(
        facts.scene,
        facts.model.metadata.model_copy(
            update={"layout": [Channel(name=f"s{i}", position_mm=10.0 + 12 * i) for i in range(1, 9)]}
        ),
    )
    labels = {
        match[3]: (float(match[1]), float(match[2]))
        for match in re.finditer(r'<text x="([\d.]+)" y="([\d.]+)" text-anchor="middle">(s\d)<', text)
    }
    assert len(labels) == 8
    rows = {name: y for name, (_, y) in labels.items()}
    assert rows["s1"] != rows["s2"]
    assert max(rows.values()) + 14 < HEIGHT - 36


def test_a_report_in_a_missing_folder_is_refused_before_the_build(design_sensors_here: Command, tmp_path: Path) -> None:
    output = ("-o", tmp_path / "m.onnx", "--report", tmp_path / "a/b.html")
    done = design_sensors_here("build", SCENES / "paper.toml", *output)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "no such folder" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("short_measuring")
def test_explain_and_the_report_of_build_agree_if_the_noise_comes_from_the_adc_alone(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(facts_module, "PROFILE_DRAWS", 500)
    monkeypatch.setattr(facts_module, "LAYOUT_DRAWS", 200)
    scene, report = tmp_path / "deep.toml", tmp_path / "deep.html"
    text = PAPER.replace("thickness_mm = 3", "thickness_mm = 12").replace(
        "force_n = 10.0", "force_n = 20.0\nwidth_mm = 2"
    )
    scene.write_text(text.replace("noise_percent_of_max = 2", "noise_mm = 0.0\nadc_bits = 12"))
    explained = json.loads(design_sensors_here("explain", scene, "--json").stdout)
    done = design_sensors_here("build", scene, "-o", tmp_path / "deep.onnx", "--report", report, "--json")
    assert done.returncode == 0, done.stderr
    shear = explained["effects"][0]
    assert shear["verdict"] == "not modelled"
    assert f"note:    shear is {shear['price']:.2g} times the noise but not modelled" in done.stderr
    assert json.loads(done.stdout)["noise"]["sample_mm"] == explained["noise_mm"]
    text = report.read_text(encoding="utf-8")
    assert modelfile.load(tmp_path / "deep.onnx").identity in text
    cells = [cell.strip() for cell in Tags(text).text]
    for effect in explained["effects"]:
        row = cells.index(effect["name"], cells.index("shear"))
        price = "-" if effect["price"] is None else f"{effect['price']:.3g}"
        words = [cell for cell in cells[row + 1 :] if cell][:3]
        assert words == [price, effect["verdict"], effect["reason"]]


def test_missed_contacts_and_ringing_are_stated(facts: Facts) -> None:
    text = " ".join(Tags(page(facts)).text)
    # At the ends of the range, 1 mm from a support, nearly all are missed.
    assert re.search(r"Contacts of 2 N, the smallest .* are missed along the beam; at most (9\d|100)(\.\d)? % of", text)
    strong = facts.model.metadata.ranges.model_copy(update={"force_n": (200.0, 300.0)})
    stronger = replace(facts.model, metadata=facts.model.metadata.model_copy(update={"ranges": strong}))
    seen = " ".join(Tags(page(replace(facts, model=stronger))).text)
    assert "Of settled samples of 200 N, the smallest force of the scene, fewer than one in ten thousand" in seen
    assert re.search(r"sudden touch +[\d.]+ % \+- [\d.]+ after [\d.]+ ms", " ".join(text.split()))
    assert "The beam rings at 44 Hz, with the largest force lying on it as a weight at 10.2 Hz" in text
    assert "until the ringing is under the noise of a reading" in text.lower()
    bare = facts.scene.beam.model_copy(update={"density_kg_m3": None})
    silent = page(replace(facts, scene=facts.scene.model_copy(update={"beam": bare})))
    assert "Ringing" not in silent
