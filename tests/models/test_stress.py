"""The largest bending stress, beside the formulas of Gere & Goodno, Mechanics of Materials, app. H."""

import pytest

from beamtouch_models.design.physics.stress import largest_stress_mpa
from beamtouch_models.design.scene.beam import Beam

LENGTH_MM, WIDTH_MM, THICKNESS_MM, FORCE_N = 400.0, 20.0, 4.0, 10.0
SECTION_MM3 = WIDTH_MM * THICKNESS_MM**2 / 6


def beam(**keys: object) -> Beam:
    stated = {"length_mm": LENGTH_MM, "width_mm": WIDTH_MM, "thickness_mm": THICKNESS_MM, "youngs_modulus_gpa": 70.0}
    return Beam.model_validate(stated | keys)


@pytest.mark.parametrize(
    ("supports", "moment_n_mm"),
    [
        ("simply-supported", FORCE_N * LENGTH_MM / 4),
        ("cantilever", FORCE_N * LENGTH_MM),
        ("fixed-fixed", 4 / 27 * FORCE_N * LENGTH_MM),  # at the clamp, from a force at a third of the length
        ("propped", FORCE_N * LENGTH_MM * 3**-1.5),  # at the clamp, from a force at 0.577 of the length from the pin
    ],
)
def test_a_single_span_has_the_stress_of_its_formula(supports: str, moment_n_mm: float) -> None:
    found = largest_stress_mpa(beam(supports=supports), FORCE_N, (0.0, LENGTH_MM))
    assert found == pytest.approx(moment_n_mm / SECTION_MM3, rel=0.01)


def test_shear_does_not_count_and_a_shorter_range_bends_less() -> None:
    stiff = largest_stress_mpa(beam(), FORCE_N, (0.0, 100.0))
    assert stiff == pytest.approx(FORCE_N * 100 * 300 / 400 / SECTION_MM3, rel=0.01)
    assert largest_stress_mpa(beam(shear_modulus_gpa=1.0), FORCE_N, (0.0, 100.0)) == stiff


def test_a_thin_section_is_stressed_by_its_own_thickness() -> None:
    segments = [{"to_mm": 100.0, "thickness_mm": 1.0}, {"to_mm": LENGTH_MM}]
    found = largest_stress_mpa(beam(segments=segments), FORCE_N, (0.0, LENGTH_MM))
    # At the step, a force there has M = F a b / l.
    assert found == pytest.approx(FORCE_N * 100 * 300 / 400 / (WIDTH_MM / 6), rel=0.02)


def test_without_a_thickness_there_is_no_stress() -> None:
    bare = Beam.model_validate({"length_mm": LENGTH_MM, "flexural_rigidity_n_mm2": 1e7})
    assert largest_stress_mpa(bare, FORCE_N, (0.0, LENGTH_MM)) is None
