"""How zeros walk, and when a drift is too fast: by hand."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray, Tracked, Walk, beyond_start
from beamtouch_models.filters.hurry import Hurry

NAN = math.nan
WALK = Walk(rate_mm_per_min=0.012, max_mm=0.1, start_mm=0.003)


@pytest.mark.parametrize(
    ("seconds", "grown_mm"),
    [
        (0.0, 0.0),
        # Before ten seconds, by the root of both times.
        (2.5, 0.0002 * 5.0),
        (10.0, 0.0002 * 10),
        # Then by the rate times the time, up to an even density within the limit.
        (40.0, 0.0002 * 40),
        (288.0, 0.0002 * 288),
        (289.0, 0.1 / math.sqrt(3)),
        (math.inf, 0.1 / math.sqrt(3)),
    ],
)
def test_a_common_drift_grows_with_the_time_up_to_its_limit(seconds: float, grown_mm: float) -> None:
    assert float(WALK.grown_mm(seconds)) == pytest.approx(grown_mm)


def tracked(common_mm: float, *own_mm: float) -> Tracked:
    return Tracked(np.zeros((1, len(own_mm))), np.array([common_mm]), np.array([own_mm]))


@pytest.mark.parametrize(
    ("common_mm", "own_mm", "mean_mm", "noise_mm2", "expected"),
    [
        # Of each zero by itself, that of the channel that has drifted most counts, beyond what a tare leaves.
        (0.004, (0.005, 0.002), (1.0, 2.0), (1e-6, 2e-6), (0.004, 0.004)),
        (0.004, (0.005, 0.002), (NAN, 2.0), (NAN, 2e-6), (0.004, 0.0)),
        (0.004, (0.003, 0.002), (1.0, 2.0), (1e-6, 2e-6), (0.004, 0.0)),
        # It is little beside a fiftieth of the noise of the least noisy channel: 0.004^2 + 0.005^2 - 0.003^2 = 3.2e-5.
        (0.004, (0.005, 0.002), (1.0, 2.0), (3.3e-5 * 50, 1.0), (0.0, 0.0)),
        (0.004, (0.005, 0.002), (1.0, 2.0), (1.0, 3.3e-5 * 50), (0.0, 0.0)),
        (0.004, (0.005, 0.002), (1.0, 2.0), (3.1e-5 * 50, 1.0), (0.004, 0.004)),
        (0.004, (0.005, 0.002), (1.0, NAN), (3.3e-5 * 50, NAN), (0.0, 0.0)),
        (0.004, (0.005, 0.002), (NAN, NAN), (NAN, NAN), (0.0, 0.0)),
    ],
)
def test_what_zeros_have_drifted_beyond_a_tare_counts_where_the_noise_does_not_hide_it(
    common_mm: float,
    own_mm: tuple[float, float],
    mean_mm: tuple[float, float],
    noise_mm2: tuple[float, float],
    expected: tuple[float, float],
) -> None:
    found = beyond_start(tracked(common_mm, *own_mm), WALK, np.array([mean_mm]), np.array([noise_mm2]))
    assert found[0] == pytest.approx(expected)


RATE = 0.006
"""Stated [mm per minute]; 0.1 um a second."""


def drifting(
    seconds: float,
    rates: FloatArray | list[float],
    *,
    hurry: Hurry | None = None,
    begin_s: float = 0.0,
    deviation_mm: float = 0.0,
    strains: bool = True,
) -> Hurry:
    """Add blocks of a quarter second of zeros that move at rates in um a second; NaN is a channel that is out."""
    hurry = hurry or Hurry(RATE)
    for block in range(1, round(4 * seconds) + 1):
        at_s = begin_s + block / 4
        moved_mm = 1e-3 * np.array(rates) * at_s
        hurry.add(at_s, 0.25, moved_mm, np.full(len(moved_mm), deviation_mm), strains=strains)
    return hurry


def test_the_fastest_zero_is_told_with_its_rate_and_the_company_that_it_has() -> None:
    for rates, channel, is_common in (
        ([0.2, 0.3, 0.9], 2, True),  # a median of 0.25 / 0.9
        ([0.1, 0.3, 0.9], 2, False),  # of 0.2 / 0.9
        ([-0.9, 0.3, 0.3], 0, False),
        ([-0.9, -0.3, -0.3, 0.5, NAN], 0, True),
        ([0.1, NAN, 0.9], 2, False),
        ([0.3, NAN, 0.9], 2, True),
        ([NAN, 0.9, NAN], 1, False),
    ):
        hurried = drifting(12.0, rates).hurried
        assert hurried is not None
        assert (hurried.channel, hurried.is_common) == (channel, is_common)
        assert hurried.mm_per_min == pytest.approx(0.06 * rates[channel], rel=0.03)


@pytest.mark.parametrize(("factor", "is_told"), [(1.48, False), (1.52, True)])
def test_a_drift_is_told_from_half_as_fast_again_as_stated_on(factor: float, is_told: bool) -> None:
    hurry = drifting(20.0, [0.1 * factor, 0.0])
    assert (hurry.hurried is not None) is is_told


def test_a_drift_is_told_after_three_seconds_at_the_end_of_the_leash_and_forgotten_after_as_many_off_it() -> None:
    assert drifting(2.75, [0.9, 0.0]).hurried is None
    hurry = drifting(3.0, [0.9, 0.0])
    assert hurry.hurried is not None
    assert drifting(2.75, [0.9, 0.0], hurry=hurry, begin_s=3.0, strains=False).hurried is not None
    assert drifting(0.25, [0.9, 0.0], hurry=hurry, begin_s=5.75, strains=False).hurried is None
    # However long it was, after nine seconds.
    hurry = drifting(40.0, [0.9, 0.0])
    assert drifting(8.75, [0.9, 0.0], hurry=hurry, begin_s=40.0, strains=False).hurried is not None
    assert drifting(0.25, [0.9, 0.0], hurry=hurry, begin_s=48.75, strains=False).hurried is None
    # Rest before the first strain is no credit.
    hurry = drifting(30.0, [0.9, 0.0], strains=False)
    assert drifting(3.0, [0.9, 0.0], hurry=hurry, begin_s=30.0).hurried is not None


def test_noise_hides_a_drift_up_to_four_deviations_of_a_smooth_mean() -> None:
    """A mean that forgets by exp(-block) a block has (1 - k) / (1 + k) of its variance; there are two such means."""
    keeps = math.exp(-0.25)
    # From the first smooth mean, after 8 blocks, to the last one, after 24; a smooth mean is late.
    moved_um = 0.9 * (4.0 - 0.25 * keeps * (keeps**7 - keeps**23) / (1 - keeps))
    beyond_mm = 1e-3 * (moved_um - 0.15 * 4)
    for deviations, is_told in ((3.98, False), (4.02, True)):
        deviation_mm = beyond_mm / deviations / math.sqrt(2 * (1 - keeps) / (1 + keeps))
        assert (drifting(6.0, [0.9, 0.0], deviation_mm=deviation_mm).hurried is not None) is is_told


def test_the_rate_is_that_of_the_last_half_minute_or_less() -> None:
    hurry = drifting(60.0, [0.9, 0.0])
    begin_mm = 1e-3 * 0.9 * 60
    for block in range(1, 241):
        at_s, moved_mm = 60 + block / 4, begin_mm + 3e-3 * block / 4
        hurry.add(at_s, 0.25, np.array([moved_mm, 0.0]), np.zeros(2), strains=True)
        if at_s == 88.0:
            assert hurry.hurried is not None
            assert hurry.hurried.mm_per_min == pytest.approx(0.18, rel=0.01)
    # Five means, five seconds apart: 20 s ago, it moved as it does.
    hurry = drifting(60.0, [3.0, 0.0])
    for block in range(1, 70):
        hurry.add(60 + block / 4, 0.25, np.array([0.18, 0.0]), np.zeros(2), strains=True)
    assert hurry.hurried is not None
    assert 0.0 < hurry.hurried.mm_per_min < 0.1


def test_a_channel_that_comes_back_is_taken_as_it_is() -> None:
    hurry = Hurry(RATE)
    for block in range(1, 61):
        at_s = block / 4
        value = NAN if at_s < 6 else 0.7
        hurry.add(at_s, 0.25, np.array([value, 1e-3 * 0.9 * at_s]), np.zeros(2), strains=True)
    assert hurry.hurried is not None
    assert hurry.hurried.channel == 1
