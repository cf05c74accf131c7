"""Recordings that do not show a beam at rest, and recordings that look like it but do."""

import math
import re

import numpy as np
import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.at_rest import NotAtRestError, select_rest
from beamtouch_models.filters import FloatArray

from .test_noise import CHANNELS, MINUTE, NOISE_MM, RATE_HZ, STEP_MM, autoregressive, counts_of, surface_of

TIME_S = np.arange(MINUTE) / RATE_HZ
SHAPE = np.array([0.5, 1.0, 0.8, 0.2])
"""Deflections of the channels under a load."""


def refusal(counts: FloatArray, surface: Surface | None = None, last_mm: dict[str, float] | None = None) -> str:
    with pytest.raises(NotAtRestError) as raised:
        select_rest(counts, surface or surface_of(), last_mm or {})
    return str(raised.value)


def moved_by(motion_mm: FloatArray, alike: float = 0.0) -> FloatArray:
    """Counts of a beam that moves like this (readings,) where it moves most."""
    return counts_of(NOISE_MM * autoregressive(alike) + np.outer(motion_mm, SHAPE))


REST = moved_by(np.zeros(MINUTE))


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
def test_a_beam_that_is_touched_or_moves_is_refused(motion_mm: FloatArray, said: str) -> None:
    message = refusal(moved_by(motion_mm))
    assert re.search(said, message), message
    assert message.endswith("; take everything off the beam, leave it alone and try again")


@pytest.mark.parametrize("touched_s", [30.0, 30.0125, 30.025, 30.05, 30.06, 12.337, 48.871])
def test_a_light_touch_is_refused_wherever_it_begins(touched_s: float) -> None:
    for size in (1.5, 3.8):
        message = refusal(moved_by(np.where(touched_s <= TIME_S, 2 * size * NOISE_MM, 0.0)))
        found = re.search(r"moved by (\S+) mm after (\S+) s", message)
        assert found, message
        assert float(found[1]) == pytest.approx(2 * size * NOISE_MM, rel=0.6)
        assert float(found[2]) == pytest.approx(touched_s, abs=0.5)


def test_a_load_that_lies_on_the_beam_is_refused() -> None:
    assert refusal(moved_by(np.full(MINUTE, 0.35))) == (
        "s2 -0.350 mm from its rest_gap_mm; take everything off the beam, or tare it again if its sensors were moved"
    )
    last = {f"s{index + 1}": 2.5 for index in range(CHANNELS)}
    assert "s2 -0.100 mm from the last tare" in refusal(moved_by(np.full(MINUTE, 0.1)), last_mm=last)


@pytest.mark.parametrize("alike", [0.0, 0.9, 0.99])
@pytest.mark.parametrize("window", [1, 20])
def test_noise_and_slow_drift_are_not_motion(alike: float, window: int) -> None:
    surface = surface_of({"kind": "moving-average", "window": window})
    for seed in range(10):
        drift = np.outer(5 * NOISE_MM * np.sin(2 * math.pi * TIME_S / 120), SHAPE)
        counts = counts_of(NOISE_MM * autoregressive(alike, seed=seed) + drift)
        assert len(select_rest(counts, surface, {})) == MINUTE
        for part in (500, 2000) if window == 1 else (2000,):
            assert len(select_rest(counts[:part], surface, {})) == part


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 1.0])
def test_an_adc_coarser_than_the_noise_is_neither_motion_nor_stuck(noise: float) -> None:
    for seed in range(5):
        between = np.random.default_rng(seed).uniform(size=CHANNELS) + np.linspace(0, 0.4, MINUTE)[:, np.newaxis]
        counts = np.rint(20_000 + between + noise * autoregressive(0.0, seed=seed))
        assert len(select_rest(counts, surface_of(), {})) == MINUTE


def test_single_spikes_are_not_motion() -> None:
    counts = REST.copy()
    counts[1000::997, 2] += 100 * NOISE_MM / STEP_MM
    assert len(select_rest(counts, surface_of(), {})) == MINUTE


def test_a_channel_that_does_not_change_while_others_do_is_stuck() -> None:
    counts = REST.copy()
    counts[:, 1] = 20_000
    counts[:, 3] = 20_001
    assert refusal(counts) == "s2, s4 stuck: the counts do not change; check the sensor"


def test_channels_that_never_change_are_stuck_where_the_stated_noise_would_change_them() -> None:
    still = np.full((MINUTE, CHANNELS), 20_000.0)
    stated = Surface.model_validate(surface_of().model_dump(by_alias=True) | {"noise_mm": NOISE_MM})
    assert refusal(still, stated).startswith("s1, s2, s3, s4 stuck")
    assert len(select_rest(still, surface_of(), {})) == MINUTE


def test_channels_that_are_not_good_are_named_and_a_few_bad_readings_left_out() -> None:
    counts = REST.copy()
    counts[:50, 0] = math.nan
    assert len(select_rest(counts, surface_of(), {})) == MINUTE - 50
    counts[:300, 0] = math.nan
    counts[100:400, 2] = 65_535
    message = "s1 is missing in 300 of 12000 readings, s3 is saturated in 300 of 12000 readings; check the sensor"
    assert refusal(counts) == message
