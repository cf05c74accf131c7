"""The simulated surface of `design-sensors challenge`."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.challenge import motion, sensor_cases
from beamtouch_models.challenge.play import drawn
from beamtouch_models.challenge.power import distances
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.metadata import Calibration, Departures
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.surface import prior_of_model


def test_what_sensors_measure(surface: SimulatedSurface) -> None:
    draws, random = 400, np.random.default_rng(5)
    position, force = drawn(surface, draws, random)
    clean = np.repeat(surface.under(position, force)[:, None], 60, axis=1)
    exact = surface.perfect(draws)
    noise = surface.readings(clean, exact, random) - clean
    stated_mm = surface.metadata.noise.reading_mm
    assert noise.std() == pytest.approx(stated_mm, rel=0.01)
    assert abs(np.mean(noise[:, 1:] * noise[:, :-1])) < 0.02 * stated_mm**2
    coloured = surface.readings(clean, replace(exact, correlation=0.7), random) - clean
    assert coloured.std() == pytest.approx(stated_mm, rel=0.02)
    assert coloured[:, 0].std() == pytest.approx(stated_mm, rel=0.05)
    assert np.mean(coloured[:, 1:] * coloured[:, :-1]) == pytest.approx(0.7 * stated_mm**2, rel=0.05)
    coarse = surface.readings(clean, replace(exact, step_mm=0.05), random)
    assert len(np.unique(np.round(coarse, 9))) < 60
    assert np.abs(coarse - clean).max() < 0.025 + 7 * stated_mm
    gone = np.zeros((draws, 4), np.bool_)
    gone[:, 2] = True
    assert (np.isnan(surface.readings(clean, replace(exact, missing=gone), random)).all(axis=1) == gone).all()
    beyond = surface.readings(3 * clean, exact, random)
    gap = surface.metadata.sensor.standoff_mm - 3 * clean
    assert (np.isnan(beyond) == (gap < 1.0)).mean() > 0.99
    errors = surface.honest(draws, random)
    measured = surface.measured(clean, errors)[:, 0]
    apart = (measured - clean[:, 0]).std(axis=0)
    expected = np.sqrt((0.003 * clean[:, 0]) ** 2 + 0.001**2)
    np.testing.assert_allclose(apart, np.sqrt((expected**2).mean(axis=0)), rtol=0.15)


def test_the_noise_of_a_mean_of_alike_readings() -> None:
    # By hand: of four readings, three pairs are one apart, two are two apart and one is three apart.
    by_hand = (4 + 2 * (3 * 0.7 + 2 * 0.49 + 0.343)) / 4
    assert sensor_cases.coloured_times(0.7, 4) == pytest.approx(np.sqrt(by_hand))
    assert sensor_cases.coloured_times(0.7, 1) == 1
    # A mean of very many readings: the sum of all correlations, (1 + r) / (1 - r).
    assert sensor_cases.coloured_times(0.7, 100_000) == pytest.approx(np.sqrt(1.7 / 0.3), rel=1e-4)


def test_a_tare_takes_out_what_the_sensors_show_at_rest(surface: SimulatedSurface) -> None:
    errors = surface.perfect(3)
    away_mm = np.array([0.1, 0.0, -0.2, 0.3]) * np.ones((3, 1))
    rest = replace(errors, zero_mm=away_mm, tare_mm=away_mm)
    clean = np.full((3, 50, 4), 0.4)
    plain, tared = (surface.readings(clean, one, np.random.default_rng(2)) for one in (errors, rest))
    np.testing.assert_allclose(plain, tared, atol=1e-4)  # a count is 0.06 um


def test_a_slow_load_is_where_it_is_at_rest_and_a_fast_one_swings_around_it(surface: SimulatedSurface) -> None:
    def away_mm(speed_mm_per_s: float) -> float:
        play = motion.moves(surface, 20, np.random.default_rng(6), speed_mm_per_s=speed_mm_per_s)
        # The force is the same at all times, so the deflection of the first reading tells it.
        shape = surface.influence(play.truth_mm)
        force = np.linalg.norm(play.deflection_mm[:, :1], axis=2) / np.linalg.norm(shape[:, :1], axis=2)
        return float(np.abs(play.deflection_mm - shape * force[:, :, None]).max())

    assert away_mm(10.0) < 0.002
    assert 0.01 < away_mm(1000.0) < 0.1


def test_a_calibrated_surface_measures_what_its_model_expects(bench: ModelFile) -> None:
    departures = Departures(
        position_offset_mm=[1.0, -2.0, 0.5, 0.0], gain=[1.02, 0.97, 1.0, 1.01], offset_mm=[0.1, 0.0, -0.05, 0.02],
        curve_per_mm=0.02, rigidity=1.1,
    )  # fmt: skip
    calibration = Calibration(
        departures=departures, fitted=["gain"], loads=9, residual_mm=0.0, error_before_mm=9.0, error_after_mm=1.0
    )
    metadata = bench.metadata.model_copy(update={"calibration": calibration})
    calibrated = SimulatedSurface.of(metadata)
    moved_mm = calibrated.sensor_mm - SimulatedSurface.of(bench.metadata).sensor_mm
    np.testing.assert_allclose(moved_mm, [1.0, -2.0, 0.5, 0.0])
    prior = prior_of_model(metadata)
    position, force = drawn(calibrated, 20, np.random.default_rng(10))
    clean = calibrated.under(position, force)
    measured = calibrated.measured(clean[:, None], calibrated.perfect(20))[:, 0]
    np.testing.assert_allclose(measured, prior.measured(force[:, None] * prior.influence_at(position)), rtol=1e-5)
    assert distances(calibrated, measured, np.ones(measured.shape, np.bool_)).max() < 0.05
    assert distances(calibrated, clean, np.ones(measured.shape, np.bool_)).min() > 1
