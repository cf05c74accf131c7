"""Thresholds of touch, rest and misfit and the smallest force, against exact probabilities of noise and zeros."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.stats import chi2, norm

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import (
    directions,
    exceeded_with,
    height_exceeded,
    left_by_contact,
    log_odds,
    misfit_threshold,
    rate_per_sample,
    readings_alike,
    size_per_n,
    smallest_force_n,
    smallest_forces,
    touch_threshold,
    touch_thresholds,
    unexplained_thresholds,
)
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.metadata_parts import FilterChoice
from models.bar_on_scales import LENGTH_MM, three_scales

DAY_S = 86_400


@pytest.mark.parametrize(("per_day", "rate_hz"), [(1.0, 200.0), (0.1, 1000.0), (24.0, 50.0)])
def test_independent_samples_are_taken_for_contacts_as_often_as_is_stated(per_day: float, rate_hz: float) -> None:
    assert rate_per_sample(per_day, rate_hz, 1) == pytest.approx(per_day / (DAY_S * rate_hz), rel=0.03)


@pytest.mark.parametrize("window", [20, 80, 400])
def test_means_exceed_a_threshold_in_clusters_that_are_one_contact_each(window: int) -> None:
    """Clusters of a moving mean begin at a rate of p h^2/n exp(-0.583 h sqrt(2/n)) a sample (Siegmund, 1985)."""
    rate = rate_per_sample(2.0, 500.0, window)
    height = norm.isf(rate)
    clusters = rate * height**2 / window * np.exp(-0.583 * height * (2 / window) ** 0.5)
    assert clusters == pytest.approx(2.0 / (DAY_S * 500), rel=0.02)


def exact_height(rate: float, reach: float, noise: float) -> float:
    """The height that an even zero within +- reach and normal noise exceed with a probability."""

    def beyond(height: float) -> float:
        ends = [max(-reach, min(reach, height - k * noise)) for k in (12, 6, 0)]
        steps = sorted({-reach, *ends, reach})
        parts = [quad(lambda zero: norm.sf((height - zero) / noise), *pair)[0] for pair in pairwise(steps)]
        return float(sum(parts)) / (2 * reach)

    return float(brentq(lambda height: np.log(beyond(height) / rate), 0.0, reach + 12 * noise))


@pytest.mark.parametrize(("reach", "noise"), [(0.3, 0.8), (1.6, 0.5), (2.0, 0.05), (6.0, 3.0), (0.1, 0.04)])
@pytest.mark.parametrize("rate", [1e-3, 1e-8])
def test_the_sum_of_a_zero_and_noise_exceeds_its_height_at_the_rate(reach: float, noise: float, rate: float) -> None:
    heights, tilts = exceeded_with(rate, np.array([[reach], [0.0]]), np.array([noise, noise]))
    assert heights[0] == pytest.approx(exact_height(rate, reach, noise), rel=0.002)
    assert heights[1] == pytest.approx(noise * norm.isf(rate), rel=1e-4)
    between = exact_height(0.9 * rate, reach, noise) - exact_height(1.1 * rate, reach, noise)
    assert tilts[0] * between == pytest.approx(np.log(1.1 / 0.9), rel=0.2)  # the slope of the log of the tail


def test_zeros_of_two_channels_add_up() -> None:
    """Drawn at random: a tenth of 400 000 draws tells the height to a part in a thousand."""
    rng = np.random.default_rng(5)
    reach, noise = np.array([0.9, 0.4]), 0.3
    drawn = rng.uniform(-1, 1, (400_000, 2)) @ reach + noise * rng.normal(size=400_000)
    heights, _ = exceeded_with(0.01, reach[None], np.array([noise]))
    assert heights[0] == pytest.approx(np.quantile(drawn, 0.99), rel=0.02)


def test_over_directions_the_rate_is_averaged() -> None:
    """A zero lies within two drifts: a channel of which half the variance is zero, beside one of noise alone."""
    whole, rate = np.array([0.6, 1.0]), 1e-5
    reach = 2 * (1 - 0.6**2) ** 0.5
    alone = height_exceeded(np.array([[1.0, 0.0]]), whole, whole, rate)
    assert alone == pytest.approx(exact_height(rate, reach, 0.6), rel=0.01)
    assert height_exceeded(np.array([[0.0, -1.0]]), whole, whole, rate) == pytest.approx(norm.isf(rate), rel=1e-4)
    both = height_exceeded(np.array([[1.0, 0.0], [0.0, 1.0]]), whole, whole, rate)
    wanted = brentq(
        lambda h: np.log(
            (norm.sf(h) + quad(lambda z: norm.sf((h - z) / 0.6), -reach, reach)[0] / 2 / reach) / 2 / rate
        ),
        3.0,
        6.0,
    )
    assert both == pytest.approx(wanted, rel=0.01)


def test_one_direction_is_touched_by_its_own_noise_alone() -> None:
    unit, noise = np.array([[0.6, 0.8], [0.0, 0.0]]), np.ones(2)
    threshold = touch_threshold(unit, noise, 1e-6)
    assert threshold == pytest.approx(norm.isf(1e-6) ** 2 / 2, rel=1e-4)
    sample = np.array([[0.6, 0.8], [-0.6, -0.8]]) * (2 * threshold) ** 0.5
    assert log_odds(unit[:1], sample) == pytest.approx([threshold, 0.0], rel=1e-9)
    assert touch_threshold(unit[1:], noise, 1e-6) == 0.0


def test_odds_are_the_mean_over_places() -> None:
    unit = np.array([[1.0, 0.0], [0.0, 1.0], [-0.6, 0.8]])
    expected = np.log((np.exp(3.0**2 / 2) + np.exp(0.5**2 / 2) + 1) / 3)
    assert log_odds(unit, np.array([[3.0, 0.5]])) == pytest.approx([expected])
    assert log_odds(unit, np.array([[400.0, 0.0]])) == pytest.approx([8e4 - np.log(3)])
    assert directions(np.array([[3.0, 4.0], [1e-10, 0.0], [0.0, -2.0]])).tolist() == [[0.6, 0.8], [0, 0], [0, -1]]


@pytest.mark.parametrize("readings", [2, 8, 50])
@pytest.mark.parametrize(("channels", "checked", "free"), [(2, 0.0, 1), (2, 1.0, 1), (4, 0.0, 2), (5, 1.0, 4)])
def test_without_zeros_the_misfit_is_chi_square_of_what_a_contact_leaves(
    channels: int, checked: float, free: int, readings: int
) -> None:
    """Half a false stretch a day, of three odd means of n readings, which takes n / (n - 1) times the squares."""
    rate = 0.5 / (DAY_S * 100)
    expected = chi2.isf(rate ** (1 - 1 / readings), free)
    assert left_by_contact(channels, checked) == free
    assert misfit_threshold(1.0, channels, checked, 100.0, readings) == pytest.approx(expected, rel=1e-3)


def test_single_readings_are_judged_as_means_of_two_and_long_means_by_the_mean() -> None:
    assert misfit_threshold(1.0, 4, 0.0, 100.0, 1) == misfit_threshold(1.0, 4, 0.0, 100.0, 2)
    rate = 0.5 / (DAY_S * 100) * 256 / 64
    assert misfit_threshold(1.0, 4, 0.0, 100.0, 256) == pytest.approx(chi2.isf(rate ** (1 - 1 / 256), 2), rel=1e-3)
    assert misfit_threshold(1.0, 4, 0.0, 1e-6, 8) == pytest.approx(chi2.isf(0.01 ** (7 / 8), 2), rel=1e-3)
    # Zeros lie within twice their drift: what they make of the variance exceeds a height more rarely than noise.
    assert misfit_threshold(0.7, 4, 0.0, 100.0, 8) < misfit_threshold(1.0, 4, 0.0, 100.0, 8)


def test_readings_that_are_alike_are_those_of_the_window_or_of_a_growing_mean() -> None:
    def growing(window: int, longest: int) -> int:
        return readings_alike(FilterChoice(kind="growing-mean", window=window, longest=longest, spike_mm=1.0))

    assert [growing(4, 200), growing(4, 9), growing(40, 200)] == [24, 9, 40]


NOISE_MM = 0.01


def bar(errors: Errors, force_n: tuple[float, float] = (0.01, 0.2)) -> Prior:
    return Prior(Extent.of_beam((0.0, LENGTH_MM)), LENGTH_MM, force_n, errors, 3, three_scales)


def test_the_touch_of_some_channels_is_that_of_their_worst_neighbours() -> None:
    prior, rate = bar(Errors(NOISE_MM, zero_mm=np.array([0.0, NOISE_MM, 3 * NOISE_MM]))), 1e-6
    one, two, three = touch_thresholds(prior, rate)
    assert one == pytest.approx(norm.isf(rate) ** 2 / 2, rel=1e-3)  # of the first, which has noise alone
    pairs = [touch_thresholds(prior.without(missing), rate)[-1] for missing in range(3)]
    assert two == max(pairs) > min(pairs)
    assert three < one
    quiet = touch_thresholds(bar(Errors(NOISE_MM)), rate)
    assert quiet == pytest.approx(np.full(3, norm.isf(rate) ** 2 / 2), rel=1e-3)


def test_rest_is_chi_square_of_all_channels_and_no_easier_to_exceed_than_the_misfit() -> None:
    rest, misfit = unexplained_thresholds(bar(Errors(NOISE_MM)), 100.0, 8)
    assert misfit == [misfit_threshold(1.0, size, 0.0, 100.0, 8) for size in (1, 2, 3)]
    expected = [chi2.isf((1 / (DAY_S * 100)) ** (7 / 8), size) for size in (1, 2, 3)]
    assert rest == pytest.approx(np.maximum(expected, misfit), rel=1e-3)


def test_the_smallest_force_is_seen_by_all_but_a_twentieth_of_the_samples() -> None:
    """Of a place that alone looks as it does: its deflection is the threshold and 1.645 deviations more."""
    prior = bar(Errors(NOISE_MM, zero_mm=NOISE_MM * 3**0.5))  # together two noises
    at_mm = np.array([[0.0], [39.0]])
    size = np.array([1.0, (0.7**2 + 0.3**2 + 0.3**2) ** 0.5]) / (2 * NOISE_MM)
    assert size_per_n(prior, at_mm) == pytest.approx(size)
    force_n = smallest_force_n(prior, 9.0, at_mm)
    odds = log_odds(
        directions(prior.influence_table(prior.extent.grid(129))),
        directions(prior.influence_at(at_mm)) * (force_n * size - norm.isf(0.05))[:, None],
    )
    assert odds == pytest.approx([9.0, 9.0], rel=2e-3)


def test_where_a_force_beyond_ten_times_the_largest_is_needed_nothing_is_seen() -> None:
    """A string's sensor in its middle: at x it moves by x, so that 1 over the force rises evenly from the support."""

    def string(place_mm: Floats) -> Floats:
        return np.minimum(place_mm, LENGTH_MM - place_mm) / LENGTH_MM

    prior = Prior(Extent.of_beam((0.0, LENGTH_MM)), LENGTH_MM, (0.1, 0.2), Errors(NOISE_MM), 1, string)
    seen = smallest_forces(prior, 8.0, [-1.0, 0.0, 33.3, LENGTH_MM, 140.0])
    assert (seen.position_mm[0], seen.position_mm[-1], seen.across_mm) == (0.0, LENGTH_MM, None)
    assert len(seen.position_mm) == 130
    forces = dict(zip(seen.position_mm, seen.force_n, strict=True))
    expected = {at: (4.0 + norm.isf(0.05)) * NOISE_MM / (min(at, LENGTH_MM - at) / LENGTH_MM or 1e-9) for at in forces}
    assert {at for at, force in forces.items() if force is None} == {at for at in forces if expected[at] > 2.0}
    assert forces[33.3] == pytest.approx(expected[33.3], rel=1e-3)
    assert [force for force in seen.force_n if force] == pytest.approx(
        [f for f in expected.values() if f <= 2.0], rel=1e-3
    )


def test_on_a_plate_the_smallest_force_is_told_over_a_grid() -> None:
    size_mm = np.array([40.0, 30.0])

    def corners(place_mm: Floats) -> Floats:
        x, y = (place_mm / size_mm).T
        return np.stack([(1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y], axis=1)

    prior = Prior(Extent(((0.0, 40.0), (0.0, 30.0))), 50.0, (1e-3, 0.0075), Errors(NOISE_MM), 4, corners)
    seen = smallest_forces(prior, 7.0, [])
    assert seen.across_mm is not None
    assert len(seen.position_mm) == len(seen.across_mm) == len(seen.force_n) == 121  # 11 by 11
    assert (seen.position_mm[1], seen.across_mm[1]) == (0.0, 3.0)
    places = np.column_stack([seen.position_mm, seen.across_mm])
    every = smallest_force_n(prior, 7.0, places)
    assert seen.force_n == [force if force <= 0.075 else None for force in every.tolist()]
    assert {None} < set(seen.force_n)
