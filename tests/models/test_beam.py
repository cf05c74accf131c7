"""Closed forms and supports with fixity, against published values and arithmetic in many digits."""

from typing import Any

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

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
beam = Beam.model_validate(UNIT_BEAM)


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


def test_the_largest_deflection_of_a_propped_span_is_the_published_one() -> None:
    # Roark, table 8.1 case 1c: 0.0098 W l^3/(EI), with the load 0.414 l from the simple end.
    points = np.linspace(0, 1, 1001)
    matrix = influence(unit_beam("propped"), points, points)
    load, sensor = np.unravel_index(matrix.argmax(), matrix.shape)
    assert matrix.max() == pytest.approx(0.0098, abs=0.00005)
    assert points[load] == pytest.approx(1 - 0.414, abs=0.0011)
    assert points[sensor] == pytest.approx(1 - 0.414, abs=0.0011)


small = st.floats(-12, -1).map(lambda power: 10.0**power)
fractions = st.floats(1e-12, 1.0, exclude_max=True) | small | small.map(lambda distance: 1 - distance)


@settings(max_examples=40)
@given(x=fractions, a=fractions, supports=st.sampled_from(SPANS))
def test_every_closed_form_is_accurate_near_either_end(x: float, a: float, supports: object) -> None:
    stated = unit_beam(supports)
    assert span_of(stated, 0.0, 1.0) is not None
    expected = ExactBeam(stated, digits=120).deflection(x, a)
    assert abs((mpmath.mpf(influence(stated, [x], [a])[0, 0]) - expected) / expected) < 12 * ULP


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


@settings(max_examples=40)
@given(x=fractions, a=fractions, supports=st.sampled_from(SPANS))
def test_reciprocity_is_exact(x: float, a: float, supports: object) -> None:
    stated = unit_beam(supports)
    assert influence(stated, [x], [a])[0, 0] == influence(stated, [a], [x])[0, 0]


@settings(max_examples=40)
@given(x=fractions, a=fractions, length=st.floats(1e-3, 1e6), power=st.integers(-15, 15))
def test_deflections_scale_with_length_and_rigidity(x: float, a: float, length: float, power: int) -> None:
    # Lengths from 1 micrometre to 1 km, and rigidities over 30 decades.
    stated = unit_beam("propped", length_mm=length, flexural_rigidity_n_mm2=10.0**power)
    sensor, load = x * length, a * length
    expected = ExactBeam(stated, digits=120).deflection(sensor, load)
    found = mpmath.mpf(influence(stated, [sensor], [load])[0, 0])
    if expected:  # x times the length may round to the length, where the deflection is 0
        assert abs((found - expected) / expected) < 16 * ULP


def test_beams_beyond_float64_are_refused() -> None:
    for length, rigidity in ((1e300, 1.0), (1e-300, 1.0), (1.0, 1e300 * 1e8), (1e103, 1e-100)):
        with pytest.raises(SceneError, match="deflects beyond what can be computed"):
            influence(unit_beam("propped", length_mm=length, flexural_rigidity_n_mm2=rigidity), [0.0], [0.0])
    # Within the range of float64 both may be large, also if the cube of the length overflows.
    stated = unit_beam("cantilever", length_mm=1e120, flexural_rigidity_n_mm2=1e300)
    assert influence(stated, [1e120], [1e120])[0, 0] == pytest.approx(1e60 / 3, rel=1e-14)
    assert influence(unit_beam("cantilever", length_mm=1e150, flexural_rigidity_n_mm2=1e300), [1e150], [1e150])[
        0, 0
    ] == pytest.approx(1e150 / 3, rel=1e-14)


@pytest.mark.parametrize("supports", SPANS)
def test_shape_is_loads_by_sensors_and_supports_do_not_move(supports: object) -> None:
    stated = unit_beam(supports)
    matrix = influence(stated, [0.0, 0.3, 1.0], [0.1, 0.9])
    held = [support.at_mm for support in stated.support_list]
    assert matrix.shape == (2, 3)
    assert np.array_equal(matrix == 0, np.broadcast_to(np.isin([0.0, 0.3, 1.0], held), (2, 3)))


