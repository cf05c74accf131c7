"""What `noise` finds in recordings with known noise, against theory."""

import math

import numpy as np
import pytest

from beamtouch_daemon.commands.noise import Measurement, Recording, report
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring import noise as daemon_noise
from beamtouch_daemon.measuring.at_rest import select_rest
from beamtouch_daemon.measuring.noise import ChannelNoise, keys_of, measure_noise, readings_needed, round_up
from beamtouch_models.design.pricing import noise as priced_noise

from .surfaces import (
    CHANNEL,
    CHANNELS,
    MINUTE,
    NOISE_MM,
    RATE_HZ,
    STEP_MM,
    autoregressive,
    counts_of,
    four_channels,
    mean_of,
    of_white,
)


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "that of white readings which would leave the same scatter behind the configured filter.",
)
@pytest.mark.parametrize(("window", "alike"), [(1, 0.9), (4, 0.5), (20, 0.0), (20, 0.9)])
def test_the_effective_noise_is_that_of_white_readings_with_the_same_mean(window: int, alike: float) -> None:
    found = measure_noise(counts_of(NOISE_MM * autoregressive(alike)), four_channels(mean_of(window)))
    for one in found:
        assert one.noise_mm == pytest.approx(NOISE_MM, rel=0.05)
        assert one.effective_noise_mm == pytest.approx(NOISE_MM * of_white(window, alike), rel=0.08)
        assert one.drift_mm < 0.4 * NOISE_MM
        assert not one.is_rounded
    # The variance of a mean of very many readings is (1 + a) / (1 - a) times that of white noise. In a minute, the
    # standard deviation of such an estimate from one channel is 18 % (Sokal) at 0.9.
    alike_for = np.mean([one.correlated_readings for one in found])
    assert alike_for == pytest.approx((1 + alike) / (1 - alike), rel=0.25)


def test_noise_that_stays_alike_for_a_second_is_found_in_a_minute() -> None:
    found = measure_noise(counts_of(NOISE_MM * autoregressive(0.99)), four_channels())
    assert np.mean([one.effective_noise_mm for one in found]) == pytest.approx(NOISE_MM * of_white(20, 0.99), rel=0.12)


@pytest.mark.parametrize(
    ("value", "stated"), [(0.0, 0.0), (0.0012341, 0.00124), (0.00123, 0.00123), (0.12, 0.12), (9.991, 10.0), (341, 341)]
)
def test_what_is_stated_has_three_digits_and_is_never_less(value: float, stated: float) -> None:
    assert round_up(value) == stated


def test_drift_is_not_taken_for_noise() -> None:
    drift_mm = 10 * NOISE_MM
    moved = NOISE_MM * autoregressive(0.0) + np.linspace(0, drift_mm, MINUTE)[:, np.newaxis]
    for one in measure_noise(counts_of(moved), four_channels()):
        assert one.noise_mm == pytest.approx(NOISE_MM, rel=0.03)
        assert one.effective_noise_mm == pytest.approx(NOISE_MM, rel=0.06)
        # A zero that moves evenly is on average this far from where it was at the last tare.
        assert one.drift_mm == pytest.approx(drift_mm / math.sqrt(3), rel=0.05)


def test_the_shortest_recording_gives_the_noise_within_some_percent() -> None:
    surface = four_channels(mean_of(4))
    assert readings_needed(surface) == 500
    ratios = [
        one.effective_noise_mm / NOISE_MM
        for seed in range(20)
        for one in measure_noise(counts_of(NOISE_MM * autoregressive(0.0, 500, seed)), surface)
    ]
    assert 0.98 < np.mean(ratios) < 1.06
    assert np.std(ratios) < 0.07
    assert readings_needed(four_channels(mean_of(400))) == 40_000


