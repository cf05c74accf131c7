"""The rest gaps: their averages, refusals, and the file."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from beamtouch_common.errors import InputError
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.at_rest import NotAtRestError, rest_gaps
from beamtouch_models.filters import FloatArray

CHANNELS = ["s1", "s2"]
NOISE_MM = 0.002


def surface_of(noise_mm: float | None = None) -> Surface:
    channels = [
        {
            "name": name,
            "register": index,
            "gain_mm_per_count": -0.0001,
            "offset_mm": 4.5,
            "rest_gap_mm": 2.5,
            "range_mm": [1.0, 4.0],
        }
        for index, name in enumerate(CHANNELS)
    ]
    source = {"kind": "modbus-tcp", "host": "127.0.0.1"}
    return Surface.model_validate({"rate_hz": 200, "source": source, "noise_mm": noise_mm, "channels": channels})


def counts(motion_mm: FloatArray, seed: int = 1) -> FloatArray:
    """Return counts of gaps of 2.4 mm and 2.6 mm with noise, the second one moving."""
    noise = NOISE_MM * np.random.default_rng(seed).standard_normal((len(motion_mm), 2))
    gap = np.array([2.4, 2.6]) + noise
    gap[:, 1] += motion_mm
    return np.round((gap - 4.5) / -0.0001)


STILL = np.zeros(200)


def test_a_surface_at_rest_gives_the_mean_gap_of_every_channel() -> None:
    gaps = rest_gaps(counts(STILL), surface_of())
    assert list(gaps) == CHANNELS
    assert gaps["s1"] == pytest.approx(2.4, abs=4 * NOISE_MM / np.sqrt(200))
    assert gaps["s2"] == pytest.approx(2.6, abs=4 * NOISE_MM / np.sqrt(200))


@pytest.mark.parametrize("readings", [50, 200])
def test_noise_alone_is_hardly_ever_taken_for_motion(readings: int) -> None:
    refused = 0
    for seed in range(500):
        try:
            rest_gaps(counts(np.zeros(readings), seed), surface_of())
        except NotAtRestError:
            refused += 1
    assert refused <= 2  # two channels at 3.5 standard deviations and a step of the ADC: under 0.05 % each


def test_an_adc_coarser_than_the_noise_is_not_motion() -> None:
    constant = np.full((200, 2), 20_000.0)
    constant[100:, 0] += 1  # one step, once
    assert rest_gaps(constant, surface_of())["s2"] == pytest.approx(2.5)


@pytest.mark.parametrize("noise_mm", [None, NOISE_MM])
@pytest.mark.parametrize(
    "motion_mm",
    [
        np.linspace(0, 5 * NOISE_MM, 200),
        np.where(np.arange(200) < 150, 0, 10 * NOISE_MM),
        5 * NOISE_MM * np.sin(np.arange(200) / 10),
    ],
    ids=["creeps", "is touched", "swings"],
)
def test_a_surface_that_moves_is_refused(noise_mm: float | None, motion_mm: FloatArray) -> None:
    with pytest.raises(NotAtRestError, match="s2 moved: standard deviation"):
        rest_gaps(counts(motion_mm), surface_of(noise_mm))


def test_fast_vibration_is_refused_when_the_noise_is_known() -> None:
    with pytest.raises(NotAtRestError, match="s2 moved"):
        rest_gaps(counts(np.tile([5 * NOISE_MM, -5 * NOISE_MM], 100)), surface_of(NOISE_MM))


def test_a_channel_that_is_not_good_is_refused() -> None:
    values = counts(STILL)
    values[7, 0] = 65_535
    with pytest.raises(NotAtRestError, match="s1 is saturated in 1 of 200 readings"):
        rest_gaps(values, surface_of())


def test_a_saved_tare_file_loads_again(tmp_path: Path) -> None:
    path = tmp_path / "bench.tare.json"
    tare_file.save(path, "bench", 200, {"s1": 2.4, "s2": 2.6})
    tare_file.save(path, "bench", 200, {"s1": 2.5, "s2": 2.7})
    assert tare_file.load(path, CHANNELS) == {"s1": 2.5, "s2": 2.7}
    assert os.listdir(tmp_path) == ["bench.tare.json"]  # noqa: PTH208  # nothing else is left behind


def test_without_a_file_nothing_is_overridden(tmp_path: Path) -> None:
    assert tare_file.load(tmp_path / "bench.tare.json", CHANNELS) == {}


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        json.dumps({"surface": "bench", "taken_at": "", "readings": 1, "rest_gap_mm": {"s1": 2.5}}),
        json.dumps({"surface": "bench", "taken_at": "", "readings": 1, "rest_gap_mm": {"s1": None, "s2": 2.5}}),
    ],
    ids=["empty", "cut off", "other channels", "no number"],
)
def test_a_tare_file_that_does_not_fit_is_refused_with_a_remedy(tmp_path: Path, content: str) -> None:
    path = tmp_path / "bench.tare.json"
    path.write_text(content)
    with pytest.raises(InputError, match="delete it or run beamtouch-daemon tare again"):
        tare_file.load(path, CHANNELS)
