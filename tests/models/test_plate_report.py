"""The report of a plate: pictures from above to scale, figures by axis, and no word about a beam."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import change_scene, read_scene, resolve
from beamtouch_models.arrays import Floats
from beamtouch_models.design.building.build import build_model
from beamtouch_models.design.building.report.facts import Facts, gather
from beamtouch_models.design.building.report.page import page
from beamtouch_models.design.building.report.plate_pictures import Map, Region, draw_maps, draw_regions
from beamtouch_models.design.effort import Effort
from support.pages.tags import Tags
from support.programs.in_process import Command
from support.surfaces.example_scenes import SCENES

pytestmark = pytest.mark.long
PLACES = [(25.0, 25.0), (25.0, 275.0), (375.0, 25.0), (375.0, 275.0)]


def gathered() -> Facts:
    """Return what the report of a plate has, with little effort."""
    few = {"grid_mm": 100, "fixed": [{"x_mm": x, "y_mm": y} for x, y in PLACES[:1]]}
    kept_out = [{"x_mm": [150.0, 250.0], "y_mm": [100.0, 200.0]}]
    scene = change_scene(read_scene(SCENES / "plate-on-springs.toml"), sensors=few | {"keep_out": kept_out})
    layout = resolve(scene).layout(PLACES)
    told: list[tuple[str, float]] = []
    rough = replace(layout, aim=replace(layout.aim, effort=Effort(0.01)))
    built = build_model(rough, "table", progress=lambda *step: told.append(step))
    facts = gather(built, lambda *step: told.append(step))
    done = [part for _, part in told]
    assert done == sorted(done)
    assert done[0] >= 0.3
    assert told[-2:] == [("measuring the accuracy against the limit", 0.8), ("measuring for the report", 0.97)]
    return facts


def assert_drawn_to_one_scale(text: str) -> None:
    """Layout and keep-outs lie where they are, by one scale."""
    drawing = re.findall(r"<svg.*?</svg>", text, re.DOTALL)[0]
    sensors = np.array(
        re.findall(r'<circle class="sensor[^>]* cx="([\d.]+)" cy="([\d.]+)" r="([\d.]+)"', drawing), float
    )
    px = (sensors[2, 0] - sensors[0, 0]) / 350
    assert (sensors[0, 1] - sensors[1, 1]) / 250 == pytest.approx(px, rel=0.01)
    assert sensors[:, 2] == pytest.approx(6 * px, abs=0.06)
    x, y, width, height = (
        float(value)
        for value in re.findall(
            r'<rect class="keepout[^>]* x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"', drawing
        )[0]
    )
    assert (width, height) == pytest.approx((100 * px, 100 * px), rel=0.01)
    assert (x - sensors[0, 0], sensors[0, 1] - y - height) == pytest.approx((125 * px, 75 * px), abs=0.2)


def assert_map_adds_up(facts: Facts) -> None:
    """The parts of the map have the mean error that the model states."""
    profile = facts.profile
    mean_mm = facts.model.metadata.accuracy.error_percent / 100 * 500
    assert np.nanmean(profile.model_mm) == pytest.approx(mean_mm, rel=0.25)
    assert profile.model_mm.shape == profile.limit_mm.shape == (8 * 6,)


def shades_of(values: Floats) -> Floats:
    """From 0.06 of the least to 0.6 of the largest; of those that are not finite none."""
    known = values[np.isfinite(values)]
    shades: Floats = 0.06 + 0.54 * (known - known.min()) / np.ptp(known)
    return shades


def assert_maps_show_what_was_measured(facts: Facts, text: str, words: str) -> None:
    """Errors in 8 by 6 parts, smallest forces, and what each sensor shows of 20 N in 28 by 21 parts."""
    profile, metadata, influence = facts.profile, facts.model.metadata, facts.built.layout.surface.influence
    _, errors, forces, shown = (
        figure for figure in re.findall(r"<svg.*?</svg>", text, re.DOTALL) if "ellipse" not in figure
    )
    middles_mm = [
        [low + (high - low) * (i + 0.5) / n for i in range(n)] for low, high, n in ((10, 390, 28), (10, 290, 21))
    ]
    places = np.array([[x, y] for x in middles_mm[0] for y in middles_mm[1]])
    of_sensors = 20 * influence.at(np.array(PLACES), places).T
    seen = np.array([np.nan if force is None else force for force in metadata.smallest_force.force_n])
    for drawn, each in ((errors, [profile.model_mm, profile.limit_mm]), (forces, [seen]), (shown, list(of_sensors))):
        opacity = np.array(re.findall(r'opacity="([\d.]+)"', drawn), float)
        assert opacity == pytest.approx(np.concatenate([shades_of(values) for values in each]), abs=0.011)
    for number, values in enumerate(of_sensors, start=1):
        assert f"s{number}: {values.min():.2g} to {values.max():.2g} mm" in words
    rings = re.findall(r'<circle class="line[^>]* cx="([\d.]+)" cy="([\d.]+)"', shown)
    frames = re.findall(r'<rect class="frame[^>]* x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"', shown)
    for (x, y), frame, (at_x, at_y) in zip(rings, frames, PLACES, strict=True):
        left, top, width, height = map(float, frame)
        assert (float(x), float(y)) == pytest.approx(
            (left + width * at_x / 400, top + height * (1 - at_y / 300)), abs=0.2
        )
    assert ("a dash: nothing is seen there" in words) == bool(np.isnan(seen).any())
    assert "of 20 N, and dashed of 2 N, " in words
    assert "What each sensor, a ring, shows of 20 N" in words
    (told,) = re.findall(r"the widest is ([\d.]+) by ([\d.]+) mm", words)
    widest = max(profile.regions, key=lambda region: region.semi_axes_mm[0]).semi_axes_mm
    assert (float(told[0]), float(told[1])) == pytest.approx((2 * widest[0], 2 * widest[1]), rel=0.05)


def test_the_report_of_a_plate_is_complete_and_speaks_of_no_beam() -> None:
    facts = gathered()
    text = page(facts)
    tags = Tags(text)
    words = " ".join(" ".join(tags.text).split())
    figures = tags.of("svg")
    assert len(figures) == len(tags.of("figure")) == len(tags.of("figcaption")) == 5
    assert all(figure["role"] == "img" and len(figure["aria-label"]) > 30 for figure in figures)
    assert not re.search(r"\b(nan|inf|None)\b", words)
    assert not re.search(r"\bbeams?\b|left end|middle third", words.split("Origin")[0])
    assert "A plate of 400 by 300 mm over 4 sensors" in words
    assert "x = 10 to 390 mm and y = 10 to 290 mm from its lower left corner" in words
    assert "s1 (fixed) 25 25 375 275 250" in words
    assert "springs of 15 N/mm at (0, 0), (0, 300), (400, 0), (400, 300) mm" in words
    for axis in range(2):
        share = facts.profile.whole.held[axis]
        assert abs(share.value - 0.95) < 0.03
    assert_drawn_to_one_scale(text)
    assert_map_adds_up(facts)
    assert_maps_show_what_was_measured(facts, text, words)


@pytest.mark.soak
def test_a_plate_is_built_again_with_its_report_where_its_sensors_are_mounted(
    design_sensors_roughly: Command, tmp_path: Path
) -> None:
    scene, model, report = tmp_path / "table.toml", tmp_path / "table.onnx", tmp_path / "table.html"
    text = (SCENES / "plate-on-springs.toml").read_text(encoding="utf-8")
    scene.write_text(text.replace("count = 4", "count = 4\ngrid_mm = 50"), encoding="utf-8")
    assert design_sensors_roughly("build", scene, "-o", model).returncode == 0
    again = design_sensors_roughly("build", scene, "-o", model, "--report", report)
    assert again.returncode == 0
    assert "the sensors stay where" in " ".join(again.stderr.split())
    assert "They stay where they were mounted." in report.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("deviation_mm", "correlation", "half_mm"),
    [((3.0, 2.0), 0.0, (7.342, 4.895)), ((2.0, 2.0), 0.6, (6.191, 3.096)), ((2.0, 2.0), -0.6, (6.191, 3.096))],
)
def test_a_region_of_95_percent_is_the_ellipse_of_chi_square(
    deviation_mm: tuple[float, float], correlation: float, half_mm: tuple[float, float]
) -> None:
    """The root of 5.991 times the eigenvalues of the covariance; of equal deviations s, these are s^2 (1 +- r)."""
    long_mm, short_mm, angle = Region((200, 150), 10, deviation_mm, correlation).semi_axes_mm
    assert (long_mm, short_mm) == pytest.approx(half_mm, abs=2e-3)
    slant = np.degrees(angle) % 180
    assert slant == pytest.approx({0.0: 0, 0.6: 45, -0.6: 135}[correlation], abs=1e-6)


def test_maps_put_the_first_value_at_the_lower_left_and_say_where_nothing_is() -> None:
    edges = (np.array([0.0, 200, 400]), np.array([0.0, 150, 300]))
    picture = draw_maps([Map("mm", edges, np.array([1.0, 2, 3, np.nan]))], (400, 300), "four parts")
    numbers = re.findall(r'<text x="([\d.]+)" y="([\d.]+)"[^>]*>([\d-]+)<', picture)
    at = {number: (float(x), float(y)) for x, y, number in numbers}
    assert at["1"][0] == at["2"][0] < at["3"][0] == at["-"][0]
    assert at["1"][1] == at["3"][1] > at["2"][1] == at["-"][1]
    shades = [float(opacity) for opacity in re.findall(r'opacity="([\d.]+)"', picture)]
    assert shades == sorted(shades)
    assert len(shades) == 3


def test_regions_are_drawn_larger_by_the_factor_that_is_returned() -> None:
    picture, times = draw_regions([Region((200, 150), 10, (1.0, 0.5), 0.0)], (400, 300), "a region")
    half_px = float(re.findall(r'rx="([\d.]+)"', picture)[0])
    (width,) = re.findall(r'<rect class="frame[^>]* width="([\d.]+)"', picture)
    assert half_px == pytest.approx(times * 2.4477 * float(width) / 400, rel=0.01)
    assert times == 10
