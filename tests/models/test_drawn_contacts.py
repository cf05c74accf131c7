"""Contacts that are drawn evenly, more where errors are large; and the errors of answers to them, by hand."""

import dataclasses

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.drawing import (
    Draws,
    concentrate_on_errors,
    concentrated_ticks,
    draw,
    draw_evenly,
    even_contacts,
    spread_contacts,
)
from beamtouch_models.design.accuracy.limit import (
    LIKELY,
    Contacts,
    accuracy_limit,
    limits_with_one_failed,
    simulate_until_certain,
    simulated,
)
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.effort import Effort
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from models.bar_on_scales import LENGTH_MM, scales


def steep(place_mm: Floats) -> Floats:
    """A ramp of nothing up to 39 mm, so that no place is told from another there."""
    ramp = np.maximum(place_mm - 39.0, 0.0) / LENGTH_MM
    return np.concatenate([ramp, 0.3 * np.ones_like(ramp)], axis=-1)


def bar(noise_mm: float = 0.01, *, at: object = scales, force_n: tuple[float, float] = (2.0, 20.0)) -> Prior:
    return Prior(Extent.of_beam((13.0, 117.0)), LENGTH_MM, force_n, Errors(noise_mm), 2, at)  # type: ignore[arg-type]


def test_drawn_contacts_are_even_over_the_ranges_and_their_samples_scatter_by_the_noise() -> None:
    drawn = draw(bar(), 4000, 3)
    assert drawn.position_mm == pytest.approx(drawn.place_mm[:, 0])
    assert np.quantile(drawn.position_mm, [0, 0.25, 0.5, 1]) == pytest.approx([13, 39, 65, 117], abs=3)
    assert np.quantile(drawn.force_n, [0, 0.25, 0.5, 1]) == pytest.approx([2, 6.5, 11, 20], abs=0.5)
    off = drawn.deflection_mm - drawn.force_n[:, None] * scales(drawn.place_mm)
    assert off.std(axis=0) == pytest.approx([0.01, 0.01], rel=0.05)
    assert drawn.weight.tolist() == [1.0] * 4000
    again, other = draw(bar(), 4000, 3), draw(bar(), 4000, 4)
    assert again.deflection_mm.tolist() == drawn.deflection_mm.tolist() != other.deflection_mm.tolist()


def test_spread_contacts_fill_places_forces_and_noises_evenly() -> None:
    """Of 64, each eighth of every range holds eight."""
    place, force, noise = spread_contacts(bar(), 64, np.random.default_rng(1))
    for share in ((place[:, 0] - 13) / 104, (force - 2) / 18):
        assert np.histogram(share, 8, (0, 1))[0].tolist() == [8] * 8
    quartiles = [-np.inf, -0.67449, 0.0, 0.67449, np.inf]
    assert [np.histogram(column, quartiles)[0].tolist() for column in noise.T] == [[16] * 4] * 2
    assert noise.shape == (64, 2)
    only, exact, _ = spread_contacts(bar(force_n=(7.0, 7.0)), 4, np.random.default_rng(1))
    assert (only.shape, exact.tolist()) == ((4, 1), [7.0] * 4)


@pytest.mark.parametrize(("count", "drawn"), [(1, 16), (16, 16), (17, 32), (128, 128), (129, 256)])
def test_at_least_as_many_contacts_come_in_sixteen_parts_of_a_power_of_two(count: int, drawn: int) -> None:
    place, force, noise, weight = even_contacts(bar(), count, 5)
    assert len(place) == len(force) == len(noise) == len(weight) == drawn
    assert weight.mean() == pytest.approx(1)
    parts = force.reshape(16, -1)
    assert len(np.unique(parts[:, 0])) == 16


