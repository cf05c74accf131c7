"""The noise of recordings with known noise, against theory: white and coloured, drifting, and coarser than its ADC."""

import math

import numpy as np
import pytest

from beamtouch_daemon.commands.noise import Measurement, Recording, filter_name, report
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing import noise as daemon_noise
from beamtouch_daemon.processing.noise import ChannelNoise, keys_of, measure_noise, readings_needed, round_up
from beamtouch_models.challenge import sensor_cases
from beamtouch_models.filters import FloatArray
from beamtouch_models.pricing import noise as priced_noise

NOISE_MM, STEP_MM, RATE_HZ = 0.002, 0.0001, 200.0
CHANNELS, MINUTE = 4, 12_000


def surface_of(chosen: dict[str, object] | None = None, source: dict[str, object] | None = None) -> Surface:
    channels = [
        {
            "name": f"s{index + 1}",
            "register": index,
            "gain_mm_per_count": -STEP_MM,
            "offset_mm": 4.5,
            "rest_gap_mm": 2.5,
            "range_mm": [1.0, 4.0],
        }
        for index in range(CHANNELS)
    ]
    tcp = {"kind": "modbus-tcp", "host": "127.0.0.1"}
    return Surface.model_validate(
        {"rate_hz": RATE_HZ, "source": source or tcp, "filter": chosen or mean_of(20), "channels": channels}
    )


def mean_of(window: int) -> dict[str, object]:
    return {"kind": "moving-average", "window": window}


def autoregressive(alike: float, readings: int = MINUTE, seed: int = 3) -> FloatArray:
    """Noise of standard deviation 1 whose successive values have the correlation `alike`, (readings, channels)."""
    fresh = np.random.default_rng(seed).standard_normal((readings, CHANNELS))
    noise = fresh.copy()
    for index in range(1, readings):
        noise[index] = alike * noise[index - 1] + math.sqrt(1 - alike**2) * fresh[index]
    return noise


def counts_of(deviation_mm: FloatArray) -> FloatArray:
    return np.rint((2.0 + deviation_mm) / STEP_MM)


def of_white(window: int, alike: float) -> float:
    """Standard deviation of a mean of autoregressive noise over that of white noise: the sum of all covariances."""
    lags = np.arange(1, window)
    return math.sqrt(1 + 2 * float(np.sum((1 - lags / window) * alike**lags)))


@pytest.mark.parametrize("window", [1, 4, 20])
@pytest.mark.parametrize("alike", [0.0, 0.5, 0.9])
def test_the_effective_noise_is_that_of_white_readings_with_the_same_mean(window: int, alike: float) -> None:
    found = measure_noise(counts_of(NOISE_MM * autoregressive(alike)), surface_of(mean_of(window)))
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
    found = measure_noise(counts_of(NOISE_MM * autoregressive(0.99)), surface_of())
    assert np.mean([one.effective_noise_mm for one in found]) == pytest.approx(NOISE_MM * of_white(20, 0.99), rel=0.12)


def test_drift_is_not_taken_for_noise() -> None:
    drift_mm = 10 * NOISE_MM
    moved = NOISE_MM * autoregressive(0.0) + np.linspace(0, drift_mm, MINUTE)[:, np.newaxis]
    for one in measure_noise(counts_of(moved), surface_of()):
        assert one.noise_mm == pytest.approx(NOISE_MM, rel=0.03)
        assert one.effective_noise_mm == pytest.approx(NOISE_MM, rel=0.06)
        # A zero that moves evenly is on average this far from where it was at the last tare.
        assert one.drift_mm == pytest.approx(drift_mm / math.sqrt(3), rel=0.05)


def test_the_shortest_recording_gives_the_noise_within_some_percent() -> None:
    surface = surface_of(mean_of(4))
    assert readings_needed(surface) == 500
    ratios = [
        one.effective_noise_mm / NOISE_MM
        for seed in range(20)
        for one in measure_noise(counts_of(NOISE_MM * autoregressive(0.0, 500, seed)), surface)
    ]
    assert 0.98 < np.mean(ratios) < 1.06
    assert np.std(ratios) < 0.07
    assert readings_needed(surface_of(mean_of(400))) == 40_000


@pytest.mark.parametrize(("noise", "hides"), [(0.0, True), (0.1, True), (0.3, True), (0.5, False), (2.0, False)])
def test_steps_hide_a_noise_of_less_than_half_a_step(noise: float, hides: bool) -> None:
    between = np.random.default_rng(4).uniform(size=CHANNELS)
    counts = np.rint(20_000 + between + noise * autoregressive(0.0))
    for one in measure_noise(counts, surface_of()):
        assert one.is_rounded == hides
        if not hides:  # with the rounding, which is as good as independent noise here
            assert one.noise_mm == pytest.approx(math.hypot(noise, 1 / math.sqrt(12)) * STEP_MM, rel=0.03)


