"""The influence matrix against published values and transfer matrices in many digits: closed forms, then elements.

The lift of a span follows from it.
"""

import math
from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from beamtouch_models import influence_matrix
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.physics.closed_forms import span_of
from beamtouch_models.design.physics.influence_function import travel_of
from beamtouch_models.design.scene import parse_scene
from beamtouch_models.design.scene.beam import Beam, changed_beam
from beamtouch_models.errors import SceneError
from models.exact_beam import ExactBeam, fixed, simple
from support.surfaces.example_scenes import PAPER, UNIT_BEAM

SCENE = parse_scene(PAPER, "paper.toml")
ULP = 2.0**-53
NAMES = ("simply-supported", "cantilever", "fixed-fixed", "propped")
SPANS: list[Any] = [*NAMES, fixed(1.0), [*simple(0.0), *fixed(1.0)]]
"""All closed forms, and the mirrored ones."""


def influence(beam: Beam, sensor_mm: ArrayLike, load_mm: ArrayLike, width_mm: float = 0.0) -> Floats:
    """Return the influence matrix of a scene with this beam and this width of its contact."""
    contact = SCENE.contact.model_copy(update={"width_mm": width_mm})
    return influence_matrix(SCENE.model_copy(update={"stated_beam": beam, "contact": contact}), sensor_mm, load_mm)


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


def test_a_fixity_goes_to_a_support_that_is_there() -> None:
    one, none = (unit_beam(supports, foundation_n_mm2=1.0) for supports in ([{"at_mm": 0.0}], []))
    assert [support.fixity for support in changed_beam(one, 1.0, (0.3, 0.0)).support_list] == [0.3]
    three = unit_beam(simple(0.0, 0.4, 1.0))
    assert [support.fixity for support in changed_beam(three, 1.0, (0.3, 0.2)).support_list] == [0.3, 0.0, 0.2]
    assert [support.fixity for support in changed_beam(three, 1.0, (0.0, 0.2)).support_list] == [0.0, 0.0, 0.2]
    with pytest.raises(SceneError, match="fixity: that support is already fixed; give it 0"):
        changed_beam(unit_beam("propped"), 1.0, (0.1, 0.2))
    with pytest.raises(SceneError, match="rigidity: must be a finite number"):
        changed_beam(three, math.inf, (0.0, 0.0))
    for beam, fixity, said in ((none, (0.1, 0.0), "the beam has no support"), (one, (0.1, 0.2), "the beam has 1 sup")):
        with pytest.raises(SceneError, match=said):
            changed_beam(beam, 1.0, fixity)


STEEL = {"length_mm": 400.0, "youngs_modulus_gpa": 210.0, "width_mm": 25.0, "thickness_mm": 30.0}
PLAIN = {"length_mm": 400.0, "flexural_rigidity_n_mm2": 1e7}
STEPS = [{"to_mm": 100, "thickness_mm": 3}, {"to_mm": 250}, {"to_mm": 400, "thickness_mm": 10, "width_mm": 40}]
TOLERANCE = 1e-13
POSITIONS = np.array([0.0, 1e-3, 37.0, 100.0, 172.3, 260.0, 399.9, 400.0])


def stated(*parts: dict[str, Any], **values: object) -> Beam:
    return Beam.model_validate({key: value for part in (*parts, values) for key, value in part.items()})


def check(beam: Beam, width: float = 0.0, positions: np.ndarray = POSITIONS) -> None:
    """Compare with the exact beam at `positions`, in units of the largest deflection."""
    exact = ExactBeam(beam, 60)
    expected = np.array([[float(exact.deflection(x, a, width)) for x in positions[::2]] for a in positions])
    found = influence(beam, positions[::2], positions, width)
    assert np.abs(found - expected).max() <= TOLERANCE * np.abs(expected).max()


def halves(to_mm: float, first: float, second: float) -> list[dict[str, float]]:
    """Two segments by their rigidities."""
    return [{"to_mm": to_mm, "flexural_rigidity_n_mm2": first}, {"to_mm": 400.0, "flexural_rigidity_n_mm2": second}]


