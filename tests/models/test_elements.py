"""Beam elements against transfer matrices in many digits, textbooks, and closed forms."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import influence
from beamtouch_models.scene.beam import Beam
from exact_beam import ExactBeam, fixed, simple

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
    supports=st.sampled_from(["simply-supported", "cantilever", "fixed-fixed", "propped", simple(120, 310)]),
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


@pytest.mark.parametrize("supports", ["simply-supported", "propped", simple(100), []])
@pytest.mark.parametrize("reach", [1e-6, 0.1, 5.0])
def test_foundations_from_soft_to_stiff_agree_with_transfer_matrices(supports: object, reach: float) -> None:
    # reach is beta l, with beta = (k / (4 EI))^(1/4).
    beam = stated(PLAIN, supports=supports, foundation_n_mm2=4e7 * (reach / 400) ** 4)
    if reach < 0.01 and not isinstance(supports, str):
        with pytest.raises(SceneError, match="held so loosely"):
            influence(beam, [57.0], [30.0])  # not on the support: there nothing bends, however it is held
        return
    check(beam, positions=POSITIONS[2:-1])


@pytest.mark.parametrize("reach", [100.0, 1000.0])
def test_long_beams_on_a_foundation_agree_with_hetenyis_infinite_and_half_infinite_beams(reach: float) -> None:
    # Hetenyi, Beams on Elastic Foundation, 1946: eq. 6a, and eq. 24a for a load at the free end.
    beta, stiffness = reach / 400, 4e7 * (reach / 400) ** 4
    beam = stated(PLAIN, supports=[], foundation_n_mm2=stiffness)
    away = np.array([0.0, 0.1, 1.0, 3.0, 8.0])
    infinite = beta / (2 * stiffness) * np.exp(-away) * (np.cos(away) + np.sin(away))
    assert influence(beam, 200 + away / beta, [200.0])[0] == pytest.approx(infinite, rel=1e-11)
    end = 2 * beta / stiffness * np.exp(-away) * np.cos(away)
    assert influence(beam, away / beta, [0.0])[0] == pytest.approx(end, rel=1e-11)


def test_deflections_agree_with_published_values() -> None:
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


def with_tip(tip: float) -> dict[str, Any]:
    return {"supports": "cantilever", "segments": [{"to_mm": 400 - tip}, {"to_mm": 400, "thickness_mm": 20}]}


@pytest.mark.parametrize("tip", [10.0, 0.1])
def test_short_segments_stay_accurate(tip: float) -> None:
    check(stated(STEEL, **with_tip(tip)), positions=np.array([100.0, 399.0, 400 - tip / 2, 400.0]))


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"foundation_n_mm2": 1e300}, "foundation_n_mm2 = 1e"),
        ({"foundation_n_mm2": 1e30}, "too stiff beside this beam"),
        ({"shear_modulus_gpa": 1e-320}, "shear deflection cannot be computed"),
        (with_tip(1e-4), "its parts are so uneven"),
        (with_tip(1e-7), "too close to be told apart"),
        ({"segments": [{"to_mm": 1e-9}, {"to_mm": 400, "thickness_mm": 9}]}, "too close to be told apart"),
    ],
)
def test_a_structure_that_cannot_be_computed_is_refused_by_name(values: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError, match=said):
        influence(stated(STEEL, **values), [100.0], [100.0])
