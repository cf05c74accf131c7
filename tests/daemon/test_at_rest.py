"""Tares and recordings that do not show a beam at rest, and those that look like it but do."""

import math
import re

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.at_rest import (
    NotAtRestError,
    rest_gaps,
    select_rest,
)
from beamtouch_daemon.measuring.tares import describe_comparison, find_contradictions
from beamtouch_models.filters import FloatArray

from .surfaces import (
    CHANNELS,
    MINUTE,
    NOISE_MM,
    RATE_HZ,
    STEP_MM,
    autoregressive,
    counts_of,
    four_channels,
    mean_of,
    surface_of,
)

TARED = 200
"""Readings of a tare."""
TIME_S = np.arange(MINUTE) / RATE_HZ
SHAPE = np.array([0.5, 1.0, 0.8, 0.2])
"""Deflections of the channels under a load."""


def tared(motion_mm: FloatArray, seed: int = 1) -> FloatArray:
    """Return counts of two gaps of 2.5 mm with noise, the second one moving."""
    noise = NOISE_MM * np.random.default_rng(seed).standard_normal((len(motion_mm), 2))
    return counts_of(noise + np.outer(motion_mm, [0.0, 1.0]))


@pytest.mark.parametrize("readings", [50, TARED])
def test_noise_alone_is_hardly_ever_taken_for_motion_of_a_tare(readings: int) -> None:
    refused = 0
    for seed in range(200):
        try:
            rest_gaps(tared(np.zeros(readings), seed), surface_of())
        except NotAtRestError:
            refused += 1
    assert refused <= 1  # two channels at 3.5 standard deviations and a step of the ADC: under 0.05 % each
    constant = np.full((readings, 2), 20_000.0)
    constant[readings // 2 :, 0] += 1  # one step of an ADC that is coarser than the noise
    assert rest_gaps(constant, surface_of())["s2"] == pytest.approx(2.5)


CREEP = np.linspace(0, 5 * NOISE_MM, TARED)
TOUCH = np.where(np.arange(TARED) < 150, 0, 10 * NOISE_MM)
SWING = 5 * NOISE_MM * np.sin(np.arange(TARED) / 10)
VIBRATION = 5 * NOISE_MM * np.tile([1.0, -1.0], TARED // 2)
"""From one reading to the next: noise, unless that is known."""


@pytest.mark.parametrize(
    ("motion_mm", "noise_mm"),
    [(CREEP, None), (CREEP, NOISE_MM), (TOUCH, None), (SWING, None), (SWING, NOISE_MM), (VIBRATION, NOISE_MM)],
)
def test_a_tare_of_a_surface_that_moves_is_refused(motion_mm: FloatArray, noise_mm: float | None) -> None:
    with pytest.raises(NotAtRestError, match="s2 moved: standard deviation"):
        rest_gaps(tared(motion_mm), surface_of(noise_mm=noise_mm))


def refusal(counts: FloatArray, surface: Surface | None = None, last_mm: dict[str, float] | None = None) -> str:
    with pytest.raises(NotAtRestError) as raised:
        select_rest(counts, surface or four_channels(), last_mm or {})
    return str(raised.value)


def moved_by(motion_mm: FloatArray) -> FloatArray:
    """Counts of a beam that moves like this (readings,) where it moves most."""
    return counts_of(NOISE_MM * autoregressive(0.0) + np.outer(motion_mm, SHAPE))


REST = moved_by(np.zeros(MINUTE))


@pytest.mark.promise("docs/explanation/readings-to-samples.md", "a beam that is touched, rings or creeps during it")
@pytest.mark.parametrize(
    ("motion_mm", "said"),
    [
        (np.where((TIME_S > 20) & (TIME_S < 22), 0.05, 0.0), "moved by 0.0[0-9]+ mm after (20|22)"),
        (np.where(TIME_S > 30.0, 3 * NOISE_MM, 0.0), "moved by 0.00[0-9]+ mm after "),
        (5 * NOISE_MM * np.sin(2 * math.pi * 31 * TIME_S), "move together .correlation 0.9"),
        (NOISE_MM * 3 * np.sin(2 * math.pi * 7 * TIME_S), "move together .correlation 0"),
        (0.3 * TIME_S / 60, "drifted by 0.[12]"),
    ],
    ids=["touched", "left on", "rings", "swings", "creeps"],
)
def test_a_recording_of_a_beam_that_is_touched_or_moves_is_refused(motion_mm: FloatArray, said: str) -> None:
    message = refusal(moved_by(motion_mm))
    assert re.search(said, message), message
    assert message.endswith("; take everything off the beam, leave it alone and try again")


@pytest.mark.parametrize("touched_s", [30.0, 30.0125, 30.05, 12.337, 48.871])
def test_a_light_touch_is_refused_wherever_it_begins(touched_s: float) -> None:
    for size in (1.5, 3.8):
        message = refusal(moved_by(np.where(touched_s <= TIME_S, 2 * size * NOISE_MM, 0.0)))
        found = re.search(r"moved by (\S+) mm after (\S+) s", message)
        assert found, message
        assert float(found[1]) == pytest.approx(2 * size * NOISE_MM, rel=0.6)
        assert float(found[2]) == pytest.approx(touched_s, abs=0.5)


def test_a_load_that_lies_on_the_beam_is_refused() -> None:
    assert refusal(moved_by(np.full(MINUTE, 0.35))).startswith("s2 -0.350 mm from its rest_gap_mm; take everything off")
    last = {f"s{index + 1}": 2.5 for index in range(CHANNELS)}
    assert "s2 -0.100 mm from the last tare" in refusal(moved_by(np.full(MINUTE, 0.1)), last_mm=last)


@pytest.mark.parametrize(("alike", "window"), [(0.0, 20), (0.9, 1), (0.99, 20)])
def test_noise_and_slow_drift_are_not_motion(alike: float, window: int) -> None:
    surface = four_channels(mean_of(window))
    drift = np.outer(5 * NOISE_MM * np.sin(2 * math.pi * TIME_S / 120), SHAPE)
    for seed in range(5):
        counts = counts_of(NOISE_MM * autoregressive(alike, seed=seed) + drift)
        for part in (500, 2000, MINUTE) if window == 1 else (2000, MINUTE):
            assert len(select_rest(counts[:part], surface, {})) == part


@pytest.mark.parametrize("noise", [0.0, 0.1, 1.0])
def test_an_adc_coarser_than_the_noise_is_neither_motion_nor_stuck(noise: float) -> None:
    for seed in range(3):
        between = np.random.default_rng(seed).uniform(size=CHANNELS) + np.linspace(0, 0.4, MINUTE)[:, np.newaxis]
        counts = np.rint(20_000 + between + noise * autoregressive(0.0, seed=seed))
        assert len(select_rest(counts, four_channels(), {})) == MINUTE


def test_a_few_spikes_and_bad_readings_are_left_out_and_more_are_refused() -> None:
    counts = REST.copy()
    counts[1000::997, 2] += 100 * NOISE_MM / STEP_MM
    counts[:50, 0] = math.nan
    assert len(select_rest(counts, four_channels(), {})) == MINUTE - 50
    counts[:300, 0] = math.nan
    counts[100:400, 2] = 65_535
    message = "s1 is missing in 300 of 12000 readings, s3 is saturated in 300 of 12000 readings; check the sensor"
    assert refusal(counts) == message


def test_channels_that_do_not_change_are_stuck_where_others_or_the_stated_noise_would_change_them() -> None:
    counts = REST.copy()
    counts[:, 1] = 20_000
    counts[:, 3] = 20_001
    assert (
        refusal(counts)
        == "s2, s4 stuck: the counts do not change; check the sensor, or state stuck_after_ms if it works"
    )
    still = np.full((MINUTE, CHANNELS), 20_000.0)
    assert refusal(still, four_channels(noise_mm=NOISE_MM)).startswith("s1, s2, s3, s4 stuck")
    assert len(select_rest(still, four_channels(), {})) == MINUTE


TRACKED: dict[str, object] = {"noise_mm": NOISE_MM, "zero_tracking": {"drift_um_per_min": 5, "max_mm": 0.1}}
SLOPING = {"s1": 0.06, "s2": 0.075, "s3": 0.09, "s4": 0.105}
"""How a load moves four sensors [mm] that are far from it."""


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "as far as the stated drift can have come in the time since then",
    "`tare` says so, as a load that moves all sensors alike would pass, too.",
)
def test_a_load_that_moves_all_sensors_is_no_warmth_of_a_moment() -> None:
    surface = four_channels(None, **TRACKED)
    last = dict.fromkeys(SLOPING, 2.5)
    loaded = {name: 2.5 - moved for name, moved in SLOPING.items()}
    hour = 3600.0
    assert [name.split()[0] for name in find_contradictions(loaded, last, surface, since_s=60.0)] == ["s3", "s4"]
    assert find_contradictions(loaded, last, surface, since_s=hour) == []
    assert "taken for warmth: a load that moves all sensors about alike would pass, too" in describe_comparison(
        loaded, last, surface, hour
    )
    assert "warmth" not in describe_comparison(last, last, surface, hour)


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "Two channels that have each other's rest gaps are named as swapped.",
)
@pytest.mark.promise(
    "docs/how-to/spare-part.md",
    "If two channels have each other's rest gaps, `tare` says that their cables are swapped.",
)
def test_cables_that_were_swapped_since_the_last_tare_are_named() -> None:
    surface = four_channels()
    last = {"s1": 2.5, "s2": 2.2, "s3": 2.6, "s4": 2.5}
    now = last | {"s2": 2.6, "s3": 2.2}
    assert find_contradictions(now, last, surface)[-1] == (
        "s2 and s3 have each other's rest gaps, so their cables seem to be swapped"
    )
    assert len(find_contradictions(last | {"s2": 2.6}, last, surface)) == 1
    assert len(find_contradictions(last | {"s2": 2.5, "s3": 2.9}, last, surface)) == 2