def springy(left: float, right: float) -> list[dict[str, float]]:
    """Supports at both ends by their fixity."""
    return [{"at_mm": 0, "fixity": left}, {"at_mm": 400, "fixity": right}]


STRUCTURES = {
    "two spans with overhangs": stated(STEEL, supports=simple(50, 200, 350)),
    "overhangs": stated(STEEL, supports=simple(50, 350)),
    "fixed in the middle": stated(STEEL, supports=fixed(170)),
    "fixed and many simple": stated(STEEL, supports=[*fixed(0), *simple(100, 200, 300, 400)]),
    "steps": stated(STEEL, segments=STEPS),
    "steps on a cantilever": stated(STEEL, segments=STEPS, supports="cantilever"),
    "shear": stated(STEEL, shear_modulus_gpa=80),
    "shear, cantilever": stated(STEEL, shear_modulus_gpa=0.8, supports="cantilever"),
    "shear, overhangs": stated(STEEL, shear_modulus_gpa=0.8, supports=simple(30, 370)),
    "shear, fixed-fixed": stated(STEEL, shear_modulus_gpa=8, supports="fixed-fixed"),
    "shear, propped, steps": stated(STEEL, shear_modulus_gpa=8, supports="propped", segments=STEPS),
    "foundation": stated(STEEL, foundation_n_mm2=50),
    "nothing but a foundation": stated(STEEL, foundation_n_mm2=50, supports=[]),
    "foundation and one support": stated(STEEL, foundation_n_mm2=5, supports=simple(100)),
    "fixity at one end": stated(PLAIN, supports=springy(0.05, 0.0)),
    "fixity at both ends": stated(PLAIN, supports=springy(0.999, 0.2)),
    "hardly a hinge, hardly not fixed": stated(PLAIN, supports=springy(1e-9, 1 - 1e-9)),
    "one support with fixity": stated(PLAIN, supports=[{"at_mm": 0, "fixity": 0.5}]),
    "fixity and steps": stated(STEEL, supports=springy(0.2, 0.0), segments=STEPS),
    "two supports close together": stated(STEEL, supports=simple(100, 101)),
    "two supports that act as a clamp": stated(STEEL, supports=simple(100, 100 + 1e-6)),
    "a soft part": stated({"length_mm": 400}, supports="propped", segments=halves(130, 1e7, 1e-5)),
    "a stiff part": stated({"length_mm": 400}, supports="propped", segments=halves(130, 1e7, 1e11)),
    "everything": stated(
        STEEL, foundation_n_mm2=50, shear_modulus_gpa=0.8, segments=STEPS, supports=[*fixed(20), *simple(300)]
    ),
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_point_loads_agree_with_transfer_matrices(name: str) -> None:
    check(STRUCTURES[name])


@pytest.mark.parametrize("name", ["two spans with overhangs", "steps", "foundation", "everything"])
def test_wide_contacts_agree_with_transfer_matrices(name: str) -> None:
    check(STRUCTURES[name], width=130.0, positions=POSITIONS[1:-1])


@settings(max_examples=12)
@given(
    x=st.floats(0, 400),
    a=st.floats(0, 400),
    step=st.floats(0.5, 399.5),
    thickness=st.floats(0.3, 300),
    supports=st.sampled_from([*NAMES, simple(120, 310)]),
    modulus=st.none() | st.floats(1e-3, 1e3),
)
def test_any_step_in_section_agrees_with_transfer_matrices(
    x: float, a: float, step: float, thickness: float, supports: object, modulus: float | None
) -> None:
    segments = [{"to_mm": step, "thickness_mm": thickness}, {"to_mm": 400}]
    beam = stated(STEEL, segments=segments, supports=supports, shear_modulus_gpa=modulus)
    points = np.linspace(0, 400, 41)
    expected = float(ExactBeam(beam, 80).deflection(x, a))
    assert abs(influence(beam, [x], [a])[0, 0] - expected) <= 1e-11 * np.abs(influence(beam, points, points)).max()


def test_a_load_nearly_on_a_support_is_not_refused() -> None:
    segments = [{"to_mm": 1.0, "thickness_mm": 2.0}, {"to_mm": 400}]
    beam = stated(STEEL, segments=segments, shear_modulus_gpa=2.0)
    assert 0 <= influence(beam, [2.2250738585e-313], [200.0])[0, 0] < 1e-307


def on_foundation(reach: float, supports: object) -> Beam:
    """`reach` is beta l, with beta = (k / (4 EI))^(1/4)."""
    return stated(PLAIN, supports=supports, foundation_n_mm2=4e7 * (reach / 400) ** 4)


@pytest.mark.parametrize(
    ("supports", "reach"),
    [
        *(("simply-supported", reach) for reach in (1e-6, 0.1, 5.0)),
        *((supports, reach) for supports in (simple(100), []) for reach in (0.1, 5.0)),
    ],
)
def test_foundations_from_soft_to_stiff_agree_with_transfer_matrices(supports: object, reach: float) -> None:
    check(on_foundation(reach, supports), positions=POSITIONS[2:-1])


@pytest.mark.parametrize("reach", [100.0, 1000.0])
def test_long_beams_on_a_foundation_agree_with_hetenyis_infinite_and_half_infinite_beams(reach: float) -> None:
    # Hetenyi, Beams on Elastic Foundation, 1946: eq. 6a, and eq. 24a for a load at the free end.
    beta, beam = reach / 400, on_foundation(reach, [])
    stiffness = beam.foundation_n_mm2 or 0.0
    away = np.array([0.0, 0.1, 1.0, 3.0, 8.0])
    infinite = beta / (2 * stiffness) * np.exp(-away) * (np.cos(away) + np.sin(away))
    assert influence(beam, 200 + away / beta, [200.0])[0] == pytest.approx(infinite, rel=1e-11)
    end = 2 * beta / stiffness * np.exp(-away) * np.cos(away)
    assert influence(beam, away / beta, [0.0])[0] == pytest.approx(end, rel=1e-11)


def test_shear_spans_overhangs_and_steps_agree_with_published_values() -> None:
    # Timoshenko & Gere, Mechanics of Materials, sec. 12.12: shear adds F l / (4 k G A) in the middle, F l / (k G A) at
    # the end of a cantilever.
    area, middle = 25 * 30, 400**3 / (48 * 210e3 * 25 * 30**3 / 12)
    found = influence(stated(STEEL, shear_modulus_gpa=80), [200.0], [200.0])[0, 0]
    assert found - middle == pytest.approx(400 / (4 * 5 / 6 * 80e3 * area), rel=1e-11)
    found = influence(stated(STEEL, shear_modulus_gpa=80, supports="cantilever"), [400.0], [400.0])[0, 0]
    assert found - 16 * middle == pytest.approx(400 / (5 / 6 * 80e3 * area), rel=1e-10)
    # Two equal spans, one loaded in its middle: 0.01497 W l^3/(EI) there. AISC Steel Construction Manual, table 3-23,
    # case 29: 23/1536 from the reactions 13/32, 11/16 and -3/32.
    found = influence(stated(PLAIN, supports=simple(0, 200, 400)), [100.0], [100.0])[0, 0]
    assert found == pytest.approx(23 / 1536 * 200**3 / 1e7, rel=1e-12)
    # An overhang c beyond a span l, loaded at its end: W c^2 (l + c) / (3 EI). AISC, table 3-23, case 26.
    found = influence(stated(PLAIN, supports=simple(0, 300)), [400.0], [400.0])[0, 0]
    assert found == pytest.approx(100**2 * 400 / (3 * 1e7), rel=1e-12)
    # A cantilever whose inner half is twice as stiff: 1/3 (1/8 + 7/8/2) W l^3/(EI), by virtual work.
    beam = stated({"length_mm": 400}, supports="cantilever", segments=halves(200, 2e7, 1e7))
    found = influence(beam, [400.0], [400.0])[0, 0]
    assert found == pytest.approx((1 / 8 + 7 / 16) / 3 * 400**3 / 1e7, rel=1e-13)


def test_a_load_on_one_of_two_spans_lifts_the_other() -> None:
    text = PAPER.replace("[contact]", "supports = [{at_mm = 0}, {at_mm = 200}, {at_mm = 400}]\n[contact]")
    travel = travel_of(influence_of(parse_scene(text, "x")))
    assert 0 < travel.lift_mm < travel.fall_mm == travel.largest_mm


def with_tip(tip: float) -> dict[str, Any]:
    return {"supports": "cantilever", "segments": [{"to_mm": 400 - tip}, {"to_mm": 400, "thickness_mm": 20}]}


@pytest.mark.parametrize("tip", [10.0, 0.1])
def test_short_segments_stay_accurate(tip: float) -> None:
    check(stated(STEEL, **with_tip(tip)), positions=np.array([100.0, 399.0, 400 - tip / 2, 400.0]))


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"foundation_n_mm2": 1e-20, "supports": simple(100)}, "held so loosely"),
        ({"foundation_n_mm2": 1e300}, "foundation_n_mm2 = 1e"),
        ({"foundation_n_mm2": 1e308}, r"1e\+308 is too stiff beside this beam"),
        ({"foundation_n_mm2": 1e308, "shear_modulus_gpa": 80}, "too stiff beside this beam"),
        ({"foundation_n_mm2": 1e30}, "too stiff beside this beam"),
        ({"shear_modulus_gpa": 1e-320}, "shear deflection cannot be computed"),
        (with_tip(1e-4), "its parts are so uneven"),
        (with_tip(1e-7), "too close to be told apart"),
        ({"segments": [{"to_mm": 1e-9}, {"to_mm": 400, "thickness_mm": 9}]}, "too close to be told apart"),
    ],
)
def test_a_structure_that_cannot_be_computed_is_refused_by_name(values: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        influence(stated(STEEL, **values), [57.0], [30.0])


def test_a_beam_on_a_stiff_foundation_is_computed_until_it_would_take_too_many_elements() -> None:
    """An element is at most half as long as (4 E I / k)^(1/4): the first beam has 2000 of them, the second 20 119."""
    beta = 2.5
    long = stated({**PLAIN, "length_mm": 400.0}, foundation_n_mm2=4e7 * beta**4, supports=[])
    # Hetenyi, 1946, eq. 6a: the middle of a beam without end sinks by F beta / (2 k).
    assert influence(long, [200.0], [200.0])[0, 0] == pytest.approx(beta / (2 * 4e7 * beta**4), rel=1e-9)
    with pytest.raises(SceneError, match=r"^beam.foundation_n_mm2 = 1.6e\+13 is too stiff beside this beam; make it s"):
        influence(stated(PLAIN, foundation_n_mm2=1.6e13, supports=[]), [200.0], [200.0])


def test_nothing_moves_at_a_support_under_a_point_or_a_wide_contact() -> None:
    beam = stated(STEEL, foundation_n_mm2=50, segments=STEPS, supports=[*fixed(20), *simple(300)])
    for width in (0.0, 30.0):
        found = influence(beam, [20.0, 150.0, 300.0], [90.0, 300.0], width)
        assert found[:, [0, 2]].tolist() == [[0, 0], [0, 0]]
        assert found[0, 1] != 0
    assert influence(beam, [150.0], [20.0, 300.0]).tolist() == [[0], [0]]
    assert influence(beam, [150.0], [300.0], 30.0)[0, 0] != 0


@pytest.mark.parametrize(
    ("low", "high", "has_form"),
    [(0.2, 0.7, True), (0.3, 0.6, True), (0.19, 0.6, False), (0.3, 0.71, False)],
)
def test_between_two_supports_and_no_farther_a_beam_has_a_closed_form(
    low: float, high: float, *, has_form: bool
) -> None:
    beam = unit_beam([{"at_mm": 0.2, "kind": "simple"}, {"at_mm": 0.7, "kind": "fixed"}])
    span = span_of(beam, low, high)
    assert (span is not None) is has_form
    if span is not None:
        assert (span.form, span.start_mm, span.end_mm, span.mirrored) == ("propped", 0.2, 0.7, True)