def test_spikes_of_two_channels_one_after_the_other_leave_a_noise() -> None:
    # While the second one may be a touch, single readings without spikes leave the first channel without a value.
    values = NOISE_MM * autoregressive(0.0)
    values[MINUTE // 2, 0] += 10 * NOISE_MM
    values[MINUTE // 2 + 1, 1] += 10 * NOISE_MM
    for one in measure_noise(counts_of(values), four_channels({"kind": "none", "spike_mm": 7 * NOISE_MM})):
        assert one.effective_noise_mm == pytest.approx(NOISE_MM, rel=0.03)


@pytest.mark.parametrize(("noise", "hides"), [(0.0, True), (0.1, True), (0.3, True), (0.5, False), (2.0, False)])
def test_steps_hide_a_noise_of_less_than_half_a_step(noise: float, hides: bool) -> None:
    between = np.random.default_rng(4).uniform(size=CHANNELS)
    counts = np.rint(20_000 + between + noise * autoregressive(0.0))
    for one in measure_noise(counts, four_channels()):
        assert one.is_rounded == hides
        if not hides:  # with the rounding, which is as good as independent noise here
            assert one.noise_mm == pytest.approx(math.hypot(noise, 1 / math.sqrt(12)) * STEP_MM, rel=0.03)


def test_means_of_conversions_are_judged_by_the_steps_of_a_conversion() -> None:
    surface = four_channels(source={"kind": "serial", "port": "/dev/null", "oversampling": 16})
    fresh = np.random.default_rng(5).standard_normal((2000, 16, CHANNELS))
    for noise, hides in ((0.1, True), (0.7, False)):
        counts = np.rint(20_000.5 + noise * fresh).mean(axis=1)
        assert {one.is_rounded for one in measure_noise(counts, surface)} == {hides}


def keys_for(noise: float, alike: float, channels: slice = slice(None)) -> tuple[list[ChannelNoise], Surface]:
    counts = np.full((MINUTE, CHANNELS), 20_000.0)
    counts[:, channels] = np.rint(20_000 + noise * autoregressive(alike))[:, channels]
    surface = four_channels()
    return measure_noise(counts, surface), surface


@pytest.mark.parametrize(
    ("noise", "daemon_mm", "scene_mm", "bits"),
    [
        (20.0, NOISE_MM, NOISE_MM, None),  # as it is
        # Steps that matter are stated by the bits of the ADC, and not twice: 3 mm / (0.8 x 32767) is the smallest step
        # that is not below 0.1 um.
        (1.0, math.hypot(1, 1 / math.sqrt(12)) * STEP_MM, STEP_MM, 15),
        (0.1, STEP_MM / math.sqrt(12), 0.0, 15),  # hidden by the steps: the scene has the rounding
    ],
)
def test_white_noise_is_stated_with_the_steps_that_matter(
    noise: float, daemon_mm: float, scene_mm: float, bits: int | None
) -> None:
    keys = keys_of(*keys_for(noise, 0.0))
    assert keys.daemon_noise_mm == pytest.approx(daemon_mm, rel=0.06 if scene_mm else 0.01)
    assert keys.scene_noise_mm == pytest.approx(scene_mm, rel=0.06, abs=0.03 * STEP_MM)
    assert (keys.adc_bits, keys.stuck_after_ms) == (bits, {})
    if noise > 1.0:
        assert keys.zero_drift_mm == pytest.approx(NOISE_MM / 5, rel=0.06)


def test_where_only_some_channels_are_hidden_the_drift_states_their_rounding() -> None:
    keys = keys_of(*keys_for(1.0, 0.0, slice(2)))
    assert keys.daemon_noise_mm == pytest.approx(1.04 * STEP_MM, rel=0.06)
    assert keys.zero_drift_mm >= math.sqrt(2 / 12) * STEP_MM
    assert keys.stuck_after_ms == {"s3": 3_600_000.0, "s4": 3_600_000.0}
    # The configuration takes what is printed.
    channels = [
        CHANNEL | {"name": name, "register": at, "stuck_after_ms": ms}
        for at, (name, ms) in enumerate(keys.stuck_after_ms.items())
    ]
    assert [one.stuck_after_ms for one in four_channels(channels=channels).channels] == [3_600_000.0] * 2


def test_a_channel_that_changes_slowly_is_not_stuck_by_its_own_noise() -> None:
    found, surface = keys_for(2.0, 0.95)
    keys = keys_of(found, surface)
    counts = np.rint(20_000 + 2.0 * autoregressive(0.95, 200_000, 8))
    longest = max(np.diff(np.flatnonzero(np.diff(column) != 0)).max() for column in counts.T)
    assert sorted(keys.stuck_after_ms) == ["s1", "s2", "s3", "s4"]
    assert longest < min(keys.stuck_after_ms.values()) * RATE_HZ / 1e3


@pytest.mark.parametrize(
    ("noise", "alike", "said"),
    [
        (1.0, 0.0, []),  # counts repeat by chance
        (0.1, 0.0, ["the ADC's steps hide the noise"]),
        (20.0, 0.9, ["so the mean of 20 readings is up to 3."]),  # of_white(20, 0.9) is 3.3
        (20.0, 0.0, []),
    ],
)
def test_noise_that_a_mean_does_not_take_away_is_remarked_on(noise: float, alike: float, said: list[str]) -> None:
    channels, surface = keys_for(noise, alike)
    recording = Recording(np.zeros((MINUTE, CHANNELS)), 0, 60.0)
    lines = report([Measurement("bench", surface, recording, channels, keys_of(channels, surface))])
    remarks = [line for line in lines if line.startswith("  s1, s2, s3, s4: ")]
    assert [words in line for words, line in zip(said, remarks, strict=True)] == [True] * len(said)


def test_daemon_and_models_take_the_same_for_zeros() -> None:
    assert daemon_noise.ZERO_SHARE == priced_noise.ZERO_SHARE


@pytest.mark.promise("docs/how-to/drift.md", "from 20 minutes on, it prints the `drift_um_per_min` for the scene.")
def test_a_recording_of_an_hour_says_how_fast_zeros_drift_and_a_minute_does_not() -> None:
    surface = four_channels(rate_hz=20.0)
    minutes = np.arange(60 * 60 * 20)[:, np.newaxis] / 60 / 20
    drift_mm = 0.005 * minutes * np.array([1.0, 1.0, 0.5, -0.2])
    noise_mm = NOISE_MM * np.random.default_rng(8).standard_normal(drift_mm.shape)
    counts = counts_of(drift_mm + noise_mm)
    tared_mm = {channel.name: channel.rest_gap_mm for channel in surface.channels}
    keys = keys_of(measure_noise(select_rest(counts, surface, tared_mm), surface), surface)
    assert keys.drift_um_per_min == pytest.approx(5.0, rel=0.1)
    assert keys.zero_drift_mm < 0.2 * 0.005 * 60  # not what is followed at each rest
    short = measure_noise(counts_of((drift_mm + noise_mm)[: 15 * 60 * 20]), surface)
    assert keys_of(short, surface).drift_um_per_min is None