def test_means_of_conversions_are_judged_by_the_steps_of_a_conversion() -> None:
    surface = surface_of(source={"kind": "serial", "port": "/dev/null", "oversampling": 16})
    fresh = np.random.default_rng(5).standard_normal((2000, 16, CHANNELS))
    for noise, hides in ((0.1, True), (0.7, False)):
        counts = np.rint(20_000.5 + noise * fresh).mean(axis=1)
        assert {one.is_rounded for one in measure_noise(counts, surface)} == {hides}


def keys_for(noise: float, alike: float, channels: slice = slice(None)) -> tuple[list[ChannelNoise], Surface]:
    counts = np.full((MINUTE, CHANNELS), 20_000.0)
    counts[:, channels] = np.rint(20_000 + noise * autoregressive(alike))[:, channels]
    surface = surface_of()
    return measure_noise(counts, surface), surface


def test_white_noise_is_stated_as_it_is() -> None:
    keys = keys_of(*keys_for(20.0, 0.0))
    assert keys.daemon_noise_mm == keys.scene_noise_mm == pytest.approx(NOISE_MM, rel=0.06)
    assert keys.zero_drift_mm == pytest.approx(NOISE_MM / 5, rel=0.06)
    assert (keys.adc_bits, keys.stuck_after_ms) == (None, {})


def test_steps_that_matter_are_stated_by_the_bits_of_the_adc_and_not_twice() -> None:
    keys = keys_of(*keys_for(1.0, 0.0))
    assert keys.adc_bits == 15  # 3 mm / (0.8 x 32767) is the smallest step that is not below 0.1 um
    assert keys.daemon_noise_mm == pytest.approx(math.hypot(1, 1 / math.sqrt(12)) * STEP_MM, rel=0.06)
    assert keys.scene_noise_mm == pytest.approx(STEP_MM, rel=0.06)


def test_noise_that_the_steps_hide_leaves_the_rounding_to_the_scene() -> None:
    keys = keys_of(*keys_for(0.1, 0.0))
    assert keys.daemon_noise_mm == pytest.approx(STEP_MM / math.sqrt(12), rel=0.01)
    assert keys.scene_noise_mm < 0.03 * STEP_MM
    assert (keys.adc_bits, keys.stuck_after_ms) == (15, {})


def test_where_only_some_channels_are_hidden_the_drift_states_their_rounding() -> None:
    keys = keys_of(*keys_for(1.0, 0.0, slice(2)))
    assert keys.daemon_noise_mm == pytest.approx(1.04 * STEP_MM, rel=0.06)
    assert keys.zero_drift_mm >= math.sqrt(2 / 12) * STEP_MM
    assert keys.stuck_after_ms == {"s3": 3_600_000.0, "s4": 3_600_000.0}


def test_a_channel_that_changes_slowly_is_not_stuck_by_its_own_noise() -> None:
    found, surface = keys_for(2.0, 0.95)
    keys = keys_of(found, surface)
    counts = np.rint(20_000 + 2.0 * autoregressive(0.95, 200_000, 8))
    longest = max(np.diff(np.flatnonzero(np.diff(column) != 0)).max() for column in counts.T)
    assert sorted(keys.stuck_after_ms) == ["s1", "s2", "s3", "s4"]
    assert longest < min(keys.stuck_after_ms.values()) * RATE_HZ / 1e3


@pytest.mark.parametrize(
    ("chosen", "named"),
    [
        ({"kind": "none"}, "single readings"),
        (mean_of(20), "the mean of 20 readings"),
    ],
)
def test_the_filter_is_named_for_people(chosen: dict[str, object], named: str) -> None:
    surface = surface_of(chosen)
    counts = counts_of(NOISE_MM * autoregressive(0.0))
    channels = measure_noise(counts, surface)
    assert filter_name(surface) == named
    measurement = Measurement("bench", surface, Recording(counts, 3, 60.0), channels, keys_of(channels, surface))
    assert f"bench: {MINUTE} readings in 60 s, 3 lost; effective noise for {named}" in report([measurement])


def test_noise_that_steps_hide_and_noise_that_stays_alike_are_remarked_on() -> None:
    def remarks(noise: float, alike: float) -> list[str]:
        channels, surface = keys_for(noise, alike)
        recording = Recording(np.zeros((MINUTE, CHANNELS)), 0, 60.0)
        lines = report([Measurement("bench", surface, recording, channels, keys_of(channels, surface))])
        return [line for line in lines if line.startswith("  s1, s2, s3, s4: ")]

    (hidden,) = remarks(0.1, 0.0)
    assert "the ADC's steps hide the noise" in hidden
    (alike,) = remarks(20.0, 0.9)
    assert "so the mean of 20 readings is up to 3." in alike  # of_white(20, 0.9) is 3.3
    assert remarks(20.0, 0.0) == []


def test_values_are_rounded_up_to_three_digits() -> None:
    assert [round_up(value) for value in (0.0, 0.0012301, 0.00123, 9.991, 1e-12)] == [
        0.0,
        0.00124,
        0.00123,
        10.0,
        1e-12,
    ]


def test_daemon_and_models_take_the_same_for_hidden_noise_and_for_zeros() -> None:
    assert daemon_noise.HIDDEN == sensor_cases.HIDDEN
    assert daemon_noise.ZERO_SHARE == priced_noise.ZERO_SHARE
