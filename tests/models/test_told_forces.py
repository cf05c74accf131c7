"""The force that a graph tells, on a bar whose sensors do not show the place: a mixture of two normal densities."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Forces, Prior, forces_of, interval_forces
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.force_range import ForceRange
from beamtouch_models.runtime.session import runner

SHAPE = np.array([0.03, 0.05, 0.02])
"""In mm/N, wherever the contact is."""
ACROSS = np.array([5.0, -3.0, 0.0]) / 34**0.5
"""A direction that no contact moves the sensors in."""


def answered(force_n: tuple[float, float], noise_mm: float, samples_mm: Floats) -> dict[str, Floats]:
    # The place changes the shape by next to nothing.
    prior = Prior(
        Extent.of_beam((40.0, 540.0)), 640.0, force_n, Errors(noise_mm), 3, lambda at_mm: SHAPE + 1e-9 * at_mm * ACROSS
    )
    whitening = np.broadcast_to(np.eye(3) / noise_mm, (len(samples_mm), 3, 3))
    found = runner(to_bytes(posterior_graph(prior, with_force=True)))(samples_mm, whitening)
    return {name: values.astype(np.float64) for name, values in found.items()}


def mass(forces: Forces, shown_n: float, deviation_n: float) -> tuple[float, float]:
    """Return what a sample leaves of a prior of the force: within the range in its middle, and in all."""
    masses = []
    for piece in forces:
        ends = norm.cdf(np.array([piece.low_n, piece.high_n]), shown_n, deviation_n)
        is_exact = piece.low_n == piece.high_n
        even = float(np.diff(ends)[0]) / (1.0 if is_exact else piece.high_n - piece.low_n)
        masses.append(piece.share * (norm.pdf(piece.low_n, shown_n, deviation_n) if is_exact else even))
    return float(masses[len(masses) // 2]), float(sum(masses))


def told(forces: Forces, stated: ForceRange, shown_n: float, deviation_n: float) -> tuple[float, float]:
    """Return mean and standard deviation of the force.

    Within the range, the sample and the range as a reading of its middle tell it; beyond, the sample alone.
    """
    within, every = mass(forces, shown_n, deviation_n)
    share, precision = within / every, deviation_n**-2
    both = precision + stated.precision_per_n2
    inside_n = (precision * shown_n + stated.precision_per_n2 * stated.middle_n) / both
    mean_n = share * inside_n + (1 - share) * shown_n
    variance = share / both + (1 - share) / precision + share * (1 - share) * (inside_n - shown_n) ** 2
    return mean_n, math.sqrt(variance)


@pytest.mark.parametrize(
    ("force_n", "noise_mm"),
    [
        ((2.0, 20.0), 0.01),
        ((9.0, 11.0), 0.01),
        ((8.0, 12.0), 0.05),
        ((9.9, 10.1), 0.01),
        ((9.99, 10.01), 0.001),
        ((9.9, 10.1), 0.1),  # so faint that the range is as good as a point
        ((10.0, 10.0), 0.05),
    ],
)
def test_force_odds_and_misfit_are_those_of_closed_forms(force_n: tuple[float, float], noise_mm: float) -> None:
    stated, deviation_n = ForceRange(*force_n), noise_mm / float(np.linalg.norm(SHAPE))
    shown_n = 10.0 + deviation_n * np.array([0.0, 0.6, -1.3, 3.5, -4.2, 12.0])
    across = np.array([0.4, -1.1, 2.0, 0.0, 0.7, 1.6])
    samples_mm = shown_n[:, None] * SHAPE + noise_mm * across[:, None] * ACROSS
    answers = answered(force_n, noise_mm, samples_mm)
    for row, shown in enumerate(shown_n.tolist()):
        off_n = shown - min(max(shown, force_n[0]), force_n[1])
        penalty = off_n**2 / (deviation_n**2 + 1 / stated.penalty_per_n2) if stated.penalty_per_n2 else 0.0
        assert answers["misfit"][row] == pytest.approx(across[row] ** 2 + penalty, rel=0.01, abs=0.03)
        if shown > 0:
            assert answers["contact_log_odds"][row] == pytest.approx((shown / deviation_n) ** 2 / 2, rel=3e-3)
        # An even density has its middle in the middle, and its interval is the whole range.
        assert answers["position_mm"][row] == pytest.approx(290.0, abs=2.0)
        assert answers["position_low_mm"][row] == pytest.approx(40.0, abs=2.0)
        assert answers["position_high_mm"][row] == pytest.approx(540.0, abs=2.0)
        if stated.is_open:
            mean_n, ends_n = max(shown, 0.0), (max(shown, 0.0), deviation_n)
        else:
            mean_n, _ = told(forces_of(force_n), stated, shown, deviation_n)
            ends_n = told(interval_forces(force_n), stated, shown, deviation_n)
        slack = 0.035 * ends_n[1]
        assert answers["force_n"][row] == pytest.approx(min(max(mean_n, 0.0), 10 * force_n[1]), abs=slack)
        for name, sign in (("force_low_n", -1), ("force_high_n", 1)):
            assert answers[name][row] == pytest.approx(max(0.0, ends_n[0] + sign * 1.96 * ends_n[1]), abs=2 * slack)


def test_a_force_is_told_up_to_ten_times_the_largest_and_none_that_pulls() -> None:
    samples_mm = np.array([[-3.0], [400.0]]) * SHAPE
    answers = answered((2.0, 20.0), 0.01, samples_mm)
    assert answers["force_n"].tolist() == pytest.approx([0.0, 200.0], abs=1e-6)
    assert answers["force_low_n"][0] == 0.0
    assert answers["force_high_n"].tolist() == pytest.approx([0.32, 200.0], abs=0.01)
