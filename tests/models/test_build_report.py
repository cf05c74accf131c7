"""The report of a build: one complete page with true statements and without requests to the network."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.building.build import Built
from beamtouch_models.design.building.report import page as page_module
from beamtouch_models.design.building.report.page import Facts, gather, page
from beamtouch_models.design.layout import Layout
from beamtouch_models.design.placement.placing import Aim, place
from beamtouch_models.design.scene import change_scene, load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.runtime import ModelFile
from support.pages.tags import Tags
from support.surfaces.example_scenes import SCENES
from support.surfaces.stated_problems import problem_in

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def facts(bench_model: Path, bench: ModelFile) -> Facts:
    scene = change_scene(load_scene(SCENES / "bench.toml")[0], sensors={"grid_mm": 4})  # few places are to be searched
    placement = place(*problem_in(scene), len(bench.metadata.layout), 0)
    layout = Layout(resolve(scene, chosen=bench.metadata.filter), placement, Aim("eigenvalue-product"))
    with pytest.MonkeyPatch.context() as fewer:
        fewer.setattr(page_module, "PROFILE_DRAWS", 4000)
        fewer.setattr(page_module, "LAYOUT_DRAWS", 1000)
        built = Built(bench_model.read_bytes(), bench.metadata, layout)
        return gather(built, lambda _doing, _done: None)


@pytest.fixture(scope="module")
def text(facts: Facts) -> str:
    return page(facts)


@pytest.fixture(scope="module")
def words(text: str) -> str:
    return " ".join(Tags(text).text)


def test_the_page_is_complete_described_for_screen_readers_and_makes_no_requests(text: str) -> None:
    tags = Tags(text)
    assert tags.of("html")[0]["lang"] == "en"
    assert not {"script", "link", "img", "iframe", "object"} & {tag for tag, _ in tags.found}
    assert not re.search(r"https?:|//\w|@import|url\(", text)
    assert not [value for _, attributes in tags.found for name, value in attributes.items() if name in {"src", "href"}]
    assert "prefers-color-scheme: dark" in text
    assert "@media print" in text
    assert not re.search(r"\b(nan|inf|None)\b", " ".join(tags.text))
    figures = tags.of("svg")
    assert len(figures) == len(tags.of("figure")) == len(tags.of("figcaption")) == 4
    assert all(figure["role"] == "img" and len(figure["aria-label"]) > 30 for figure in figures)
    assert len(tags.of("caption")) == len(tags.of("table"))
    assert all(cell["scope"] in {"row", "col"} for cell in tags.of("th"))


def test_the_page_states_the_layout_the_accuracy_and_every_effect(facts: Facts, text: str, words: str) -> None:
    metadata, cells = facts.model.metadata, Tags(text).text
    for channel in metadata.layout:
        assert re.search(rf"\b{channel.name}\b.*\b{channel.position_mm:g}\b", words)
    for said in (
        facts.model.identity,
        f"{metadata.accuracy.ratio:.2f}",
        f"accuracy limit {metadata.accuracy.limit_percent:.3f} ± ",
        "youngs_modulus_gpa = 210",
    ):
        assert said in " ".join(words.split())
    effects = facts.built.layout.surface.effects
    assert {effect.name for effect in effects} | {effect.reason for effect in effects} <= set(cells)


def test_errors_and_intervals_along_the_beam_add_up_to_the_means(facts: Facts, words: str) -> None:
    accuracy, profile = facts.model.metadata.accuracy, facts.profile
    for curve, percent, error in (
        (profile.model_mm, accuracy.error_percent, accuracy.error_standard_error),
        (profile.limit_mm, accuracy.limit_percent, accuracy.limit_standard_error),
    ):
        assert abs(curve.mean() / facts.model.metadata.length_mm * 100 - percent) < 5 * error
    assert profile.held_in is not None
    assert profile.held_in[0].value == pytest.approx(0.95, abs=0.01)
    whole, first, last = (f"{part.value * 100:.1f} ± {part.standard_error * 100:.1g} %" for part in profile.held_in)
    assert f"held {whole} of the contacts" in words
    assert f"{first} and {last}." in words


def test_layouts_are_compared_on_the_same_contacts(facts: Facts, text: str) -> None:
    equal, best, by_error = facts.layouts
    assert [equal.taken, best.taken, by_error.name] == [False, True, "position error"]
    assert equal.positions_mm == pytest.approx([80, 160, 240, 320])
    assert best.log_eigenvalue_product > equal.log_eigenvalue_product
    accuracy = facts.model.metadata.accuracy
    off = abs(best.limit.value - accuracy.limit_percent)
    assert off < 5 * np.hypot(best.limit.standard_error, accuracy.limit_standard_error)
    assert by_error.limit.value < best.limit.value + 3 * by_error.limit.standard_error
    assert len(Tags(text).of("tr", "taken")) == 1


def test_the_error_is_stated_with_each_sensor_failed(facts: Facts, words: str) -> None:
    placed = facts.model.metadata.placed
    limit_percent = facts.model.metadata.accuracy.limit_percent
    assert min(placed.limit_without_percent) > limit_percent
    for percent in (limit_percent, *placed.limit_without_percent):
        assert f"{percent:.3f}" in words


def test_text_of_the_user_is_escaped(facts: Facts) -> None:
    scene = "# <script>alert('x')</script> </pre> & more\n"
    metadata = facts.model.metadata.model_copy(update={"scene": scene})
    told = page(replace(facts, model=replace(facts.model, metadata=metadata)))
    assert "<script>" not in told
    assert "<script>alert('x')</script>" in " ".join(Tags(told).text)


def test_ringing_is_stated(facts: Facts, words: str) -> None:
    assert re.search(r"sudden touch +[\d.]+ % \+- [\d.]+ after [\d.]+ ms", " ".join(words.split()))
    assert "The beam rings at 44 Hz, with the largest force lying on it as a weight at 10.2 Hz" in words
    assert "until the ringing is under the noise of a reading" in words.lower()
    layout, bare = facts.built.layout, change_scene(facts.scene, beam={"density_kg_m3": None})
    still = replace(facts.built, layout=replace(layout, surface=replace(layout.surface, scene=bare)))
    other = " ".join(Tags(page(replace(facts, built=still))).text)
    assert "Ringing" not in other
