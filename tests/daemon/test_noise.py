"""`noise`: recordings with known noise against theory, and the command on real lines."""

import json
import math
import random
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from beamtouch_daemon.commands.noise import Measurement, Recording, report
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing import noise as daemon_noise
from beamtouch_daemon.processing.noise import ChannelNoise, keys_of, measure_noise, readings_needed
from beamtouch_models.pricing import noise as priced_noise

from . import configs
from .devices import SerialDevice, pymodbus_server
from .lines import Terminal, terminal
from .process import command
from .surfaces import CHANNELS, MINUTE, NOISE_MM, RATE_HZ, STEP_MM, autoregressive, counts_of, four_channels, mean_of


def of_white(window: int, alike: float) -> float:
    """Standard deviation of a mean of autoregressive noise over that of white noise: the sum of all covariances."""
    lags = np.arange(1, window)
    return math.sqrt(1 + 2 * float(np.sum((1 - lags / window) * alike**lags)))


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


NOISE_COUNTS = NOISE_MM / STEP_MM
CHANCE = random.Random(3)  # noqa: S311 - noise, not secrets


class NoisyDevice(SerialDevice):
    """A serial device whose first channel has white noise, and its second noise that stays alike."""

    def __init__(self, line: Terminal, alike: float) -> None:
        super().__init__(line)
        self._alike, self._last = alike, 0.0

    def counts(self, _sequence: int) -> tuple[int, ...]:
        self._last = self._alike * self._last + math.sqrt(1 - self._alike**2) * CHANCE.gauss()
        return round(20_000 + NOISE_COUNTS * CHANCE.gauss()), round(20_000 + NOISE_COUNTS * self._last)


async def noise(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
    now[:2] = [round(20_000 + CHANCE.gauss(sigma=NOISE_COUNTS)) for _ in range(2)]


async def step(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
    now[2] += 1
    touched = 1000 if now[2] > 300 else 0
    now[:2] = [round(20_000 + touched + CHANCE.gauss(sigma=NOISE_COUNTS)) for _ in range(2)]


def surface(name: str, source: str) -> str:
    return configs.surface(name, source).replace("window = 1", "window = 4")


@pytest.mark.anyio
async def test_noise_is_measured_on_all_surfaces_at_once_and_each_that_cannot_be_fails_alone(tmp_path: Path) -> None:
    with terminal() as line:
        NoisyDevice(line, 0.8)
        async with (
            pymodbus_server([20_000, 20_000], noise) as port,
            pymodbus_server([20_000, 20_000, 0], step) as other,
            pymodbus_server([65_535, 20_000]) as full,
        ):
            sources = {"line": configs.serial(line.path)}
            sources |= {"bus": configs.tcp(port), "touched": configs.tcp(other), "full": configs.tcp(full)}
            sources["absent"] = configs.tcp(1)
            config = configs.write(tmp_path, *(surface(*item) for item in sources.items()))
            outcome = await command("noise", config, "--seconds", "3", "--json")
    assert outcome.code == 1
    found = json.loads(outcome.out)["surfaces"]
    assert (found["line"]["filter"], found["bus"]["error"]) == ("the mean of 4 readings", None)
    white, alike = found["line"]["channels"]
    for one in (white, *found["bus"]["channels"]):
        assert one["effective_noise_mm"] == pytest.approx(NOISE_MM, rel=0.35)
    assert alike["effective_noise_mm"] == pytest.approx(NOISE_MM * of_white(4, 0.8), rel=0.4)
    # The time itself scatters by its own size in three seconds: over a minute it is held above.
    assert min(one["correlation_ms"] for one in found["line"]["channels"]) > 0
    assert found["line"]["daemon"]["noise_mm"] >= alike["effective_noise_mm"]
    assert found["line"]["scene"]["zero_drift_mm"] >= alike["effective_noise_mm"] / 5
    assert re.search("s1 moved by 0.[01][0-9]* mm after .* s; take everything off", found["touched"]["error"])
    refused = [said for said in outcome.err.splitlines() if said.startswith("beamtouch-daemon: ")]
    for said, words in zip(
        refused,
        (
            "touched: not measured: s1 moved by ",
            "full: not measured: s1 is saturated in .* readings; check the sensor",
            "absent: not measured: no connection to 127.0.0.1:1",
        ),
        strict=True,
    ):
        assert re.search(words, said)


@pytest.mark.anyio
async def test_the_printed_lines_are_keys_of_the_configuration(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 20_000], noise) as port:
        path = configs.write(tmp_path, surface("bench", configs.tcp(port)))
        outcome = await command("noise", path, "--seconds", "2.5")
        assert outcome.code == 0, outcome.err
        _, daemon, scene = re.split(r"^(?=\[)", outcome.out, flags=re.MULTILINE)
        stated = tomllib.loads(daemon)["surfaces"]["bench"]
        assert sorted(tomllib.loads(scene)["sensors"]) == ["noise_mm", "zero_drift_mm"]
        assert stated == {"noise_mm": pytest.approx(NOISE_MM, rel=0.3)}
        path.write_text(path.read_text().replace("rate_hz", f"noise_mm = {stated['noise_mm']}\nrate_hz", 1))
        assert (await command("tare", path)).code == 0


@pytest.mark.anyio
@pytest.mark.parametrize(
    ("rate_hz", "seconds", "said"),
    [
        (200.0, "2.4", "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (200.0, "nan", "--seconds: give 2.5 to 3600, as its rate and its filter require"),
        (0.1, "60", "its filter needs 5000 s of readings, and at most 3600 s are recorded"),
    ],
)
async def test_a_time_that_cannot_be_is_refused_at_once(
    tmp_path: Path, rate_hz: float, seconds: str, said: str
) -> None:
    outcome = await command("noise", configs.write(tmp_path, configs.surface(rate_hz=rate_hz)), "--seconds", seconds)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.complaint() == said
