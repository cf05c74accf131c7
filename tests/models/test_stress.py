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


@pytest.mark.parametrize("wide_mm", [2.0, 4.0, 40.0])
def test_a_groove_is_stressed_by_the_moment_in_it(wide_mm: float) -> None:
    ends = (LENGTH_MM - wide_mm) / 2, (LENGTH_MM + wide_mm) / 2
    segments = [{"to_mm": ends[0]}, {"to_mm": ends[1], "thickness_mm": 1.0}, {"to_mm": LENGTH_MM}]
    found = largest_stress_mpa(beam(segments=segments), FORCE_N, (0.0, LENGTH_MM))
    assert found == pytest.approx(FORCE_N * LENGTH_MM / 4 / (WIDTH_MM / 6), rel=1e-3)


@pytest.mark.parametrize("overhang_mm", [5.0, 20.0])
def test_an_overhang_bends_over_its_support(overhang_mm: float) -> None:
    supports = [{"at_mm": overhang_mm, "kind": "simple"}, {"at_mm": LENGTH_MM, "kind": "simple"}]
    found = largest_stress_mpa(beam(supports=supports), FORCE_N, (0.0, overhang_mm))
    assert found == pytest.approx(FORCE_N * overhang_mm / SECTION_MM3, rel=1e-3)


@pytest.mark.parametrize("spans", [2, 9, 20])
def test_many_clamped_spans_have_the_stress_of_one(spans: int) -> None:
    supports = [{"at_mm": LENGTH_MM * index / spans, "kind": "fixed"} for index in range(spans + 1)]
    found = largest_stress_mpa(beam(supports=supports), FORCE_N, (0.0, LENGTH_MM))
    assert found == pytest.approx(4 / 27 * FORCE_N * LENGTH_MM / spans / SECTION_MM3, rel=0.005)


@pytest.mark.parametrize("foundation_n_mm2", [10.0, 1e3])
def test_a_long_beam_on_a_foundation_has_the_stress_of_the_formula(foundation_n_mm2: float) -> None:
    """Under a force in the middle: M = F / (4 beta), Hetenyi, Beams on Elastic Foundation, sec. 2."""
    rigidity = 70e3 * WIDTH_MM * THICKNESS_MM**3 / 12
    beta = (foundation_n_mm2 / (4 * rigidity)) ** 0.25
    free = beam(supports=[], foundation_n_mm2=foundation_n_mm2)
    found = largest_stress_mpa(free, FORCE_N, (150.0, 250.0))
    assert found == pytest.approx(FORCE_N / (4 * beta) / SECTION_MM3, rel=0.03)


def test_without_a_thickness_there_is_no_stress() -> None:
    bare = Beam.model_validate({"length_mm": LENGTH_MM, "flexural_rigidity_n_mm2": 1e7})
    assert largest_stress_mpa(bare, FORCE_N, (0.0, LENGTH_MM)) is None


def test_a_long_beam_on_a_foundation_is_stressed_as_hetenyi_says() -> None:
    """Beams on Elastic Foundation, 1946, eq. 6c: M = F / (4 beta) under a force far from both ends."""
    stiffness = 2.0
    rigidity = 70e3 * WIDTH_MM * THICKNESS_MM**3 / 12
    beta = (stiffness / (4 * rigidity)) ** 0.25
    long = beam(length_mm=4000.0, foundation_n_mm2=stiffness, supports=[])
    found = largest_stress_mpa(long, FORCE_N, (1500.0, 2600.0))
    assert found == pytest.approx(FORCE_N / (4 * beta) / SECTION_MM3, rel=0.01)
    assert beta * 1500 > 6


def test_without_a_thickness_there_is_no_stress_and_two_forces_stress_twice() -> None:
    assert largest_stress_mpa(beam(width_mm=None, thickness_mm=None, youngs_modulus_gpa=None,
        flexural_rigidity_n_mm2=1e7), FORCE_N, (0.0, 90.0)) is None  # fmt: skip
    one, two = (largest_stress_mpa(beam(), force_n, (37.0, 90.0)) for force_n in (3.0, 6.6))
    assert one is not None
    assert two == pytest.approx(2.2 * one)
    assert one == pytest.approx(3 * 90 * 310 / 400 / SECTION_MM3, rel=0.002)
