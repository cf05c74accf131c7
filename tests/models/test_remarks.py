"""What an engineer should look at again, in words with their numbers: beams, plates, failed sensors and short tares."""

from typing import Any

import pytest

from beamtouch_models import change_scene, read_scene
from beamtouch_models.design.building.remarks import missed_error, missed_requirement, remarks, short_tare, weak_spot
from beamtouch_models.design.scene import Scene
from beamtouch_models.filters import Walk
from beamtouch_models.runtime.metadata import Metadata
from support.surfaces.example_scenes import SCENES, paper_scene
from support.surfaces.small_model import model_of


def beam_with(**beam: object) -> Scene:
    return change_scene(paper_scene(), beam=beam)


def plate_with(plate: dict[str, Any] | None = None, **tables: dict[str, Any]) -> Scene:
    return change_scene(read_scene(SCENES / "plate-on-springs.toml"), plate=plate or {}, **tables)


@pytest.mark.parametrize(("modulus_gpa", "told"), [(189.9, True), (190.0, False), (215.0, False), (215.1, True)])
def test_a_modulus_that_no_steel_has_is_remarked_on(modulus_gpa: float, *, told: bool) -> None:
    said = f"beam.youngs_modulus_gpa = {modulus_gpa:g} is implausible for steel, which has 190 to 215 GPa; check it"
    assert remarks(beam_with(material="steel", youngs_modulus_gpa=modulus_gpa)) == [said] * told
    assert remarks(beam_with(youngs_modulus_gpa=modulus_gpa)) == []


def test_a_rigidity_that_no_steel_has_is_remarked_on_with_the_modulus_it_means() -> None:
    """E = 12 (E I) / (b t^3), of 25 by 3 mm."""
    stated = {"material": "steel", "youngs_modulus_gpa": None}
    (told,) = remarks(beam_with(flexural_rigidity_n_mm2=1e7, **stated))
    modulus = 12 * 1e7 / (25 * 27) / 1e3
    assert told == (
        f"beam.flexural_rigidity_n_mm2 = 1e+07 means {modulus:.3g} GPa, which is implausible for steel, which has 190 "
        "to 215 GPa; check it"
    )
    assert remarks(beam_with(flexural_rigidity_n_mm2=1.18125e7, **stated)) == []
    bare = {"width_mm": None, "thickness_mm": None}
    assert remarks(beam_with(flexural_rigidity_n_mm2=1e7, **stated, **bare)) == []


def test_a_modulus_from_the_table_that_scatters_by_more_than_a_tenth_is_told() -> None:
    assert remarks(beam_with(material="steel", youngs_modulus_gpa=None)) == []
    (told,) = remarks(beam_with(material="glass-fibre", youngs_modulus_gpa=None))
    assert told.startswith("glass-fibre is taken with ")
    assert told.endswith(", and forces are wrong by as much: calibrate, or state youngs_modulus_gpa")
    taken, low, high = (float(word) for word in told.replace(",", "").split() if word.replace(".", "").isdigit())
    assert low < 0.9 * taken or high > 1.1 * taken
    assert remarks(beam_with(material="glass-fibre", youngs_modulus_gpa=taken)) == []
    assert told in remarks(plate_with({"material": "glass-fibre"}))


SPRINGS = 'try supports = "corners" with support_stiffness_n_per_mm = 15'
"""20 N sink a spring of 15 N/mm by 1.33 mm, just under 0.45 of the sensors' 3 mm."""


def test_a_plate_on_stiff_supports_is_told_which_springs_are_soft_enough() -> None:
    better = f"on springs at its corners a plate errs far less: {SPRINGS}"
    near = f"places are told by small ratios of deflections, worst near the supports; {better}"
    rigid = remarks(plate_with({"support_stiffness_n_per_mm": None}))
    assert rigid == [f"the plate of 400 x 300 x 3 mm stands on rigid supports: {near}"]
    stiff = remarks(plate_with({"support_stiffness_n_per_mm": 151}))
    assert stiff == [f"the plate of 400 x 300 x 3 mm stands on springs of 151 N/mm, as on rigid ones: {near}"]
    assert remarks(plate_with({"support_stiffness_n_per_mm": 148})) == []
    edges = [{"x_mm": 0.0}, {"x_mm": 400.0}]
    lines = remarks(plate_with({"supports": edges, "support_stiffness_n_per_mm": None}))
    said = "is held along lines: hardly any place is told from another there"
    assert lines == [f"the plate of 400 x 300 x 3 mm {said}; {better}"]


