"""Noise from recorded loads, whose samples may have come out of a filter."""

from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.building.recorded_noise import independent_variance
from beamtouch_models.design.building.scene_of_loads import scene_of_loads


@pytest.mark.parametrize("samples", [8, 50])
def test_independent_samples_are_as_noisy_as_they_scatter(samples: int) -> None:
    rng = np.random.default_rng(1)
    trials = np.array([independent_variance(list(3 + rng.normal(size=(60, samples)))) for _ in range(200)])
    assert np.mean(trials[:, 1] > trials[:, 0]) <= 0.01
    assert np.allclose(trials.mean(axis=0), 1.0, rtol=0.02)


@pytest.mark.parametrize("averaged", [3, 5, 10])
def test_samples_of_a_filter_are_taken_for_the_readings_that_it_had(averaged: int) -> None:
    """Each sample is the mean of some readings, most of which the one before had, too."""
    readings = 0.7 * np.random.default_rng(2).normal(size=(80, 100 + averaged))
    samples = [np.convolve(one, np.full(averaged, 1 / averaged), "valid") for one in readings]
    scatter, variance = np.sqrt(independent_variance(samples))
    assert scatter < 1.05 * 0.7 / np.sqrt(averaged)
    assert 0.8 < variance / 0.7 < 1.15


def test_a_sample_that_is_sent_four_times_counts_once() -> None:
    readings = np.random.default_rng(3).normal(size=(60, 20))
    scatter, variance = independent_variance([np.repeat(one, 4) for one in readings])
    assert scatter < 1.05
    assert 3.3 < variance < 4.7


def test_a_table_with_a_greek_mu_and_blanks_in_its_columns_has_the_same_noise(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    head = "load,position_mm ,force_n, g1_deflection_UNIT, g2_deflection_UNIT"
    rows = [
        f"{load},{place},5,{10 + load + rng.normal()},{40 - load + rng.normal()}"
        for load, place in enumerate(range(10, 400, 40), start=1)
        for _ in range(8)
    ]
    noise = []
    for unit in ("uV/V", "\u00b5V/V", "\u03bcV/V"):
        path = tmp_path / "loads.csv"
        path.write_text("\n".join([head.replace("UNIT", unit), *rows]), encoding="utf-8")
        scene = scene_of_loads(path)
        assert scene.unit == "uV/V"
        noise.append(scene.sensors.noise_mm)
    assert noise == [pytest.approx(1.0, rel=0.2)] * 3
