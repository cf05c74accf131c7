"""Which rows of a beam that swings are fitted, and when a fit explains them."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray
from beamtouch_models.filters.search import Whole, carried, explains, sought, whole_of, with_jitter, worth
from beamtouch_models.filters.significance import chi_square_quantile
from beamtouch_models.filters.sinusoids import Band, Fit, Poles, fit

NAN = math.nan
VALUES = np.arange(36.0).reshape(12, 3)


def rows_of(times: FloatArray, values: FloatArray, block: int = 1, slowest: float = 0.1) -> Whole:
    whole = whole_of(times, values, block, slowest)
    assert whole is not None
    return whole


def test_rows_count_from_the_newest_one_in_rows() -> None:
    times = 1000.0 + 4 * np.arange(12.0)
    whole = rows_of(times, VALUES, block=4)
    assert whole.ages.tolist() == np.arange(-11.0, 1.0).tolist()
    assert whole.values.tolist() == VALUES.tolist()
    # Of means of readings, each reading counts, from the middle of the newest row.
    single = times[:, np.newaxis] + [-1.5, -0.5, 0.5, 1.5]
    assert rows_of(single, VALUES, block=4).ages[[0, -1]].tolist() == [
        [-11.375, -11.125, -10.875, -10.625],
        [-0.375, -0.125, 0.125, 0.375],
    ]


def test_rows_without_a_channel_of_the_newest_one_and_those_said_to_be_newer_or_long_ago_do_not_count() -> None:
    times, values = np.arange(12.0), VALUES.copy()
    values[2, 0], values[5, 1], values[:, 2] = NAN, NAN, NAN
    times[0], times[1], times[7] = -83.0, -82.0, 11.5
    whole = rows_of(times, values)
    kept = [1, 3, 4, 6, 8, 9, 10, 11]
    assert whole.ages.tolist() == (times[kept] - 11).tolist()
    assert whole.values.tolist() == values[kept, :2].tolist()


def test_five_rows_at_least_show_a_swing() -> None:
    assert whole_of(np.arange(4.0), VALUES[:4], 1, 0.1) is None
    assert rows_of(np.arange(5.0), VALUES[:5]).ages.tolist() == [-4, -3, -2, -1, 0]
    values = VALUES[:6].copy()
    values[1, 1] = NAN
    assert len(rows_of(np.arange(6.0), values).ages) == 5
    values[2, 2] = NAN
    assert whole_of(np.arange(6.0), values, 1, 0.1) is None


@pytest.mark.parametrize(
    ("slowest", "lowest"),
    # Eight tenths of a period in twelve rows.
    [(0.1, 2 * math.pi * 0.8 / 12), (0.41, 2 * math.pi * 0.8 / 12), (0.43, 0.43), (3.0, 3.0), (3.01, None)],
)
def test_the_slowest_swing_is_that_of_the_beam_or_one_that_the_rows_nearly_hold(
    slowest: float, lowest: float | None
) -> None:
    whole = whole_of(np.arange(12.0), VALUES, 1, slowest)
    assert (None if whole is None else whole.band.lowest) == (None if lowest is None else pytest.approx(lowest))


AGES, BAND = np.arange(-23.0, 1.0), Band(0.3)
POLE = Poles(np.array([0.01]), np.array([1.3]))


def swinging(size: float, *, slope: float = 0.0, channels: int = 3, frequency: float = 1.3, seed: int = 1) -> Whole:
    wave = np.exp(-0.01 * AGES) * np.cos(frequency * AGES + 0.3)
    shape = np.array([1.0, -2.0, 0.5])[:channels]
    noise = np.random.default_rng(seed).standard_normal((len(AGES), channels))
    return Whole(AGES, size * wave[:, np.newaxis] * shape + slope * AGES[:, np.newaxis] + noise, BAND)


def fitted(*, slopes: bool = False, poles: Poles = POLE, channels: int = 3) -> Fit:
    whole = swinging(20.0, channels=channels)
    return fit(whole.ages, whole.values, poles, BAND, slopes=slopes)


@pytest.mark.parametrize(
    ("poles", "slopes", "least"), [(Poles.none(), False, 1), (Poles.none(), True, 3), (POLE, False, 3)]
)
def test_a_fit_explains_rows_if_it_leaves_what_noise_hardly_exceeds_of_enough_freedom(
    poles: Poles, slopes: bool, least: int
) -> None:
    of = fitted(poles=poles, slopes=slopes)
    for freedom in (least, least + 17):
        limit = chi_square_quantile(freedom, 0.001)
        assert explains(of._replace(freedom=freedom, promised=0.999 * limit), BAND)
        assert not explains(of._replace(freedom=freedom, promised=1.001 * limit), BAND)
    assert not explains(of._replace(freedom=least - 1, promised=0.0), BAND)


def test_a_swing_that_may_be_a_load_explains_nothing() -> None:
    of, uneven = fitted()._replace(promised=0.0), Band(0.3, 4 * math.pi)
    assert explains(of, uneven)
    assert not explains(of._replace(following=Poles(POLE.decay, np.array([2 * math.pi - 0.29]))), uneven)


def test_a_fit_is_worth_what_it_leaves_and_twice_its_parameters() -> None:
    assert worth(fitted()._replace(promised=7.5, parameters=11)) == 29.5


@pytest.mark.parametrize(
    ("size", "slope", "poles", "slopes"),
    [(0.0, 0.0, 0, False), (0.0, 3.0, 0, True), (30.0, 0.0, 1, False), (30.0, 3.0, 1, True)],
)
def test_the_simplest_fit_is_found(size: float, slope: float, poles: int, slopes: bool) -> None:
    whole = swinging(size, slope=slope)
    found = sought(whole)
    assert found is not None
    assert (len(found.poles.decay), found.slopes) == (poles, slopes)
    if poles:
        assert found.following.frequency == pytest.approx([1.3], abs=0.01)
    # As it is carried on; a fit of another kind becomes it.
    for other in (False, True):
        last = fit(whole.ages, whole.values, found.following, BAND, slopes=other)
        again = carried(last, whole, checks=True)
        assert again is not None
        assert (len(again.poles.decay), again.slopes) == (poles, slopes)
    # Unless it is not checked, and explains all.
    sloping = fit(whole.ages, whole.values, found.following, BAND, slopes=True)
    kept = carried(sloping, whole, checks=False)
    assert kept is not None
    assert kept.slopes


def test_two_swings_are_found_one_after_the_other_and_three_are_not() -> None:
    two = swinging(30.0)
    two = two._replace(values=two.values + swinging(25.0, frequency=2.3, seed=2).values[:, ::-1])
    found = sought(two)
    assert found is not None
    assert sorted(found.following.frequency) == pytest.approx([1.3, 2.3], abs=0.02)
    # One more pole is looked for where the last fit has one.
    again = carried(fit(two.ages, two.values, POLE, BAND, slopes=False), two, checks=False)
    assert again is not None
    assert len(again.poles.decay) == 2
    third = swinging(25.0, frequency=0.7, seed=3).values[:, [1, 0, 2]]
    three = two._replace(values=two.values + third)
    assert sought(three) is None
    assert carried(found, three, checks=False) is None


def test_late_stamps_are_looked_for_where_a_beam_swings_and_two_channels_show_it() -> None:
    late = AGES + 0.1 * np.random.default_rng(7).standard_normal(len(AGES))
    wave = np.exp(-0.01 * late) * np.cos(1.3 * late + 0.3)
    noise = np.random.default_rng(8).standard_normal((len(AGES), 3))
    whole = Whole(AGES, 40 * wave[:, np.newaxis] * [1.0, -2.0, 0.5] + noise, BAND)
    plain = fit(whole.ages, whole.values, POLE, BAND, slopes=False)
    assert not explains(plain, BAND)
    found = with_jitter(plain, whole)
    assert found is not None
    assert found.jitter == pytest.approx(0.1, rel=0.3)
    assert sought(whole) is not None
    assert carried(plain, whole, checks=False) is not None
    # One that allowed for late stamps goes on doing so.
    again = carried(found, whole, checks=False)
    assert again is not None
    assert again.jitter > 0.05
    alone = whole._replace(values=whole.values[:, :1])
    assert with_jitter(fit(AGES, alone.values, POLE, BAND, slopes=False), alone) is None
    pair = whole._replace(values=whole.values[:, :2])
    assert with_jitter(fit(AGES, pair.values, POLE, BAND, slopes=False), pair) is not None
    assert with_jitter(fit(AGES, whole.values, Poles.none(), BAND, slopes=False), whole) is None
    # Not where readings scatter across the way of the beam.
    rough = whole._replace(values=whole.values + 5 * noise[:, ::-1])
    assert with_jitter(fit(AGES, rough.values, POLE, BAND, slopes=False), rough) is None
