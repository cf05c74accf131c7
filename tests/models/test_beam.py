"""Closed forms against published values and arithmetic in many digits, and where fixity goes."""

from typing import Any

import mpmath
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import influence, travel_of
from beamtouch_models.physics.closed_forms import span_of
from beamtouch_models.scene import parse_scene
from beamtouch_models.scene.beam import Beam, changed_beam
from exact_beam import ExactBeam, fixed, simple
from example_scenes import PAPER, UNIT_BEAM

ULP = 2.0**-53
NAMES = ("simply-supported", "cantilever", "fixed-fixed", "propped")
SPANS: list[Any] = [*NAMES, fixed(1.0), [*simple(0.0), *fixed(1.0)]]
"""All closed forms, and the mirrored ones."""


def unit_beam(supports: object, **values: object) -> Beam:
    return Beam.model_validate({**UNIT_BEAM, "supports": supports, **values})


@pytest.mark.parametrize(
    ("supports", "x", "a", "expected"),
    [
        # Roark's Formulas for Stress and Strain, table 8.1; Gere & Goodno, Mechanics of Materials, appendix H.
        ("simply-supported", 0.5, 0.5, 1 / 48),
        ("simply-supported", 0.25, 0.5, 11 / 768),
        ("simply-supported", 0.5, 0.25, 11 / 768),
        ("simply-supported", 0.25, 0.25, 9 / 768),
        ("simply-supported", 0.75, 0.25, 7 / 768),
        ("cantilever", 1.0, 1.0, 1 / 3),
        ("cantilever", 1.0, 0.5, 5 / 48),
        ("cantilever", 0.5, 0.5, 1 / 24),
        ("fixed-fixed", 0.5, 0.5, 1 / 192),
        ("propped", 0.5, 0.5, 7 / 768),
    ],
)
def test_deflections_agree_with_published_values(supports: str, x: float, a: float, expected: float) -> None:
    assert influence(unit_beam(supports), [x], [a])[0, 0] == pytest.approx(expected, rel=4 * ULP)


small = st.floats(-12, -1).map(lambda power: 10.0**power)
fractions = st.floats(1e-12, 1.0, exclude_max=True) | small | small.map(lambda distance: 1 - distance)


@settings(max_examples=40)
@given(
    x=fractions,
    a=fractions,
    supports=st.sampled_from(SPANS),
    length=st.just(1.0) | st.floats(1e-3, 1e6),
    power=st.integers(-15, 15),
)
def test_every_closed_form_is_accurate_near_either_end_at_any_scale(
    x: float, a: float, supports: list[dict[str, float]] | str, length: float, power: int
) -> None:
    # Lengths from 1 micrometre to 1 km, and rigidities over 30 decades.
    if not isinstance(supports, str):
        supports = [{**one, "at_mm": length * one["at_mm"]} for one in supports]
    stated = unit_beam(supports, length_mm=length, flexural_rigidity_n_mm2=10.0**power)
    assert span_of(stated, 0.0, length) is not None
    sensor, load = x * length, a * length
    expected = ExactBeam(stated, digits=120).deflection(sensor, load)
    if expected:  # x times the length may round to the length, where the deflection is 0
        assert abs((mpmath.mpf(influence(stated, [sensor], [load])[0, 0]) - expected) / expected) < 16 * ULP


@settings(max_examples=25)
@given(x=fractions, a=st.integers(1, 4095), width=st.integers(1, 4096), supports=st.sampled_from(SPANS))
def test_a_contact_with_a_width_is_exact(x: float, a: int, width: int, supports: object) -> None:
    # Multiples of 1/8192, so that both sides compute the same edges of the contact.
    stated = unit_beam(supports)
    expected = ExactBeam(stated, digits=120).deflection(x, a / 4096, width / 4096)
    found = influence(stated, [x], [a / 4096], width / 4096)[0, 0]
    assert abs((mpmath.mpf(found) - expected) / expected) < 32 * ULP


@given(x=fractions, a=fractions, supports=st.sampled_from(SPANS), power=st.integers(-320, -14))
def test_a_contact_that_narrows_to_a_point_stays_accurate(x: float, a: float, supports: object, power: int) -> None:
    stated, width = unit_beam(supports), min(10.0**power, 1e-14 * min(a, 1 - a))
    point = influence(stated, [x], [a])[0, 0]
    assert influence(stated, [x], [a], width)[0, 0] == pytest.approx(point, rel=1e-13)


def test_a_contact_beyond_the_end_puts_its_whole_force_on_the_part_on_the_beam() -> None:
    tip = unit_beam("cantilever")
    assert influence(tip, [1.0], [1.0], 0.5)[0, 0] == influence(tip, [1.0], [0.875], 0.25)[0, 0]


def test_beams_beyond_float64_are_refused() -> None:
    for length, rigidity in ((1e300, 1.0), (1e-300, 1.0), (1.0, 1e300 * 1e8), (1e103, 1e-100)):
        with pytest.raises(SceneError, match="deflects beyond what can be computed"):
            influence(unit_beam("propped", length_mm=length, flexural_rigidity_n_mm2=rigidity), [0.0], [0.0])
    # Within the range of float64 both may be large, also if the cube of the length overflows.
    for length, expected in ((1e120, 1e60 / 3), (1e150, 1e150 / 3)):
        stated = unit_beam("cantilever", length_mm=length, flexural_rigidity_n_mm2=1e300)
        assert influence(stated, [length], [length])[0, 0] == pytest.approx(expected, rel=1e-14)


def test_a_load_on_one_of_two_spans_lifts_the_other() -> None:
    text = PAPER.replace("[contact]", "supports = [{at_mm = 0}, {at_mm = 200}, {at_mm = 400}]\n[contact]")
    travel = travel_of(parse_scene(text, "x"))
    assert 0 < travel.lift_mm < travel.fall_mm == travel.largest_mm


def test_a_fixity_goes_to_a_support_that_is_there() -> None:
    one, none = (unit_beam(supports, foundation_n_mm2=1.0) for supports in ([{"at_mm": 0.0}], []))
    assert [support.fixity for support in changed_beam(one, 1.0, (0.3, 0.0)).support_list] == [0.3]
    for beam, fixity, said in ((none, (0.1, 0.0), "the beam has no support"), (one, (0.1, 0.2), "the beam has 1 sup")):
        with pytest.raises(SceneError, match=said):
            changed_beam(beam, 1.0, fixity)
