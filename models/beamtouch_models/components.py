"""The paper's principal components of the influence matrix (eq. 2 and 3) and the product of their eigenvalues (eq. 4).

Everything comes from the singular values of the influence matrix, never from the eigenvalues of its square, so that the
small components keep their digits; products are sums of logarithms, so that nothing overflows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Components:
    """Principal components of an influence matrix of shape (loads, sensors)."""

    eigenvalues: Array
    """(sensors,), of X^T X / N0, in descending order, in the square of the unit of X."""
    vectors: Array
    """(sensors, sensors), a column per component, signed so that its largest entry is positive."""
    transformed: Array
    """(loads, sensors): the components of each load, what the paper's figure 3 shows."""


def principal_components(matrix: Array) -> Components:
    """Components of an influence matrix (loads, sensors); eq. 2 is a second moment about zero, not about the mean."""
    _, singular, rows = np.linalg.svd(matrix, full_matrices=False)
    vectors = rows.T
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None, :], axis=0)
    vectors = vectors * np.where(largest < 0, -1.0, 1.0)
    return Components(singular**2 / len(matrix), vectors, matrix @ vectors)


def log_eigenvalue_product(matrices: Array, leading: int | None = None) -> Array:
    """Natural logarithm of the product of the leading eigenvalues of eq. 2; minus the logarithm of eq. 4.

    Parameters
    ----------
    matrices : (..., loads, sensors) influence matrices
    leading : how many eigenvalues count, from the largest; all by default

    Returns
    -------
    (...) float64; minus infinity where sensors coincide or stand on a support.
    """
    singular = np.linalg.svd(matrices, compute_uv=False)[..., :leading]
    loads, sensors = matrices.shape[-2:]
    # What rounding alone leaves of a zero singular value is no signal.
    floor = singular[..., :1] * np.finfo(np.float64).eps * max(loads, sensors)
    with np.errstate(divide="ignore"):
        logs = 2 * np.log(np.where(singular > floor, singular, 0.0)) - np.log(loads)
    total: Array = logs.sum(axis=-1)
    return total
