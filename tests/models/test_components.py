"""Principal components, and the product of their eigenvalues."""

import numpy as np
import pytest

from beamtouch_models.physics.beam import influence
from beamtouch_models.placement.components import log_eigenvalue_product, principal_components
from beamtouch_models.scene.beam import Beam
from example_scenes import UNIT_BEAM

beam = Beam.model_validate(UNIT_BEAM)
loads = np.arange(1, 400) / 400


def matrix_of(*positions_mm: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return influence(beam, np.array(positions_mm) / 400, loads)


@pytest.mark.parametrize(("layout", "expected"), [((122, 278), -21.6047), ((68, 156, 244, 332), -55.4483)])
def test_the_known_optima_score_as_published(layout: tuple[float, ...], expected: float) -> None:
    assert log_eigenvalue_product(matrix_of(*layout)) == pytest.approx(expected, abs=5e-5)


def test_eigenvalues_are_those_of_the_second_moment() -> None:
    matrix = matrix_of(80, 160, 240, 320)
    found = principal_components(matrix)
    # numpy's symmetric eigensolver on eq. 2 as printed; good to eps x the first eigenvalue.
    expected = np.linalg.eigvalsh(matrix.T @ matrix / len(matrix))[::-1]
    assert found.eigenvalues == pytest.approx(expected, rel=1e-9, abs=1e-15 * expected[0])
    assert found.vectors.T @ found.vectors == pytest.approx(np.eye(4), abs=1e-14)
    assert (found.transformed**2).mean(axis=0) == pytest.approx(found.eigenvalues, rel=1e-9)


def test_eigenvalues_of_eight_sensors_fall_like_the_eighth_power() -> None:
    # The paper's figure 3: the ratios tend to (1/k)^8, second to first 0.0039.
    eigenvalues = principal_components(matrix_of(*(400 * np.arange(1, 9) / 9))).eigenvalues
    assert eigenvalues[1] / eigenvalues[0] == pytest.approx(2.0**-8, rel=0.02)
    assert eigenvalues[2] / eigenvalues[0] == pytest.approx(3.0**-8, rel=0.05)


def test_coincident_sensors_and_sensors_on_a_support_score_minus_infinity() -> None:
    assert log_eigenvalue_product(matrix_of(100, 100)) == -np.inf
    assert log_eigenvalue_product(matrix_of(0, 100)) == -np.inf
    assert log_eigenvalue_product(matrix_of(0, 400)) == -np.inf


def test_the_product_of_the_leading_eigenvalues_only() -> None:
    matrix = matrix_of(100, 100, 300)
    first_two = principal_components(matrix).eigenvalues[:2]
    assert log_eigenvalue_product(matrix, 2) == pytest.approx(np.log(first_two).sum(), rel=1e-12)


@pytest.mark.parametrize(("entry", "said"), [(np.nan, "must be finite"), (np.inf, "must be finite"), (1e200, "scale")])
def test_a_matrix_without_eigenvalues_in_float64_is_refused(entry: float, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        principal_components(np.full((3, 2), entry))


def test_scales_at_which_a_product_would_overflow() -> None:
    matrix = matrix_of(68, 156, 244, 332)
    for scale in (1e-150, 1e150):
        shifted = log_eigenvalue_product(matrix * scale) - 8 * np.log(scale)
        assert shifted == pytest.approx(-55.4483, abs=5e-5)
