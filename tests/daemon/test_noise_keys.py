"""The keys that `noise` states, from the noise of each channel, and recordings whose noise is known exactly."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from beamtouch_daemon.measuring.noise import ChannelNoise, Keys, keys_of, measure_noise
from beamtouch_models.filters import PERSISTS_S, FloatArray

from .surfaces import RATE_HZ, STEP_MM, counts_of, mean_of, surface_of

QUIET = ChannelNoise(
    channel="s1",
    noise_mm=0.002,
    correlated_readings=1.0,
    effective_noise_mm=0.002,
    fast_noise_mm=0.002,
    drift_mm=0.0001,
    drift_mm_per_min=None,
    step_mm=STEP_MM,
    is_rounded=False,
    longest_run=1,
    mean_run=1.0,
    readings=1000,
)


def keys(*changes: Mapping[str, Any], channel: dict[str, object] | None = None, **surface: object) -> Keys:
    """Return the keys for channels that differ in this from a quiet one."""
    channels = [replace(QUIET, channel=f"s{at}", **change) for at, change in enumerate(changes, 1)]
    return keys_of(channels, surface_of(len(changes), channel, **surface))


def test_the_noisiest_channel_states_the_noise_and_the_one_that_drifts_most_the_drift() -> None:
    found = keys({"effective_noise_mm": 0.004}, {"drift_mm": 0.003}, {})
    assert (found.daemon_noise_mm, found.scene_noise_mm, found.zero_drift_mm) == (0.004, 0.004, 0.003)
    assert (found.adc_bits, found.drift_um_per_min, found.stuck_after_ms) == (None, None, {})
    assert keys({"effective_noise_mm": 0.004}, {}).zero_drift_mm == pytest.approx(0.004 / 5)  # a fifth at least


def test_a_drift_that_is_followed_counts_for_the_time_of_a_contact() -> None:
    found = keys({"drift_mm_per_min": 0.006, "drift_mm": 0.1}, {"drift_mm_per_min": 0.005, "drift_mm": 0.2})
    assert found.drift_um_per_min == 6.0
    assert found.zero_drift_mm == pytest.approx(max(0.0004, 0.006 * PERSISTS_S / 60), rel=0.01)
    found = keys({"drift_mm_per_min": 30.0})
    assert found.zero_drift_mm == pytest.approx(30 * PERSISTS_S / 60, rel=0.01)


ROUNDING = 1 / math.sqrt(12)
"""Of a step: the standard deviation of a uniform distribution."""


@pytest.mark.parametrize(
    ("step_mm", "bits", "scene_mm"),
    [
        (0.00069, None, 0.002),  # their rounding is less than a tenth of the noise
        # 80 % of the scale spans 3 mm, so 12 bits have steps of 3 / 0.8 / 4095 = 0.00092 mm.
        (0.00070, 12, math.sqrt(0.002**2 - (0.00070 * ROUNDING) ** 2)),
        (0.00091, 12, math.sqrt(0.002**2 - (0.00091 * ROUNDING) ** 2)),
        (3 / 0.8 / 4095, 12, math.sqrt(0.002**2 - (0.000916 * ROUNDING) ** 2)),
        (0.00093, 11, math.sqrt(0.002**2 - (0.00093 * ROUNDING) ** 2)),
        (0.01, 8, 0.0),  # more rounding than noise
        (3 / 0.8 / 63, 6, 0.0),
        (0.06, None, 0.002),  # a scene takes six bits at least
    ],
)
def test_steps_that_matter_are_stated_in_bits_and_are_no_part_of_the_noise(
    step_mm: float, bits: int | None, scene_mm: float
) -> None:
    found = keys({"step_mm": 0.0005}, {"step_mm": step_mm})
    assert (found.adc_bits, found.daemon_noise_mm) == (bits, 0.002)
    assert found.scene_noise_mm == pytest.approx(scene_mm, rel=0.006)


def test_a_scene_has_at_most_16_bits() -> None:
    fine = {"effective_noise_mm": 1e-6, "step_mm": 2e-5}
    assert keys(fine).adc_bits == 16
    assert keys(fine, channel={"range_mm": [1.0, 2.1]}).adc_bits == 16  # 65537 steps
    assert keys(fine, channel={"range_mm": [1.0, 2.0]}).adc_bits == 15


@pytest.mark.parametrize("conversions", [1, 9])
def test_where_the_steps_hide_all_noise_it_is_that_of_rounding(conversions: int) -> None:
    source = {"kind": "serial", "port": "/dev/x", "oversampling": conversions}
    found = keys({"is_rounded": True, "step_mm": 0.01}, {"is_rounded": True, "step_mm": 0.002}, source=source)
    # The scene has a noise of a fiftieth of a step, which averages nothing away.
    noise_mm = math.hypot(0.01 / 50, 0.01 * ROUNDING) / math.sqrt(conversions)
    assert found.daemon_noise_mm == pytest.approx(noise_mm, rel=0.01)
    assert (found.adc_bits, found.scene_noise_mm) == (8, 0.0002)
    assert found.zero_drift_mm == pytest.approx(noise_mm / 5, rel=0.01)


def test_where_a_scene_cannot_state_the_steps_the_drift_has_the_rounding_of_reading_and_tare() -> None:
    loud, hidden = {"drift_mm": 0.003}, {"is_rounded": True, "step_mm": 0.01, "drift_mm": 0.003}
    both_mm = math.sqrt(0.003**2 + 2 * (0.01 * ROUNDING) ** 2)
    assert keys(loud, hidden).zero_drift_mm == pytest.approx(both_mm, rel=0.01)
    assert keys(hidden).zero_drift_mm == pytest.approx(0.003, rel=0.01)
    assert keys(loud, {"step_mm": 0.01}).zero_drift_mm == pytest.approx(0.003, rel=0.01)
    coarse = {"is_rounded": True, "step_mm": 0.1, "drift_mm": 0.003}  # five bits: none that a scene takes
    noise_mm = 0.1 * math.hypot(1 / 50, ROUNDING)
    expected = math.sqrt((noise_mm / 5) ** 2 + 2 * (0.1 * ROUNDING) ** 2)
    assert keys(coarse).zero_drift_mm == pytest.approx(expected, rel=0.01)


def test_noise_that_stays_alike_is_stated_although_the_steps_hide_it() -> None:
    hidden = {"is_rounded": True, "step_mm": 0.001, "noise_mm": 0.0003}
    assert keys(hidden | {"effective_noise_mm": 0.0009}).daemon_noise_mm == 0.0009
    assert keys(hidden | {"effective_noise_mm": 0.00035}).daemon_noise_mm == pytest.approx(0.001 * ROUNDING, rel=0.01)


def test_of_fractional_numbers_half_a_step_is_stated_at_least_and_no_bits() -> None:
    found = keys({"step_mm": 0.01}, {"step_mm": 0.006}, channel={"type": "f32"})
    assert (found.daemon_noise_mm, found.scene_noise_mm, found.adc_bits) == (0.005, 0.005, None)
    assert keys({"step_mm": 0.001}, channel={"type": "f32"}).daemon_noise_mm == 0.002


@pytest.mark.parametrize(
    ("change", "after_ms"),
    [
        # A run that comes once in a thousand readings: one with the chance of 1e-12 is four times as long.
        ({"longest_run": 600}, 4 * 600 / RATE_HZ * 1e3),
        # Of noise of 0.3 counts, `test_stuck.py` has the longest run.
        ({"fast_noise_mm": math.sqrt(0.3**2 + 1 / 12) * STEP_MM}, 276 / RATE_HZ * 1e3),
        ({"longest_run": 200_000}, 3_600_000.0),
        ({"is_rounded": True}, 3_600_000.0),
        ({"step_mm": 0.0, "longest_run": 600}, 12_000.0),
        ({"longest_run": 1}, None),
    ],
)
def test_a_channel_whose_counts_stay_equal_for_longer_states_the_time(
    change: dict[str, object], after_ms: float | None
) -> None:
    assert keys({}, change).stuck_after_ms == ({} if after_ms is None else {"s2": after_ms})


def test_a_time_is_stated_where_it_is_half_as_long_again_as_the_noise_says() -> None:
    noise = {"effective_noise_mm": math.sqrt(0.3**2 + 1 / 12) * STEP_MM}
    found = keys(noise, noise | {"longest_run": 103}, noise | {"longest_run": 104})  # 412 and 416 of 276
    assert found.stuck_after_ms == {"s3": pytest.approx(416 / RATE_HZ * 1e3)}


@pytest.mark.parametrize(
    ("change", "is_repeated", "is_coloured"),
    [
        ({"mean_run": 1.99, "effective_noise_mm": 0.0024}, False, False),
        ({"mean_run": 2.0}, True, False),
        ({"mean_run": 9.0, "is_rounded": True, "effective_noise_mm": 0.00241}, False, True),
    ],
)
def test_values_that_repeat_and_noise_that_stays_alike_are_told(
    change: dict[str, Any], is_repeated: bool, is_coloured: bool
) -> None:
    channel = replace(QUIET, **change)
    assert (channel.is_repeated, channel.is_coloured) == (is_repeated, is_coloured)


FAST, SLOW = 10, 3
"""Counts up and down from one reading to the next, and from one block to the next."""


def in_blocks(blocks: int, length: int, per_block: float = 0.0) -> FloatArray:
    """Return counts, shape (readings, 1), that are steady in each block, beside a drift of so many counts."""
    at = np.arange(blocks * length)
    counts: FloatArray = 20_000 + FAST * (-1.0) ** at + SLOW * (-1.0) ** (at // length) + per_block * (at // length)
    return counts[:, np.newaxis]


@pytest.mark.parametrize(
    ("window", "blocks", "length"),
    [(1, 25, 20), (1, 30, 40), (1, 30, 24), (10, 5, 200)],
    ids=["20 values in a block", "30 blocks", "30 blocks of less", "5 blocks"],
)
def test_noise_is_the_scatter_within_blocks_and_that_from_one_to_the_next(
    window: int, blocks: int, length: int
) -> None:
    counts = np.concatenate([in_blocks(blocks, length), np.full((4, 1), 20_000.0)])  # too few for a block
    (found,) = measure_noise(counts, surface_of(1, filter=mean_of(window)))
    of_block = 2 * SLOW**2  # half the mean square of steps of two
    variance = FAST**2 + of_block
    assert found.noise_mm == pytest.approx(math.sqrt(variance) * STEP_MM, rel=0.01)
    assert found.correlated_readings == pytest.approx(of_block * length / variance, rel=0.02)
    assert found.fast_noise_mm == pytest.approx(math.sqrt(2) * FAST * STEP_MM, rel=0.01)
    assert (found.readings, found.longest_run, found.mean_run) == (blocks * length, 1, 1.0)


def test_the_drift_of_zeros_is_that_of_means_without_their_noise() -> None:
    per_block = 40.0
    (found,) = measure_noise(in_blocks(25, 20, per_block), surface_of(1, filter=mean_of(1)))
    means = [SLOW * (-1) ** block + per_block * block for block in range(25)]
    apart = sum((mean - means[0]) ** 2 + (mean - means[-1]) ** 2 for mean in means) / 50
    # One of 25 is not apart from itself.
    assert found.drift_mm == pytest.approx(math.sqrt(apart - 2 * 2 * SLOW**2 * 24 / 25) * STEP_MM, rel=1e-3)


def test_a_channel_that_never_changes_has_no_noise_and_one_run() -> None:
    (found,) = measure_noise(np.full((600, 1), 20_000.0), surface_of(1, filter=mean_of(1)))
    assert (found.noise_mm, found.drift_mm, found.fast_noise_mm, found.is_rounded) == (0.0, 0.0, 0.0, True)
    assert (found.longest_run, found.mean_run, found.correlated_readings) == (600, 600.0, 1.0)


@pytest.mark.parametrize("minutes", [19.99, 20])
def test_from_20_minutes_on_the_drift_in_a_minute_is_measured(minutes: float) -> None:
    at = np.arange(round(60 * minutes))
    counts = 20_000 + FAST * (-1.0) ** at + 50 / 60 * at  # 50 counts a minute
    (found,) = measure_noise(np.rint(counts)[:, np.newaxis], surface_of(1, filter=mean_of(1), rate_hz=1.0))
    assert found.drift_mm_per_min == (None if minutes < 20 else pytest.approx(50 * STEP_MM, rel=1e-3))


def test_the_noise_of_the_means_of_minutes_is_no_drift() -> None:
    # A mean of 60 readings scatters by 2.6 um, so two of them differ by as much as zeros drift.
    noise_mm, mm_per_min = 0.02, 0.005
    at_min = np.arange(3600)[:, np.newaxis] / 60
    deviation_mm = noise_mm * np.random.default_rng(6).standard_normal((3600, 8)) + mm_per_min * at_min
    found = measure_noise(counts_of(deviation_mm), surface_of(8, filter=mean_of(1), rate_hz=1.0))
    assert np.mean([one.drift_mm_per_min for one in found]) == pytest.approx(mm_per_min, rel=0.06)


def test_noise_that_large_steps_hide_is_a_fiftieth_of_them_beside_their_rounding() -> None:
    found = keys({"is_rounded": True, "step_mm": 1.0})
    assert found.daemon_noise_mm == 0.29  # sqrt(1 / 12 + 0.02**2) is 0.28937, and without the fiftieth 0.28868