def test_contacts_stand_where_errors_are_large_and_weigh_as_much_less() -> None:
    """On the flat part the bound is that of a guess: many times the rest, so that half of all contacts move there."""
    prior = bar(at=steep)
    even = np.linspace(13.0, 117.0, 4001)[:, None]
    moved, weight = concentrate_on_errors(prior, even)
    assert np.all(np.diff(moved[:, 0]) > 0)
    assert (moved[0, 0], moved[-1, 0]) == pytest.approx((13, 117))
    flat = moved[:, 0] < 39
    assert flat.mean() == pytest.approx(0.25 / 2 + 0.5, abs=0.02)
    assert (weight * flat).mean() == pytest.approx(0.25, abs=0.01)
    assert weight.max() == pytest.approx(2, rel=0.05)
    share = np.histogram(moved[:, 0], 13, (13, 117), weights=weight)[0] / len(moved)
    assert share == pytest.approx(np.full(13, 1 / 13), rel=0.03)
    assert concentrate_on_errors(bar(0.0, at=steep), even)[0] is even
    assert concentrate_on_errors(bar(0.0, at=steep), even)[1].tolist() == [1.0] * 4001
    (ticks,) = concentrated_ticks(prior, 40)
    assert len(ticks) == 41
    assert (ticks[0], ticks[-1]) == pytest.approx((13, 117))
    assert (ticks < 39).sum() == pytest.approx(25, abs=1)


def test_on_two_axes_each_is_filled_by_how_often_its_parts_are_drawn() -> None:
    def at(place_mm: Floats) -> Floats:
        return np.concatenate([steep(place_mm[:, :1]), scales(place_mm[:, 1:]) - 0.2], axis=-1)

    prior = Prior(Extent(((13.0, 117.0), (26.0, 104.0))), 150.0, (5.0, 5.0), Errors(0.01), 4, at)
    rng = np.random.default_rng(2)
    even = prior.extent.uniform(20_000, rng)
    moved, weight = concentrate_on_errors(prior, even)
    assert (moved[:, 0] < 39).mean() > 0.5
    assert (weight * (moved[:, 0] < 39)).mean() / weight.mean() == pytest.approx(0.25, abs=0.01)
    assert (weight * (moved[:, 1] < 65)).mean() / weight.mean() == pytest.approx(0.5, abs=0.01)
    along, across = concentrated_ticks(prior, 100)
    assert (len(along), len(across)) == (10, 10)
    assert (along < 39).sum() >= 5
    assert across == pytest.approx(np.linspace(26, 104, 10), abs=2)


def test_an_evenly_drawn_mean_is_exact_to_its_stated_error() -> None:
    """Of the force, and of its product with the place: 11 N, and 11 times 65."""
    drawn = draw_evenly(bar(at=steep), 512, 3)
    assert (drawn.force_n * drawn.weight).mean() == pytest.approx(11, rel=0.01)
    assert (drawn.force_n * drawn.position_mm * drawn.weight).mean() == pytest.approx(715, rel=0.01)
    off = drawn.deflection_mm - drawn.force_n[:, None] * steep(drawn.place_mm)
    assert off.std(axis=0) == pytest.approx([0.01, 0.01], rel=0.03)


def contacts() -> Contacts:
    """Sixteen contacts of which each could be at either of two places, with weights of 1 and 3 in turn."""
    weight = np.tile([0.5, 1.5], 8)
    likely = np.tile([[[30.0, 40.0], [60.0, 80.0]]], (16, 1, 1))
    drawn = Draws(likely[:, 0], np.full(16, 5.0), np.zeros((16, 2)), weight)
    return Contacts(drawn, likely, np.tile([33.0, 44.0], (16, 1)), np.full(16, 7.0))


def test_errors_are_distances_to_the_places_that_could_have_been() -> None:
    assert contacts().error_mm(np.zeros((16, 2), np.float32))[3].tolist() == [50.0, 100.0]
    assert contacts().least_error_mm()[3].tolist() == [5.0, 45.0]


