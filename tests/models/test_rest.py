"""When nothing happens: readings at rest wait, and nothing that happens does."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import Chain, Filtered, FloatArray, Mean, Rest

NOISE_MM, MM_PER_COUNT, CHANNELS, LONGEST = 0.004, -5e-5, 4, 1000
PERIOD = 98.0
BLOCK = 100


class Surface:
    """A filter of four channels, and what notices that nothing happens."""

    def __init__(self, longest: int = LONGEST) -> None:
        unit_mm = np.full(CHANNELS, NOISE_MM)
        self.chain = Chain(Mean("growing-mean", 4, longest, 0.03), CHANNELS, NOISE_MM, PERIOD)
        self.rest = Rest(unit_mm, longest, PERIOD)

    def take(self, values_mm: FloatArray) -> bool:
        """Take a block of readings, shape (readings, channels); NaN is a reading that is not good."""
        good = ~np.isnan(values_mm)
        slopes = np.where(good[-1], MM_PER_COUNT, np.nan)
        return self.rest.follow(self.chain.apply(values_mm), good, values_mm[-1], values_mm[-1] / MM_PER_COUNT, slopes)

    def explains(self, *values_mm: float | None) -> bool:
        return self.rest.explains([None if value is None else value / MM_PER_COUNT for value in values_mm])


def noise(seed: int, readings: int) -> FloatArray:
    return np.random.default_rng(seed).normal(0.0, NOISE_MM, (readings, CHANNELS))


def resting(seed: int = 1, longest: int = LONGEST) -> Surface:
    """A surface that has rested for long enough, at 0.1 mm."""
    surface = Surface(longest)
    values_mm = 0.1 + noise(seed, 3 * LONGEST)
    for start in range(0, len(values_mm), 4):
        surface.take(values_mm[start : start + 4])
        if start > LONGEST and surface.rest.lasts:
            return surface
    return surface


def test_blocks_of_noise_are_nothing() -> None:
    surface, lasted = resting(), 0
    for seed in range(30):
        lasted += surface.take(0.1 + noise(seed, BLOCK))
    # A mean is taken for one that moves once in a hundred readings; after it, the next block begins a rest again.
    assert lasted >= 26


def test_readings_up_to_five_deviations_of_noise_are_explained() -> None:
    surface = resting()
    for count in (-4.5, 0.0, 4.5):
        assert surface.explains(0.1 + count * NOISE_MM, 0.1, 0.1, 0.1)
        assert not surface.explains(0.1 + np.copysign(5.5, count) * NOISE_MM, 0.1, 0.1, 0.1)
    assert not surface.explains(None, 0.1, 0.1, 0.1)
    assert not surface.explains(0.1, 0.1, 0.1, float("nan"))


@pytest.mark.parametrize(
    ("touched", "deviations"), [(slice(50, None), 1.5), (slice(50, None), 3.0), (slice(20, 70), 3.0)]
)
@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 12), marks=pytest.mark.soak)])
def test_a_touch_too_weak_for_a_reading_ends_the_rest_with_the_next_mean_although_it_is_over(
    touched: slice, deviations: float, seeds: range
) -> None:
    for seed in seeds:
        surface, touched_mm = resting(seed), 0.1 + noise(100 + seed, BLOCK)
        touched_mm[touched] += deviations * NOISE_MM
        assert not surface.take(touched_mm)


def test_a_channel_that_is_lost_ends_the_rest_and_rests_without_it() -> None:
    surface, values_mm = resting(), 0.1 + noise(5, 2000)
    values_mm[:, 1] = np.nan
    assert not surface.take(values_mm[:4])
    surface.take(values_mm[4:8])
    assert surface.take(values_mm[8:40]) or surface.take(values_mm[40:80])
    assert surface.explains(0.1, None, 0.1, 0.1)
    assert surface.explains(0.1, 7.0, 0.1, 0.1)
    assert not surface.take(0.1 + noise(6, BLOCK))


def test_a_mean_that_cannot_hold_what_waits_never_rests() -> None:
    surface = resting(longest=200)
    assert surface.rest.most_waiting <= 0
    assert not surface.rest.lasts


def means_of(readings: float, *, moves: bool = False, mean_mm: FloatArray | None = None) -> Filtered:
    """Return the mean of so many readings."""
    mean_mm = np.array([[0.3, -0.2]]) if mean_mm is None else mean_mm
    moving = np.array([moves])
    return Filtered(
        mean_mm, np.full((1, 2), 1 / readings), np.ones(2), moving, ~moving, np.zeros((1, 2, 2)), np.zeros(1, np.bool_)
    )


@pytest.mark.parametrize(
    ("longest", "period", "most_waiting", "least"),
    # Readings of two periods, ten at least; a mean holds 95 % of those that it could.
    [(1000, 98.0, 754, 196), (1000, 4.0, 940, 10), (100, 31.5, 32, 63), (67, 32.0, 0, 64)],
)
def test_a_mean_is_settled_over_two_periods_and_holds_what_waits(
    longest: int, period: float, most_waiting: int, least: int
) -> None:
    assert Rest(np.ones(2), longest, period).most_waiting == most_waiting
    good, counts, slopes = np.ones((30, 2), np.bool_), np.zeros(2), np.ones(2)
    for factor, is_settled in ((1.001, most_waiting > 0), (0.999, False)):
        rest = Rest(np.ones(2), longest, period)
        settled = means_of(factor * 0.95 * (least + 30))
        assert not rest.follow(settled, good, counts, counts, slopes)
        assert not rest.lasts  # what was good before is not known yet
        assert not rest.follow(settled, good, counts, counts, slopes)
        assert rest.lasts is is_settled
        assert rest.follow(settled, good, counts, counts, slopes) is is_settled
        assert not rest.follow(means_of(1e6, moves=True), good, counts, counts, slopes)
        assert not rest.lasts


def test_what_the_mean_explains_is_in_counts_of_each_channel() -> None:
    rest, good = Rest(np.array([0.01, 0.03]), 1000, 5.0), np.ones((4, 2), np.bool_)
    values_mm, counts, slopes = np.array([0.25, -0.5]), np.array([100.0, 900.0]), np.array([0.01, -0.002])
    for _ in range(2):
        rest.follow(means_of(500), good, values_mm, counts, slopes)
    # Means of 0.3 and -0.2 mm are 5 counts above and 150 below; five deviations are 5 and 75 counts.
    for first, second, is_explained in (
        (100.01, 824.99, True),
        (109.99, 675.01, True),
        (99.99, 750.0, False),
        (110.01, 750.0, False),
        (105.0, 825.01, False),
        (105.0, 674.99, False),
        (math.nan, 750.0, False),
    ):
        assert rest.explains([first, second]) is is_explained
    assert not rest.explains([105.0, None])
    for _ in range(2):
        rest.follow(means_of(500, mean_mm=np.array([[0.3, np.nan]])), good, values_mm, counts, slopes)
    assert rest.explains([105.0, None])
    assert rest.explains([105.0, 1e9])
    assert not rest.explains([None, 1e9])