@pytest.mark.parametrize(
    ("count", "force_n", "told"),
    [
        (1, (2.0, 20.0), "one sensor does not tell x, y and force of a contact; use 3"),
        (2, (2.0, 20.0), "2 sensors do not tell x, y and force of a contact; use 3"),
        (1, (11.0, 20.0), "one sensor does not tell x and y of a contact; use 2"),
        (2, (10.0, 20.0), "2 sensors do not tell x, y and force of a contact; use 3"),
        (2, (11.0, 20.0), None),
        (3, (2.0, 20.0), None),
    ],
)
def test_fewer_sensors_than_unknowns_are_remarked_on(
    count: int, force_n: tuple[float, float], told: str | None
) -> None:
    scene = plate_with(sensors={"count": count}, contact={"force_n": force_n})
    assert remarks(scene) == ([] if told is None else [f"{told} or more, and 4 to notice other loads"])


def test_an_error_that_a_scene_allows_is_no_miss() -> None:
    asked = change_scene(paper_scene(), requirements={"position_error_mm": 8.0})
    assert missed_error("mean error", 2.0, asked) == ""
    assert missed_error("mean error", 2.1, paper_scene()) == ""
    advice = "use more sensors or less noise, or allow more latency_ms"
    said = f"is 8.49 mm, more than requirements.position_error_mm = 8; {advice}"
    assert missed_error("limit", 2.1234, asked) == f"the limit {said}"
    metadata = model_of().metadata
    accuracy = metadata.accuracy.model_copy(update={"error_percent": 2.1234})
    assert missed_requirement(metadata.model_copy(update={"accuracy": accuracy}), asked) == f"the mean error {said}"


def failing(min_channels: int, without: list[float], failed_percent: float = 10.0, channels: int = 3) -> Metadata:
    """A model of 400 mm whose limit is 1 %."""
    metadata = model_of(channels=channels, min_channels=min_channels).metadata
    placed = metadata.placed.model_copy(update={"limit_without_percent": without, "failed_percent": failed_percent})
    return metadata.model_copy(update={"placed": placed})


def test_a_sensor_whose_failure_doubles_the_error_is_named() -> None:
    assert weak_spot(failing(2, [1.2, 1.9, 1.5]), paper_scene()) == ""
    moved = ", or place them with --failed-percent 100"
    said = "if s2 fails, the mean position error grows from 4 to 8.23 mm; add a sensor"
    assert weak_spot(failing(2, [1.2, 2.0, 1.5]), paper_scene()).startswith("if s2 fails, ")
    assert weak_spot(failing(2, [1.2, 2.05678, 1.5]), paper_scene()) == f"{said}{moved}"
    assert weak_spot(failing(2, [1.2, 2.05678, 1.5], 100.0), paper_scene()) == said


def test_a_surface_that_one_failed_sensor_ends_is_told_so() -> None:
    said = "one failed sensor ends this surface"
    assert weak_spot(failing(3, [1.2, 1.9, 1.5]), paper_scene()) == (
        f"{said}: all 3 channels must work; add a sensor, or place them with --failed-percent 100"
    )
    assert (
        weak_spot(failing(3, [1.2, 1.9, 1.5], 100.0), paper_scene())
        == f"{said}: all 3 channels must work; add a sensor"
    )
    assert weak_spot(failing(1, [], channels=1), paper_scene()) == f"{said}: it has no other; add a sensor"


def test_zeros_that_soon_drift_too_far_are_told_with_their_time() -> None:
    assert short_tare(None, "mm") == ""
    assert short_tare(Walk(0.02, 0.02, 0.001), "mm") == ""
    assert short_tare(Walk(0.031234, 0.0104567, 0.001), "mm") == (
        "zeros that drift by 31 um a minute are followed for 20 s after a tare only, over 10 um, "
        "and light contacts are taken for drift then; use sensors that drift less and state "
        "environment.drift_um_per_min, or begin contact.force_n at a larger force"
    )