def test_an_answer_reaches_the_limit_and_what_it_is_worse_than_the_median() -> None:
    """The median is 25 mm off on average, the answer 37.5, and where it weighs thrice as much 75: of 7 mm at best."""
    reached = contacts().reached(np.tile([[57.0, 76.0], [0.0, 0.0]], (8, 1)))
    error_mm = (1 * (7 + (45 + 5) / 2 - 25) + 3 * (7 + 75 - 25)) / 4
    assert reached.limit_mm.value == pytest.approx(7.0)
    assert reached.error_mm.value == pytest.approx(error_mm)
    assert reached.ratio.value == pytest.approx(error_mm / 7)


def test_an_interval_holds_both_of_its_ends() -> None:
    low, high = np.tile([30.0, 41.0], (16, 1)), np.tile([59.0, 80.0], (16, 1))
    assert contacts().held(low, high)[5].tolist() == [[True, False], [False, True]]


def test_the_likely_places_of_a_sample_are_those_of_its_posterior() -> None:
    """Sixteen of equal probability each: their mean distance from the median is that of a normal error."""
    prior, steps = bar(0.05, force_n=(10.0, 10.0)), list[float]()
    made = simulated(prior, 2500, 4, steps.append)
    assert made.likely_mm.shape == (4096, LIKELY, 1)
    assert np.all(np.diff(made.likely_mm[:, :, 0], axis=1) > 0)
    assert made.least_error_mm().mean(axis=1) == pytest.approx(made.distance_mm, rel=0.2)
    assert (made.least_error_mm().mean(axis=1) / made.distance_mm).mean() == pytest.approx(1, abs=2e-3)
    assert steps == pytest.approx(np.arange(1, len(steps) + 1) / len(steps))
    assert 10 <= len(steps) <= 20
    inside = np.abs(made.drawn.position_mm - 65) < 45
    deviation_mm = LENGTH_MM * 0.05 / 10 / 2**0.5
    assert made.distance_mm[inside] == pytest.approx(deviation_mm * (2 / np.pi) ** 0.5, rel=2e-3)
    off = made.median_mm[inside, 0] - made.drawn.position_mm[inside]
    assert off.std() == pytest.approx(deviation_mm, rel=0.05)


def test_without_noise_the_true_place_is_the_only_likely_one() -> None:
    made = simulated(bar(0.0), 64, 4)
    assert made.likely_mm.tolist() == made.drawn.place_mm[:, None].tolist()
    assert made.median_mm.tolist() == made.drawn.place_mm.tolist()
    assert made.distance_mm.tolist() == [0.0] * 64


def test_four_times_as_many_contacts_are_drawn_where_the_limit_would_be_uncertain() -> None:
    sure, unsure = bar(0.05, force_n=(10.0, 10.0)), bar(0.3, at=steep)
    assert len(simulate_until_certain(sure, 256, 1).drawn.weight) == 256
    assert len(simulate_until_certain(unsure, 64, 1).drawn.weight) == 256


def test_the_limit_with_a_sensor_failed_has_the_errors_of_both_its_parts() -> None:
    """Of two scales under an exact force, either alone tells the place, root 2 times less well."""
    prior = dataclasses.replace(bar(1e-3, force_n=(10.0, 10.0)))
    limit = accuracy_limit(prior, 512, 2)
    assert limit.value == pytest.approx(100 * 1e-3 / 10 / 2**0.5 * (2 / np.pi) ** 0.5, rel=2e-3)
    failed = limits_with_one_failed(prior, Measurement(3.0, 0.06), 2)
    assert [each.value for each in failed] == pytest.approx([3 * 2**0.5] * 2, rel=2e-3)
    assert [each.standard_error for each in failed] == pytest.approx([0.06 * 2**0.5] * 2, rel=0.02)
    assert limits_with_one_failed(prior.without(0), limit, 2) == []
    # The scatter of the ratio counts as well.
    far = bar(0.5, at=steep)
    exact, rough = (limits_with_one_failed(far, Measurement(3.0, error), 2, Effort(0.1))[1] for error in (0.0, 1.0))
    assert 0 < exact.standard_error < 0.5
    assert rough.standard_error == pytest.approx(np.hypot(exact.standard_error, rough.value / 3.0))
