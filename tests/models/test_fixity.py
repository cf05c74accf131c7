"""Supports with fixity, against the differential equation solved in 50 digits."""

import mpmath
import numpy as np
import pytest
from pydantic import ValidationError

from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import influence
from beamtouch_models.scene.beam import Beam, changed_beam
from example_scenes import UNIT_BEAM


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
