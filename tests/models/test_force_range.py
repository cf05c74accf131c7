"""A stated range of forces as evidence: from an exact to an open force, against quadrature and brute force."""

import numpy as np
import pytest
from scipy.special import chdtrc, chdtri

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime.curve import Curve
from beamtouch_models.runtime.force_range import ANY_FORCE, ForceRange

RANGES = [(10.0, 10.0), (9.99, 10.01), (9.9, 10.1), (9.0, 11.0), (8.0, 12.0), (7.0, 13.0), (6.0, 14.0)]
"""From an exact force to an open one."""


def test_what_a_range_says_fades_from_an_exact_force_to_one_whose_largest_is_twice_the_smallest() -> None:
    ranges = [ForceRange(10 - half, 10 + half) for half in np.linspace(0, 10 / 3, 200)]
    for values in ([one.checked for one in ranges], [one.penalty_per_n2 for one in ranges[1:]]):
        assert np.all(np.diff(values) < 0)
        assert values[-1] == pytest.approx(0, abs=1e-9)
    assert ranges[0].checked == pytest.approx(1)
    # Without a jump, neither at an exact force nor at an open one.
    assert np.max(np.abs(np.diff([one.checked for one in ranges]))) < 0.05
    assert ForceRange(10.0, 10.0 + 1e-6).checked == pytest.approx(1, abs=1e-9)
    assert ForceRange(2.0, 20.0).checked == ANY_FORCE.checked == ForceRange(2.0, 20.0).penalty_per_n2 == 0
    # A third of half the range costs one, and a reading of the middle has the variance of an even density.
    narrow = ForceRange(9.99, 10.01)
    assert narrow.misfit(np.array([9.985, 10.0, 10.02])) == pytest.approx([2.25, 0, 9], rel=1e-4)
    assert narrow.precision_per_n2 == pytest.approx(
        1 / np.random.default_rng(0).uniform(9.99, 10.01, 10**6).var(), rel=0.01
    )
    assert narrow.relative_error == pytest.approx(0.01 / 3**0.5 / 10, rel=1e-4)
    assert ForceRange(2.0, 20.0).relative_error == np.inf


@pytest.mark.parametrize("force_n", RANGES)
def test_a_chi_square_of_part_of_a_degree_bounds_the_misfit_of_any_contact_that_is_detected(
    force_n: tuple[float, float],
) -> None:
    """By quadrature over the error of the force; what a contact leaves beside its force is chi-square by itself."""
    checked, error = ForceRange(*force_n).checked, np.linspace(-9, 9, 6001)
    density = np.exp(-(error**2) / 2) / np.sqrt(2 * np.pi)
    for deviation_n in (10 / 6, 10 / 20, 10 / 500):  # of the force in a sample; the first is barely detected
        for true_n in (force_n[0], 10.0, force_n[1]):
            added = _added(force_n, true_n + error * deviation_n, deviation_n)
            for free in (1, 2, 6):
                for rate in (1e-2, 1e-5, 1e-9):
                    threshold = chdtri(free + checked, rate)
                    exceeded = chdtrc(free, np.maximum(threshold - added, 0))
                    assert np.trapezoid(exceeded * density, error) <= rate * 1.0001


def _added(force_n: tuple[float, float], shown_n: Floats, deviation_n: float) -> Floats:
    """Return what samples that show these forces by themselves add to a misfit: springs of two stiffnesses in a row."""
    half, middle = (force_n[1] - force_n[0]) / 2, (force_n[1] + force_n[0]) / 2
    apart = shown_n - np.clip(shown_n, *force_n)
    with np.errstate(divide="ignore"):
        soft = np.divide((half / 3) ** 2, max(0.0, 1 - (3 * half / middle) ** 2))
    added: Floats = apart**2 / (deviation_n**2 + soft)
    return added


@pytest.mark.parametrize("force_n", RANGES)
def test_what_the_best_contact_leaves_is_the_least_over_all_places_and_forces(force_n: tuple[float, float]) -> None:
    at = np.linspace(0.0, 1.0, 201)
    stated, rng = ForceRange(*force_n), np.random.default_rng(2)

    def influence(place: Floats) -> Floats:
        """Two shapes of a string at three sensors, in mm/N."""
        parts = [np.sin(k * np.pi * place)[:, None] * np.sin(k * np.pi * np.array([0.2, 0.45, 0.8])) for k in (1, 2)]
        return parts[0] + 0.3 * parts[1]

    curve, fine = Curve((at,), influence(at)), np.linspace(0.0, 1.0, 2001)
    loads = [(12.0, 0.3, 0.0, 0.3), (5.0, 0.25, 5.0, 0.75), (10.0, 0.6, 0.0, 0.6), (7.9, 0.15, 0.0, 0.1)]
    clean = np.array(
        [
            one * influence(np.array([first]))[0] + other * influence(np.array([second]))[0]
            for one, first, other, second in loads
        ]
    )
    samples, weight = clean + rng.normal(size=clean.shape) * 0.05, np.full(clean.shape, 0.05**-2)
    forces = np.concatenate([np.linspace(0, 30, 1501), np.linspace(*force_n, 51)])
    shapes = influence(fine)
    penalty = stated.misfit(forces)
    for sample, found in zip(samples, curve.unexplained(samples, weight, stated), strict=True):
        left = ((sample - forces[:, None, None] * shapes) ** 2).sum(axis=2) / 0.05**2 + penalty[:, None]
        least = min(left.min(), (sample**2).sum() / 0.05**2)
        assert found <= 1.001 * least + 1e-6
        assert found == pytest.approx(least, rel=0.02, abs=0.15)
