"""The influence matrix against published values and against virtual work in 40-digit arithmetic."""

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_models.beam import check_small_angles, influence, max_deflection_mm
from beamtouch_models.errors import SceneError
from beamtouch_models.scene import Beam, parse_scene
from example_scenes import PAPER, UNIT_BEAM

beam = Beam.model_validate(UNIT_BEAM)


def by_virtual_work(x: float, a: float) -> mpmath.mpf:
    """Deflection at x of a unit load at a on a unit beam: the integral of both bending moments' product."""
    with mpmath.workdps(40):
        left, right = mpmath.mpf(min(x, a)), mpmath.mpf(max(x, a))

        def moment(load: mpmath.mpf, at: mpmath.mpf) -> mpmath.mpf:
            return at * (1 - load) if at <= load else load * (1 - at)

        def product(at: mpmath.mpf) -> mpmath.mpf:
            return moment(left, at) * moment(right, at)

        # Three quadratic pieces: Gauss-Legendre is exact on each.
        return mpmath.quad(product, [0, left, right, 1], method="gauss-legendre", maxdegree=3)


@pytest.mark.parametrize(
    ("x", "a", "expected"),
    [
        (0.5, 0.5, 1 / 48),  # Roark's Formulas for Stress and Strain, table 8.1, case 1e
        (0.25, 0.5, 11 / 768),
        (0.5, 0.25, 11 / 768),
        (0.25, 0.25, 9 / 768),
        (0.75, 0.25, 7 / 768),
    ],
)
def test_published_deflections(x: float, a: float, expected: float) -> None:
    assert influence(beam, [x], [a])[0, 0] == pytest.approx(expected, rel=4e-16)


fractions = st.floats(1e-12, 1.0, exclude_max=True)


@given(x=fractions, a=fractions)
def test_a_few_units_in_the_last_place_over_the_whole_span(x: float, a: float) -> None:
    expected = by_virtual_work(x, a)
    assert abs((mpmath.mpf(influence(beam, [x], [a])[0, 0]) - expected) / expected) < 8 * 2.0**-53


@given(x=fractions, a=fractions)
def test_reciprocity_is_exact(x: float, a: float) -> None:
    assert influence(beam, [x], [a])[0, 0] == influence(beam, [a], [x])[0, 0]


@pytest.mark.parametrize("length", [1e-3, 400.0, 1e6])
@pytest.mark.parametrize("rigidity", [1e-15, 1.0, 1e15])
def test_scale(length: float, rigidity: float) -> None:
    scaled = Beam.model_validate({"length_mm": length, "flexural_rigidity_n_mm2": rigidity})
    assert influence(scaled, [length / 2], [length / 2])[0, 0] == pytest.approx(length**3 / 48 / rigidity, rel=1e-15)


def test_shape_is_loads_by_sensors_and_supports_do_not_move() -> None:
    matrix = influence(beam, [0.0, 0.3, 1.0], [0.1, 0.9])
    assert matrix.shape == (2, 3)
    assert np.all(matrix[:, [0, 2]] == 0)


@pytest.mark.parametrize("position", [[], [float("nan")], [float("inf")], [-0.1], [1.1]])
def test_what_is_no_position_is_refused_by_name(position: list[float]) -> None:
    with pytest.raises(ValueError, match="sensor_mm"):
        influence(beam, position, [0.5])
    with pytest.raises(ValueError, match="load_mm"):
        influence(beam, [0.5], position)


def test_largest_deflection_of_the_paper() -> None:
    # 10 N in the middle of 400 mm: F l^3 / (48 E I), E I = 1.18125e7 N mm^2.
    assert max_deflection_mm(parse_scene(PAPER, "x")) == pytest.approx(10 * 400**3 / (48 * 1.18125e7), rel=1e-12)


def test_a_beam_that_sags_beyond_small_angles_is_refused() -> None:
    check_small_angles(parse_scene(PAPER, "x"))
    with pytest.raises(SceneError, match="small-angle theory"):
        check_small_angles(parse_scene(PAPER.replace("force_n = 10.0", "force_n = 200.0"), "x"))
