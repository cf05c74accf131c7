"""Elements along one axis of a plate, against the Hermite splines of scipy and integrals by quadrature."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.physics.hermite import HermiteAxis

AXIS = HermiteAxis(0.77, 5)
NODES = 0.77 * np.arange(6) / 5


def spline_of(unknowns: Floats) -> CubicHermiteSpline:
    """Return what these unknowns state: values at the nodes, and slopes times the length of an element."""
    return CubicHermiteSpline(NODES, unknowns[0::2], unknowns[1::2] / 0.154)


SHAPES = [spline_of(unknowns) for unknowns in np.eye(12)]


def weighed(index: Indices, weight: Floats) -> Floats:
    """Return the weights of all unknowns, (places, unknowns)."""
    dense = np.zeros((len(index), 12))
    np.add.at(dense, (np.arange(len(index))[:, None], index), weight)
    return dense


@pytest.mark.parametrize(("left", "right"), [(0, 0), (1, 1), (2, 2), (2, 0), (0, 2), (1, 2)])
def test_products_are_the_integrals_of_products_of_derivatives(left: int, right: int) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(4)
    places = (NODES[:-1, None] + 0.154 * (1 + nodes) / 2).ravel()
    one, other = (np.array([shape(places, order) for shape in SHAPES]) for order in (left, right))
    wanted = one * np.tile(0.154 * weights / 2, 5) @ other.T
    assert AXIS.products(left, right).toarray() == pytest.approx(wanted, abs=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("order", [0, 1, 2])
def test_weights_at_places_are_those_of_the_spline(order: int) -> None:
    places = np.array([0.0, 0.05, 0.1541, 0.4, 0.7699, 0.77])
    wanted = np.array([shape(places, order) for shape in SHAPES]).T
    assert weighed(*AXIS.at(places, order)) == pytest.approx(wanted, abs=1e-9 * np.abs(wanted).max())


def test_weights_over_stretches_are_those_of_the_mean_of_the_spline() -> None:
    low, high = np.array([0.0, 0.03, 0.1, 0.5, 0.2, 0.7]), np.array([0.05, 0.1, 0.6, 0.77, 0.2001, 0.77])
    wanted = np.array(
        [[shape.integrate(*ends) / (ends[1] - ends[0]) for shape in SHAPES] for ends in zip(low, high, strict=True)]
    )
    assert weighed(*AXIS.over(low, high)) == pytest.approx(wanted, abs=1e-10)
    short = weighed(*AXIS.over(low[:1], high[:1]))
    assert short == pytest.approx(wanted[:1], abs=1e-10)


def test_named_deflections_are_those_of_their_unknowns() -> None:
    assert AXIS.unknowns == 12
    assert AXIS.nodes == pytest.approx(NODES)
    places = np.linspace(0, 0.77, 23)
    for unknowns, wanted in ((AXIS.constant(), places**0), (AXIS.rising(), places), (AXIS.squared(), places**2)):
        assert spline_of(unknowns)(places) == pytest.approx(wanted, abs=1e-12)
