"""The posterior of a place on two axes over cells, where it is normal along each: a plate that four scales tell of."""

import numpy as np
import pytest
from scipy.special import ellipe
from scipy.stats import norm, truncnorm

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.cell_posterior import summarize
from beamtouch_models.design.accuracy.limit import least_errors_mm, posterior_places_mm
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.posterior.plane import _boxes
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors

SIZE_MM, FORCE_N = np.array([400.0, 250.0]), 10.0


def levers(place_mm: Floats) -> Floats:
    """Scales at either end of both axes, each of which carries the load by its lever."""
    share = place_mm / SIZE_MM
    return np.concatenate([share, 1 - share], axis=-1)


def plate(noise_mm: float, ranges_mm: tuple[tuple[float, float], ...] = ((10.0, 390.0), (20.0, 230.0))) -> Prior:
    return Prior(Extent(ranges_mm), 470.0, (FORCE_N, FORCE_N), Errors(noise_mm), 4, levers)


def deviations_mm(noise_mm: float) -> Floats:
    """By two scales of an axis, l s / (F sqrt 2)."""
    deviation: Floats = SIZE_MM * noise_mm / (FORCE_N * 2**0.5)
    return deviation


@pytest.mark.parametrize("noise_mm", [0.2, 0.01, 1e-4])
def test_the_median_is_the_place_and_the_distance_that_of_two_normal_errors(noise_mm: float) -> None:
    prior, at_mm = plate(noise_mm), np.array([[210.0, 128.0], [163.0, 101.0], [243.0, 140.0]])
    found = summarize(prior, FORCE_N * levers(at_mm))
    along, across = deviations_mm(noise_mm)
    assert (found.median_mm - at_mm) / [along, across] == pytest.approx(np.zeros((3, 2)), abs=0.02)
    # The mean length of two normal errors is an elliptic integral of their deviations.
    expected = along * (2 / np.pi) ** 0.5 * ellipe(1 - (across / along) ** 2)
    assert found.distance_mm == pytest.approx(expected, rel=0.01)
    assert least_errors_mm(prior, FORCE_N * levers(at_mm)) == pytest.approx(found.distance_mm)
    assert posterior_places_mm(prior, FORCE_N * levers(at_mm)).tolist() == found.median_mm.tolist()


def test_at_a_corner_of_the_extent_both_densities_are_cut_off() -> None:
    prior, at_mm = plate(0.1), np.array([[10.0, 230.0], [390.0, 20.0], [13.0, 226.0]])
    found, deviation = summarize(prior, FORCE_N * levers(at_mm)), deviations_mm(0.1)
    for axis, (low, high) in enumerate(prior.extent.ranges_mm):
        ends = (low - at_mm[:, axis]) / deviation[axis], (high - at_mm[:, axis]) / deviation[axis]
        expected = truncnorm.ppf(0.5, *ends, at_mm[:, axis], deviation[axis])
        assert found.median_mm[:, axis] == pytest.approx(expected, abs=0.02 * deviation[axis])


def test_places_at_levels_stand_for_the_posterior() -> None:
    noise_mm, at_mm, count = 0.02, np.array([[100.0, 70.0], [300.0, 140.0]]), 400
    levels = np.tile((np.arange(count) + 0.5) / count, (2, 1))
    found, deviation = summarize(plate(noise_mm), FORCE_N * levers(at_mm), levels), deviations_mm(noise_mm)
    assert found.likely_mm.shape == (2, count, 2)
    off = (found.likely_mm - at_mm[:, None]) / deviation
    assert off.mean(axis=1) == pytest.approx(np.zeros((2, 2)), abs=0.1)
    assert off.std(axis=1) == pytest.approx(np.ones((2, 2)), abs=0.1)
    # Cells are counted row by row along y: a level is one of the first axis, within the width of a cell.
    assert off[:, :, 0] == pytest.approx(norm.ppf(levels), abs=0.5)
    assert np.unique(found.likely_mm[0, :, 0]).size > 15
    last = summarize(plate(noise_mm), FORCE_N * levers(at_mm), np.ones((2, 1))).likely_mm
    assert (last[:, 0] > at_mm).all()


def test_more_samples_than_a_part_holds_are_answered_in_their_order() -> None:
    at_mm = np.stack([np.linspace(50.0, 350.0, 35), np.linspace(200.0, 40.0, 35)], axis=1)
    found = summarize(plate(1e-3), FORCE_N * levers(at_mm))
    assert found.median_mm == pytest.approx(at_mm, abs=0.01)
    assert found.likely_mm.shape == (35, 0, 2)


def test_two_places_that_look_alike_are_both_kept() -> None:
    """Sensors in the middle of the first axis tell no side of it."""

    def folded(place_mm: Floats) -> Floats:
        share = place_mm / SIZE_MM
        return np.stack([np.abs(share[:, 0] - 0.5), share[:, 1], 1 - share[:, 1]], axis=1)

    prior = Prior(Extent(((0.0, 400.0), (0.0, 250.0))), 470.0, (FORCE_N, FORCE_N), Errors(5e-3), 3, folded)
    found = summarize(prior, FORCE_N * folded(np.array([[130.0, 90.0]])), np.array([[0.25, 0.75]]))
    assert sorted(found.likely_mm[0, :, 0]) == pytest.approx([130.0, 270.0], abs=3)
    assert found.distance_mm == pytest.approx([70.0], abs=3)


@pytest.mark.parametrize(
    ("noise_mm", "boxes"), [(50.0, 1), (0.067, 1), (0.064, 2), (0.0063, 2), (0.006, 3), (5e-4, 3), (1e-6, 3)]
)
def test_boxes_go_on_until_cells_are_six_tenths_of_a_deviation_and_end_with_the_third(
    noise_mm: float, boxes: int
) -> None:
    """Of 380 by 210 mm: cells are a 32nd of a box, and the next box is taken to have the width of three of them."""
    assert _boxes(plate(noise_mm)) == boxes
