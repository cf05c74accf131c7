"""Principal components and the product of their eigenvalues: published, in 60 digits, at the ends of float64."""

from functools import cache

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.placement.eigenvalue_product import log_eigenvalue_product, principal_components
from beamtouch_models.design.scene.beam import Beam
from support.surfaces.example_scenes import UNIT_BEAM

beam = Beam.model_validate(UNIT_BEAM)
LOADS = np.arange(1, 400) / 400
LAYOUTS = {
    "32 at equal pitch": np.arange(1, 33) / 33,
    "32 a grid step apart": np.arange(100, 132) / 400,
    "5 and one beside a support": np.array([1e-9, 0.2, 0.4, 0.5, 0.9]),
}


BITS = 200
"""A float times two to this power is a whole number, if the float is not tiny."""


def exact_moment(matrix: Floats) -> mpmath.matrix:
    """X^T X / N0 in whole numbers, which are exact and quick, and then in 60 digits."""
    whole = np.array([[int(mpmath.ldexp(value, BITS)) for value in row] for row in matrix], dtype=object)
    with mpmath.workdps(60):
        unit = mpmath.ldexp(len(matrix), 2 * BITS)
        return mpmath.matrix([[mpmath.mpf(value) / unit for value in row] for row in whole.T @ whole])


@cache
def exact_eigenvalues(name: str) -> list[mpmath.mpf]:
    """Eigenvalues of X^T X / N0 of a layout, descending, in 60 digits."""
    with mpmath.workdps(60):
        return sorted(mpmath.eigsy(exact_moment(matrix_in(name)), eigvals_only=True), reverse=True)


def matrix_in(name: str) -> Floats:
    return influence(beam, LAYOUTS[name], LOADS)


@pytest.mark.parametrize("name", LAYOUTS)
def test_eigenvalues_and_the_log_of_their_product_are_accurate(name: str) -> None:
    matrix, expected = matrix_in(name), exact_eigenvalues(name)
    found = principal_components(matrix).eigenvalues
    with mpmath.workdps(60):
        errors = [abs(mpmath.mpf(float(value)) / exact - 1) for value, exact in zip(found, expected, strict=True)]
        log = mpmath.fsum(mpmath.log(value) for value in expected)
        log_error = abs(mpmath.mpf(float(log_eigenvalue_product(matrix))) - log)
    assert max(errors) < 1e-9
    assert log_error < 1e-11 * abs(log)
    assert log_error < 1e-10


@settings(max_examples=30)
@given(st.integers(-300, 300), st.integers(2, 6))
def test_any_scale_gives_the_same_digits(exponent: int, sensors: int) -> None:
    matrix = influence(beam, np.arange(1, sensors + 1) / (sensors + 1), LOADS)
    scaled = matrix * 10.0**exponent
    shift = 2 * sensors * exponent * np.log(10)
    assert log_eigenvalue_product(scaled) == pytest.approx(log_eigenvalue_product(matrix) + shift, abs=1e-9)
    if abs(exponent) < 140:
        unscaled = principal_components(scaled).eigenvalues / 10.0 ** (2 * exponent)
        assert unscaled == pytest.approx(principal_components(matrix).eigenvalues, rel=1e-9)


def test_the_product_is_right_for_sixty_four_sensors_and_for_a_single_load() -> None:
    matrix = influence(beam, np.arange(1, 65) / 65, LOADS)
    with mpmath.workdps(60):
        factor = mpmath.cholesky(exact_moment(matrix))
        expected = float(2 * mpmath.fsum(mpmath.log(factor[k, k]) for k in range(64)))
    assert log_eigenvalue_product(matrix) == pytest.approx(expected, rel=1e-11)
    one = influence(beam, [0.3, 0.6], [0.5])
    assert log_eigenvalue_product(one) == -np.inf
    assert log_eigenvalue_product(one, 1) == pytest.approx(np.log((one**2).sum()))
    assert principal_components(one).eigenvalues == pytest.approx([(one**2).sum()])


def matrix_of(*positions_mm: float) -> Floats:
    return influence(beam, np.array(positions_mm) / 400, LOADS)


def test_coincident_sensors_and_sensors_on_a_support_score_minus_infinity() -> None:
    for layout in ((100, 100), (0, 100), (0, 400)):
        assert log_eigenvalue_product(matrix_of(*layout)) == -np.inf
