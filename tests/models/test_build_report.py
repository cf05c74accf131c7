"""The report of a build: one complete page with true statements and without requests to the network."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.building.build import Built
from beamtouch_models.design.building.report import facts as measured
from beamtouch_models.design.building.report.facts import Facts, gather
from beamtouch_models.design.building.report.page import page
from beamtouch_models.design.building.report.parts import parts_of, shows_mm
from beamtouch_models.design.building.report.questions import overload_of, questions
from beamtouch_models.design.layout import Layout
from beamtouch_models.design.placement.placing import Aim, place
from beamtouch_models.design.scene import change_scene, load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.numbers import rounded, with_error
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
        fewer.setattr(measured, "PROFILE_DRAWS", 4000)
        fewer.setattr(measured, "LAYOUT_DRAWS", 1000)
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
    numbers = re.findall(r">component (-?\d+)<", text)
    assert numbers == [str(number) for number in range(1, len(numbers) + 1)]
    assert len(numbers) >= 3
    *_, components = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    curves = re.findall(r'<polyline class="line stroke-s(\d)"', components)
    assert curves == [str(number) for number in range(len(numbers))]  # a colour each
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
        f"reaches {rounded(metadata.accuracy.ratio, metadata.accuracy.ratio_standard_error)} times that",
        "youngs_modulus_gpa = 210",
    ):
        assert said in " ".join(words.split())
    accuracy = metadata.accuracy
    limit, error = (
        with_error(4 * percent, 4 * standard_error, "±")
        for percent, standard_error in (
            (accuracy.limit_percent, accuracy.limit_standard_error),
            (accuracy.error_percent, accuracy.error_standard_error),
        )
    )
    assert limit != error
    assert f"model {error}" in " ".join(words.split())
    assert f"accuracy limit {limit}" in " ".join(words.split())
    effects = facts.built.layout.surface.effects
    assert {effect.name for effect in effects} <= set(cells)
    told = re.sub(r"\s+", "", words)
    for effect in effects:
        typeset = re.sub(r"(?<=\d )um\b", "µm", effect.reason).replace("+-", "±").replace("`", "")
        assert "".join(typeset.split()) in told


def test_one_row_of_tiles_has_one_unit(text: str, words: str) -> None:
    (tiles,) = re.findall(r'<dl class="tiles">(.*?)</dl>', text, re.DOTALL)
    assert [unit for _, unit in re.findall(r"<dd>([\d.]+) ([^<]+)<", tiles)] == ["mm"] * 4
    assert "ln" not in words.split() or "logarithm" in words


def test_holes_are_stated_from_both_ends_and_housings_with_their_sides(facts: Facts, words: str) -> None:
    stated = " ".join(words.split())
    for channel, after in zip(facts.model.metadata.layout, [*facts.model.metadata.layout[1:], None], strict=True):
        place = channel.position_mm
        step = "-" if after is None else f"{after.position_mm - place:g}"
        assert f"{channel.name} {place:g} {400 - place:g} {step} {place - 6:g} to {place + 6:g}" in stated


def assert_drawn(svg: str, curves: list[tuple[Floats, Floats]]) -> None:
    """The curves of a chart are those of x and y but for the scales of its axes."""
    drawn = [
        np.array([pair.split(",") for pair in points.split()], float)
        for points in re.findall(r'<polyline class="line[^>]* points="([^"]*)"', svg)
    ]
    assert [len(points) for points in drawn] == [len(x) for x, _ in curves]
    for axis in (0, 1):
        px, values = np.concatenate([each[:, axis] for each in drawn]), np.concatenate([each[axis] for each in curves])
        slope, start = np.polyfit(values, px, 1)
        assert start + slope * values == pytest.approx(px, abs=0.12)
        assert (slope > 0) == (axis == 0)


def test_charts_draw_errors_smallest_forces_and_components_along_the_beam(facts: Facts, text: str, words: str) -> None:
    _, errors, forces, components = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    profile, seen, surface = facts.profile, facts.model.metadata.smallest_force, facts.built.layout.surface
    at_mm = np.arange(24) * 398 / 24 + 1 + 398 / 48
    assert_drawn(errors, [(at_mm, profile.model_mm), (at_mm, profile.limit_mm)])
    curve = np.array([20.0 if force is None else min(force, 20.0) for force in seen.force_n])
    assert_drawn(forces, [(np.array(seen.position_mm), np.log(curve))])
    assert "limit; 24 stretches." in words
    assert ("even 20 N, the largest force of the scene, is not seen where the curve reaches it" in words) == (
        20.0 in curve
    )
    # Of 11 N, in the middle of 2 to 20 N.
    shown_mm = 11 * surface.influence.matrix(facts.built.layout.placement.place_mm)
    _, _, directions = np.linalg.svd(shown_mm, full_matrices=False)
    parts = np.abs(shown_mm @ directions.T) / facts.model.metadata.noise.sample_mm
    pixels = [
        np.array([pair.split(",") for pair in points.split()], float)[:, 1]
        for points in re.findall(r'points="([^"]*)"', components)
    ]
    (zero,) = re.findall(r'y="([\d.]+)" text-anchor="end">0<', components)
    off_px = np.abs(np.array(pixels) - float(zero) + 4).T
    assert off_px * parts.max() / off_px.max() == pytest.approx(parts, abs=0.01 * parts.max())


def test_what_is_not_stated_is_marked_as_assumed(facts: Facts) -> None:
    surface = facts.built.layout.surface
    sources = {part.name: part.source for part in parts_of(surface, facts.model.metadata)}
    assert {name for name, source in sources.items() if source == "assumed"} == {
        "damping", "resolution", "drift", "mounting", "temperature"
    }  # fmt: skip
    assert sources["gap at rest"] == "computed"


def test_how_far_a_sensor_may_stand_off_is_that_of_the_slope_of_theory(facts: Facts) -> None:
    # Left of a load at b from the right end, w' = F b (L^2 - b^2 - 3 x^2) / (6 L E I); right of it, as in a mirror.
    surface, metadata, length_mm = facts.built.layout.surface, facts.model.metadata, 400
    load_mm, rigidity_n_mm2 = np.linspace(1, 399, 399), 210e3 * 25 * 3**3 / 12
    slopes = []
    for channel in metadata.layout:
        x = np.where(load_mm >= channel.position_mm, channel.position_mm, length_mm - channel.position_mm)
        b = np.where(load_mm >= channel.position_mm, length_mm - load_mm, load_mm)
        slopes.append(20 * b * (length_mm**2 - b**2 - 3 * x**2) / (6 * length_mm * rigidity_n_mm2))
    steepest = np.abs(slopes).max()
    assert shows_mm(surface, metadata) == pytest.approx(metadata.noise.sample_mm / steepest, rel=0.01)


def test_the_forces_at_which_a_sensor_fails_are_those_of_theory(facts: Facts) -> None:
    # F L^3 / (48 E I) in the middle under a load there, and x (3 L^2 - 4 x^2) / L^3 of that at x.
    metadata, over = facts.model.metadata, overload_of(facts.model.metadata)
    inertia_mm4, length_mm = 25 * 3**3 / 12, 400
    most_mm_per_n = length_mm**3 / (48 * 210e3 * inertia_mm4)
    off = max(1 - abs(2 * channel.position_mm / length_mm - 1) for channel in metadata.layout)
    ratio = (3 * off - off**3) / 2  # of a sensor at off L/2 beside the support, under a load in the middle
    at_rest_mm = metadata.sensor.standoff_mm
    # A load between the sensor and the middle moves it a little more than one in the middle.
    assert over.touches_n == pytest.approx(at_rest_mm / (ratio * most_mm_per_n), rel=0.05)
    assert over.touches_n < at_rest_mm / (ratio * most_mm_per_n) * 1.001
    assert over.leaves_range_n / over.touches_n == pytest.approx((at_rest_mm - 1) / at_rest_mm)


def test_errors_and_intervals_along_the_beam_add_up_to_the_means(facts: Facts, words: str) -> None:
    accuracy, profile = facts.model.metadata.accuracy, facts.profile
    for curve, percent, error in (
        (profile.model_mm, accuracy.error_percent, accuracy.error_standard_error),
        (profile.limit_mm, accuracy.limit_percent, accuracy.limit_standard_error),
    ):
        assert abs(curve.mean() / facts.model.metadata.length_mm * 100 - percent) < 5 * error
    (edges,) = profile.edges_mm
    assert profile.position_mm - edges[:-1] == pytest.approx(edges[1:] - profile.position_mm)
    assert len(profile.position_mm) == len(profile.model_mm)
    (held,) = profile.whole.held
    assert held.value == pytest.approx(0.95, abs=0.01)
    assert profile.whole.error_mm.value == pytest.approx(profile.model_mm.mean(), rel=0.1)
    for part, at in ((profile.first, 0), (profile.last, -1)):
        assert part.error_mm.value == pytest.approx(profile.model_mm[at])
        (held,) = part.held
        assert with_error(100 * held.value, 100 * held.standard_error, "±") in words


def test_layouts_are_compared_on_the_same_contacts(facts: Facts, text: str) -> None:
    best, papers, equal, by_error = facts.layouts
    names = ["this layout", "the paper's", "equal pitch", "placed anew"]
    assert [layout.name for layout in facts.layouts] == names
    assert papers.positions_mm.tolist() == best.positions_mm.tolist()
    assert equal.positions_mm == pytest.approx([80, 160, 240, 320])
    assert best.log_eigenvalue_product > equal.log_eigenvalue_product
    accuracy = facts.model.metadata.accuracy
    off = abs(best.limit.value - accuracy.limit_percent)
    assert off < 5 * np.hypot(best.limit.standard_error, accuracy.limit_standard_error)
    assert by_error.limit.value < best.limit.value + 3 * by_error.limit.standard_error
    assert len(Tags(text).of("tr", "taken")) == 1
    for layout in facts.layouts:
        assert layout.costs.all_mm == pytest.approx(4 * layout.limit.value, rel=0.1)
        assert layout.costs.inner_mm < layout.costs.all_mm < min(layout.costs.ends_mm, *layout.costs.failed_mm)


def test_the_error_is_stated_with_each_sensor_failed(facts: Facts, words: str) -> None:
    placed = facts.model.metadata.placed
    limit_percent = facts.model.metadata.accuracy.limit_percent
    assert min(placed.limit_without_percent) > limit_percent
    errors = [facts.model.metadata.accuracy.limit_standard_error, *placed.limit_without_standard_error]
    for percent, error in zip((limit_percent, *placed.limit_without_percent), errors, strict=True):
        assert with_error(4 * percent, 4 * error, "±") in words


def test_text_of_the_user_is_escaped(facts: Facts) -> None:
    scene = "# <script>alert('x')</script> </pre> & more\n"
    metadata = facts.model.metadata.model_copy(update={"scene": scene})
    told = page(replace(facts, model=replace(facts.model, metadata=metadata)))
    assert "<script>" not in told
    assert "<script>alert('x')</script>" in " ".join(Tags(told).text)


def test_ringing_is_stated(facts: Facts, words: str) -> None:
    assert re.search(r" [\d.]+ ms after a sudden touch [\d.]+ mm ", " ".join(words.split()))
    assert "The beam rings at 44 Hz, with the largest force lying on it as a weight at 10.2 Hz" in words
    assert "until the ringing is under the noise of a reading" in words.lower()
    layout, bare = facts.built.layout, change_scene(facts.scene, beam={"density_kg_m3": None})
    still = replace(facts.built, layout=replace(layout, surface=replace(layout.surface, scene=bare)))
    other = " ".join(Tags(page(replace(facts, built=still))).text)
    assert "beam rings at" not in other
    assert "the scene does not state the mass of the beam" in other


def test_a_larger_force_is_noted_where_forces_are_open_and_unexplained_where_they_are_known(facts: Facts) -> None:
    surface, metadata = facts.built.layout.surface, facts.model.metadata

    def answered(force_n: tuple[float, float], sensors: int = 4) -> dict[str, str]:
        ranges = metadata.ranges.model_copy(update={"force_n": force_n})
        of_force = metadata.model_copy(update={"ranges": ranges, "layout": metadata.layout[:sensors]})
        return {question.asked: question.answer for question in questions(surface, of_force, (1.0, 1.0), 1.0, 2.0)}

    larger, several = "What if the force is larger?", "What if two things touch it, or something long lies on it?"
    assert answered((2.0, 20.0))[larger].startswith("Clearly beyond 20 N, answers carry the note `overload`")
    for force_n, words in (((9.9, 10.1), "9.9 to 10.1 N"), ((10.0, 10.0), "10 N")):
        told = answered(force_n)[larger]
        assert told.startswith(f"A force that is not {words} gives the state `unexplained`")
        assert "overload" not in told
    assert "With 2 sensors nothing notices it" in answered((2.0, 20.0), sensors=2)[several]
    assert "With 2 sensors little notices it" in answered((10.0, 10.0), sensors=2)[several]


def test_the_gap_under_the_largest_force_is_that_at_the_sensors_by_the_formula_of_a_simple_beam(facts: Facts) -> None:
    """Of a load F at c, the beam sags by F (l - c) x (l^2 - (l - c)^2 - x^2) / (6 l E I) at x <= c."""
    length, rigidity, force = 400.0, 210e3 * 25 * 3**3 / 12, 20.0
    load, sensor = np.meshgrid(
        np.linspace(1, 399, 399), [channel.position_mm for channel in facts.model.metadata.layout]
    )
    place, beyond = np.minimum(load, sensor), length - np.maximum(load, sensor)
    sag_mm = force * beyond * place * (length**2 - beyond**2 - place**2) / (6 * length * rigidity)
    (gap,) = (part for part in parts_of(facts.built.layout.surface, facts.model.metadata) if part.name == "gap at rest")
    least, rest = map(float, re.findall(r"with 20 N lying on it, sensors see ([\d.]+) to ([\d.]+) mm", gap.remark)[0])
    assert rest == float(gap.value.split()[0])
    assert rest - least == pytest.approx(sag_mm.max(), rel=0.01)
    assert sag_mm.max() < 0.95 * facts.model.metadata.max_deflection_mm


def test_a_stop_stands_where_the_largest_force_leaves_it_free_and_the_sensor_in_its_range(facts: Facts) -> None:
    surface, metadata = facts.built.layout.surface, facts.model.metadata
    answers = {question.asked: question.answer for question in questions(surface, metadata, (1.0, 1.0), 1.0, 2.0)}
    told = re.search(
        r"beside each sensor, ([\d.]+) to ([\d.]+) mm below .* closest at (s\d), ",
        answers["What if the force is larger?"],
    )
    assert told is not None
    free, ends, name = float(told[1]), float(told[2]), told[3]
    influence = np.array(metadata.influence.mm_per_n)
    index = [channel.name for channel in metadata.layout].index(name)
    assert influence[:, index].max() == influence.max()
    assert free == pytest.approx(metadata.ranges.force_n[1] * influence.max(), rel=0.01)
    assert free < ends == pytest.approx(metadata.sensor.standoff_mm - metadata.sensor.range_mm[0], rel=0.01)


def test_an_honest_surface_passes_its_acceptance_in_nineteen_of_twenty_trials(facts: Facts, words: str) -> None:
    rng, prior, length_mm = np.random.default_rng(3), facts.built.layout.prior, facts.model.metadata.length_mm
    place = prior.extent.uniform(20 * 400, rng)
    sample = prior.draw(place, rng.uniform(*prior.force_n, len(place)), rng)
    answers = facts.model.answer(prior.measured(sample), prior.errors.noise_mm)
    trials = np.abs(answers["position_mm"] - place[:, 0]).reshape(400, 20).mean(axis=1)
    # 20 of 400 are expected beyond it, with a deviation of 4.4, and the bound has an error of its own.
    assert 4 <= (trials > facts.profile.accepted_mm).sum() <= 40
    held = (answers["position_low_mm"] <= place[:, 0]) & (place[:, 0] <= answers["position_high_mm"])
    assert (held.reshape(400, 20).sum(axis=1) < 17).sum() <= 20
    assert f"at most {facts.profile.accepted_mm:.2g} mm" in words
    assert facts.profile.accepted_mm < 0.1 * length_mm


def test_the_worst_failure_of_two_sensors_is_stated(facts: Facts, words: str) -> None:
    assert facts.two_failed is not None
    assert " and ".join(facts.two_failed.names) + ", the worst two" in words
    assert facts.two_failed.limit.value > max(facts.model.metadata.placed.limit_without_percent)


def test_the_bending_stress_is_stated_beside_what_a_weak_grade_of_a_stated_material_bears(facts: Facts) -> None:
    """20 N in the middle of 400 mm of 25 x 3 mm: F l / 4 over b t^2 / 6 = 53 MPa."""
    layout, metadata = facts.built.layout, facts.model.metadata
    asked = "Is the beam strong enough?"

    def told(**beam: object) -> str:
        surface = replace(layout.surface, scene=change_scene(facts.scene, beam=beam))
        return {each.asked: each.answer for each in questions(surface, metadata, (1.0, 1.0), 1.0, 2.0)}[asked]

    assert told().startswith("Under 20 N at the worst place, bending stresses it by up to 53 MPa. Compare")
    assert "A weak grade of steel bears 235 MPa once" in told(material="steel", youngs_modulus_gpa=None)
    bare = {"width_mm": None, "thickness_mm": None, "youngs_modulus_gpa": None, "density_kg_m3": None}
    assert "so its stress is not computed" in told(flexural_rigidity_n_mm2=1e7, **bare)
