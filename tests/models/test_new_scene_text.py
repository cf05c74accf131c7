"""The text of a new scene: what was answered stands in it, and what was not is assumed by closed forms."""

import tomllib
from typing import Any

import numpy as np
import pytest

from beamtouch_models.design.building.new_scene import Answers, scene_text
from beamtouch_models.design.scene import parse_scene

LENGTH_MM, RIGIDITY_N_MM2 = 650.0, 200e3 * 40 * 2**3 / 12
"""Of a strip of 40 x 2 mm of steel."""


def text_of(**answers: Any) -> str:  # noqa: ANN401
    size = {"length_mm": LENGTH_MM, "width_mm": 40.0, "thickness_mm": 2.0}
    return scene_text(Answers(**size | answers), "strip")


def test_what_is_not_answered_is_a_usual_surface() -> None:
    scene = parse_scene(text_of(), "strip.toml")
    assert (scene.count_range, scene.sensors.noise_mm, scene.sensors.rate_hz) == ((4, 4), 0.005, 200)
    assert (scene.sensors.range_mm, scene.requirements.latency_ms) == ((1, 4), 20)
    assert scene.requirements.position_error_mm is None
    assert (scene.beam.material, scene.beam.length_mm) == ("steel", 650)
    supports = [(one.at_mm, one.kind, one.holds_lengthwise) for one in scene.beam.support_list]
    assert supports == [(0, "simple", True), (650, "simple", False)]
    assert scene.contact.position_mm == (13, 637)
    assert parse_scene(text_of(left="clamped", right="free"), "strip.toml").contact.position_mm == (13, 650)
    assert parse_scene(text_of(left="free", right="clamped"), "strip.toml").contact.position_mm == (0, 637)


def test_comments_say_what_is_assumed_and_what_may_be_stated() -> None:
    text = text_of(noise_mm=0.01)
    assert text.startswith("# strip: a strip of steel, 650 x 40 x 2 mm.\n")
    assert "# assumed: it uses up to a third of range_mm; state yours\n" in text
    assert "position_mm = [13, 637]  # near a support the beam moves too little\n" in text
    assert "# zero_drift_mm = 0.002  #" in text
    assert "\n# size_mm = 8  #" in text
    assert "# keep_out_mm = [[315, 335]]  #" in text
    assert "# position_error_mm = 10  #" in text
    stated = text_of(
        force_n=(2.5, 30.0), position_mm=(40.0, 500.25), size_mm=12.5, position_error_mm=3.75, right="clamped"
    )
    assert "force_n = [2.5, 30]  # smallest and largest\n" in stated
    assert "position_mm = [40, 500.25]  # where contacts may be\n" in stated
    assert "\nsize_mm = 12.5  #" in stated
    assert "\nposition_error_mm = 3.75  #" in stated
    assert '{ at_mm = 0, kind = "simple", slides = false },  # pinned: it can turn, not slide\n' in stated
    assert '{ at_mm = 650, kind = "fixed" },  # clamped: it can neither turn nor move\n' in stated
    told = text_of(roller_mm=(300.0,))
    assert '{ at_mm = 300, kind = "simple" },  # on a roller: it can turn and slide\n' in told


@pytest.mark.parametrize(
    ("ends", "bent_mm_per_n", "slope_per_n"),
    [
        # Under a load in the middle; the steepest end under one at 0.4226 of the length.
        (
            ("pinned", "roller"),
            LENGTH_MM**3 / (48 * RIGIDITY_N_MM2),
            0.064150 * LENGTH_MM**2 / RIGIDITY_N_MM2,
        ),
        (("clamped", "free"), LENGTH_MM**3 / (3 * RIGIDITY_N_MM2), LENGTH_MM**2 / (2 * RIGIDITY_N_MM2)),
    ],
)
@pytest.mark.parametrize("range_mm", [(1.0, 4.0), (2.5, 60.5)])
def test_forces_that_are_not_answered_bend_it_by_a_third_of_the_range_or_slope_it_by_0_03(
    ends: tuple[Any, Any], bent_mm_per_n: float, slope_per_n: float, range_mm: tuple[float, float]
) -> None:
    stated = tomllib.loads(text_of(left=ends[0], right=ends[1], range_mm=range_mm))["contact"]["force_n"]
    most = min((range_mm[1] - range_mm[0]) / 3 / bent_mm_per_n, 0.03 / slope_per_n)
    assert stated[1] == pytest.approx(most, rel=0.06)
    assert stated[1] == float(f"{stated[1]:.2g}")
    assert stated[0] == pytest.approx(stated[1] / 10, rel=0.05)


def test_the_wider_range_is_limited_by_the_slope_and_the_narrower_one_by_the_bend() -> None:
    """Else the forces would say nothing of either."""
    ratios = LENGTH_MM * np.array([0.064150 * 48, 3 / 2])
    bends, slopes = np.array([1.0, 58 / 3]), 0.03 / ratios * LENGTH_MM**2
    assert (bends[0] < slopes).all()
    assert (bends[1] > slopes).all()