@pytest.mark.parametrize("position", [[], [[0.5]], [float("nan")], [float("inf")], [-0.1], [1.1]])
def test_an_invalid_position_is_refused_by_name(position: list[float]) -> None:
    with pytest.raises(ValueError, match="sensor_mm"):
        influence(beam, position, [0.5])
    with pytest.raises(ValueError, match="load_mm"):
        influence(beam, [0.5], position)


def test_a_load_on_one_of_two_spans_lifts_the_other() -> None:
    text = PAPER.replace("[contact]", "supports = [{at_mm = 0}, {at_mm = 200}, {at_mm = 400}]\n[contact]")
    travel = travel_of(parse_scene(text, "x"))
    assert 0 < travel.lift_mm < travel.fall_mm == travel.largest_mm


@settings(max_examples=40)
@given(
    x=st.floats(1e-9, 400, exclude_max=True),
    a=st.floats(1e-9, 400, exclude_max=True),
    modulus=st.floats(1e-3, 1e4),
    supports=st.sampled_from(["simply-supported", "cantilever", simple(30.0, 370.0)]),
)
def test_shear_of_a_determinate_span_is_exact(x: float, a: float, modulus: float, supports: object) -> None:
    stated = {"length_mm": 400, "youngs_modulus_gpa": 210, "width_mm": 25, "thickness_mm": 30}
    sheared = Beam.model_validate({**stated, "supports": supports, "shear_modulus_gpa": modulus})
    span = span_of(sheared, min(x, a), max(x, a))
    if span is None:
        assert not isinstance(supports, str)
        assert min(x, a) < 30 or max(x, a) > 370
        return
    assert span.shear > 0
    expected = ExactBeam(sheared, 60).deflection(x, a)
    assert abs(mpmath.mpf(influence(sheared, [x], [a])[0, 0]) - expected) <= 24 * ULP * abs(expected)


def beam_with(left: float, right: float, **others: object) -> Beam:
    supports = [{"at_mm": 0.0, "fixity": left}, {"at_mm": 1.0, "fixity": right}]
    return Beam.model_validate({**UNIT_BEAM, "supports": supports, **others})


def exact(left: float, right: float, sensor: float, load: float) -> float:
    """Deflection of a unit beam with rotational springs at its ends, under a unit load.

    w = w0 + the reaction to unknown end moments: w(x) = c1 x + c3 x^3 + b2 x^2 - <x - a>^3 / 6 with E I w'' = M, end
    conditions w(1) = 0, w''(0) = k0 w'(0), w''(1) = -k1 w'(1), solved as a linear system. Positive along the load.
    """
    with mpmath.workdps(50):
        a, x = mpmath.mpf(load), mpmath.mpf(sensor)
        k0, k1 = (3 * mpmath.mpf(f) / (1 - mpmath.mpf(f)) for f in (left, right))
        # Solve for c1, b2, c3 in w = c1 x + b2 x^2 + c3 x^3 + <x - a>^3 / 6 (w'''' = load).
        d = 1 - a
        matrix = mpmath.matrix([[1, 1, 1], [-k0, 2, 0], [k1, 2 + 2 * k1, 6 + 3 * k1]])
        right_side = mpmath.matrix([-(d**3) / 6, 0, -d - k1 * d**2 / 2])
        c1, b2, c3 = mpmath.lu_solve(matrix, right_side)
        return float(c1 * x + b2 * x**2 + c3 * x**3 + max(x - a, mpmath.mpf(0)) ** 3 / 6)


@pytest.mark.parametrize("fixity", [(0.05, 0.0), (0.0, 0.3), (0.5, 0.5), (0.999, 0.2), (1e-9, 1 - 1e-9)])
def test_the_influence_solves_the_differential_equation(fixity: tuple[float, float]) -> None:
    sensors, loads = np.array([0.1, 0.37, 0.5, 0.93]), np.array([1e-3, 0.2, 0.5, 0.71, 0.999])
    found = influence(beam_with(*fixity), sensors, loads)
    expected = [[exact(*fixity, sensor, load) for sensor in sensors] for load in loads]
    assert found == pytest.approx(np.array(expected), rel=1e-9)


@pytest.mark.parametrize(("fixity", "name"), [(1e-14, "simply-supported"), (1 - 1e-14, "fixed-fixed")])
def test_fixity_approaches_a_hinge_at_0_and_a_fixed_end_at_1(fixity: float, name: str) -> None:
    places = np.linspace(0.05, 0.95, 7)
    limit = influence(Beam.model_validate({**UNIT_BEAM, "supports": name}), places, places)
    assert influence(beam_with(fixity, fixity), places, places) == pytest.approx(limit, rel=1e-9)


def test_influence_is_symmetric_with_steps_and_fixity() -> None:
    steps = [{"to_mm": 0.4, "flexural_rigidity_n_mm2": 0.3}, {"to_mm": 1.0, "flexural_rigidity_n_mm2": 1.0}]
    beam = beam_with(0.2, 0.0, segments=steps)
    places = np.linspace(0.05, 0.95, 9)
    matrix = influence(beam, places, places)
    assert matrix == pytest.approx(matrix.T, rel=1e-11)


def test_one_support_with_fixity_carries_a_beam() -> None:
    beam = Beam.model_validate({**UNIT_BEAM, "supports": [{"at_mm": 0.0, "fixity": 0.5}]})
    # A cantilever on a spring of k = 3: bending x^3 / 3 and the wall's rotation x^2 / 3 at the load itself.
    assert influence(beam, [0.6], [0.6])[0, 0] == pytest.approx(0.6**3 / 3 + 0.6**2 / 3, rel=1e-10)


@pytest.mark.parametrize(
    ("support", "said"),
    [
        ({"at_mm": 0.0, "kind": "fixed", "fixity": 0.1}, "no fixity"),
        ({"at_mm": 0.0, "fixity": 1.0}, "less than 1"),
        ({"at_mm": 0.0, "fixity": -0.1}, "greater than or equal to 0"),
        ({"at_mm": 0.0, "fixity": 0.0}, "lets the beam rotate"),
    ],
)
def test_an_invalid_fixity_is_refused(support: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Beam.model_validate({**UNIT_BEAM, "supports": [support]})


@pytest.mark.parametrize(
    ("supports", "rigidity", "fixity", "said"),
    [
        ([], 1.0, (0.1, 0.0), "the beam has no support"),
        ([], 1.0, (0.0, 0.1), "the beam has no support"),
        ([{"at_mm": 0.0}], 1.0, (0.1, 0.2), "the beam has 1 support"),
        ([{"at_mm": 0.0}, {"at_mm": 1.0, "kind": "fixed"}], 1.0, (0.0, 0.2), "already fixed"),
        ([], 5e-324, (0.0, 0.0), "rigidity: a flexural rigidity of .* cannot be computed with"),
    ],
)
def test_a_change_that_the_beam_cannot_take_is_a_scene_error(
    supports: list[dict[str, object]], rigidity: float, fixity: tuple[float, float], said: str
) -> None:
    beam = Beam.model_validate({**UNIT_BEAM, "supports": supports, "foundation_n_mm2": 1.0})
    with pytest.raises(SceneError, match=said):
        changed_beam(beam, rigidity, fixity)


def test_the_only_support_of_a_beam_takes_the_first_fixity() -> None:
    beam = Beam.model_validate({**UNIT_BEAM, "supports": [{"at_mm": 0.0}], "foundation_n_mm2": 1.0})
    assert [support.fixity for support in changed_beam(beam, 1.0, (0.3, 0.0)).support_list] == [0.3]
