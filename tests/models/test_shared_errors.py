"""Errors that sensors of a measured structure share: how they are told, and posteriors under them, written out in full.

The structure is a string of 400 mm, and a plate of stiff springs under a soft skin; what a table of them leaves open is
a tenth of the influence, most of it from two sources.
"""

import numpy as np
import pytest
from scipy import stats

from beamtouch_models import InfluenceFunction
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.cell_posterior import summarize
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.posterior import posterior_quantiles
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.design.physics.influence_function import Interpolation
from beamtouch_models.design.physics.shared_errors import loadings_of
from beamtouch_models.design.physics.smooth_fit import SmoothFit
from beamtouch_models.places import grid_of
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.session import runner, stated_mm

LOADINGS = np.array([[0.9, 0.2], [0.8, -0.5], [0.9, 0.3], [0.7, 0.6], [0.8, -0.4]])
LEFT_OPEN, NOISE_MM, FORCE_N = 0.1, 0.002, 10.0
LENGTH_MM, TENSION_N = 400.0, 100.0
SENSORS_MM = {
    1: np.array([[40.0], [120.0], [200.0], [290.0], [370.0]]),
    2: np.array([[5.0, 5.0], [25.0, 4.0], [15.0, 16.0], [4.0, 15.0], [26.0, 14.0]]),
}
PLACES = {1: np.linspace(10, 390, 1521)[:, None], 2: grid_of([np.linspace(2, 28, 105), np.linspace(2, 18, 65)])}


def correlation_of(loadings: Floats) -> Floats:
    correlation: Floats = loadings @ loadings.T
    np.fill_diagonal(correlation, 1.0)
    return correlation


CORRELATION = correlation_of(LOADINGS)


def moved_by(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return how far a string moves per newton; on two axes, how far a skin moves, which falls with the distance."""
    if load_mm.shape[1] == 1:
        left, right = np.minimum(load_mm, sensor_mm.T), LENGTH_MM - np.maximum(load_mm, sensor_mm.T)
        return np.asarray(left * right / (LENGTH_MM * TENSION_N))
    apart = load_mm[:, None] - sensor_mm
    return np.asarray(0.5 / np.sqrt((apart**2).sum(axis=2) + 25.0))


def prior_of(axes: int, loadings: Floats | None) -> Prior:
    """Return the prior of contacts of one force."""

    def at(sensor_mm: Floats, load_mm: Floats) -> Floats:
        return moved_by(sensor_mm.reshape(-1, axes), load_mm.reshape(-1, axes))

    sensor_mm = SENSORS_MM[axes]
    known = Interpolation(
        lambda sensor_mm, load_mm: LEFT_OPEN * at(sensor_mm, load_mm),
        10.0,
        shared_at=None if loadings is None else lambda _: loadings,
    )
    size_mm = LENGTH_MM if axes == 1 else (30.0, 20.0)
    loads = np.linspace(10, 390, 381) if axes == 1 else grid_of([np.linspace(2, 28, 27), np.linspace(2, 18, 17)])
    influence = InfluenceFunction(size_mm, loads, (FORCE_N, FORCE_N), at, interpolation=known)
    return Prior.of(influence, sensor_mm, Errors(NOISE_MM))


def exact_mm(axes: int, samples: Floats) -> tuple[Floats, Floats]:
    """Return medians (samples, axes) of exact posteriors, and the mean distances of their places from them."""
    places, medians, distances = PLACES[axes], [], []
    shown = FORCE_N * moved_by(SENSORS_MM[axes], places)
    open_mm = LEFT_OPEN * shown
    densities = [
        stats.multivariate_normal(one, np.diag(np.full(5, NOISE_MM**2)) + np.outer(left, left) * CORRELATION)
        for one, left in zip(shown, open_mm, strict=True)
    ]
    for logs in np.array([density.logpdf(samples) for density in densities]).T:
        mass = np.exp(logs - logs.max())
        mass /= mass.sum()
        median = []
        for along in places.T:
            ticks, index = np.unique(along, return_inverse=True)
            below = np.cumsum(np.bincount(index, mass))
            median.append(float(np.interp(0.5, below, ticks + (ticks[1] - ticks[0]) / 2)))
        medians.append(median)
        distances.append(float(mass @ np.linalg.norm(places - median, axis=1)))
    return np.array(medians), np.array(distances)


@pytest.mark.parametrize("axes", [1, 2])
def test_places_and_their_limit_are_those_of_the_whole_covariance(axes: int) -> None:
    prior = prior_of(axes, LOADINGS)
    drawn = draw(prior, 60, 3)
    median_mm, distance_mm = exact_mm(axes, drawn.deflection_mm)
    if axes == 1:
        quantiles, least_mm = posterior_quantiles(prior, drawn.deflection_mm)
        assert np.abs(quantiles - median_mm).max() < 0.1 * distance_mm.max()
    else:
        least_mm = summarize(prior, drawn.deflection_mm).distance_mm
    assert least_mm.mean() == pytest.approx(distance_mm.mean(), rel=0.02)
    weights = prior.errors.whitening(drawn.deflection_mm)
    told_mm, worse_mm = (
        stated_mm(runner(to_bytes(posterior_graph(one, with_force=False)))(drawn.deflection_mm, weights), one.axes)
        for one in (prior, prior_of(axes, None))
    )
    off_mm, exact_off_mm = (np.linalg.norm(place - drawn.place_mm, axis=1).mean() for place in (told_mm, median_mm))
    assert off_mm < 1.03 * exact_off_mm
    # Sensors that are taken as independent find the same contacts worse.
    assert np.linalg.norm(worse_mm - drawn.place_mm, axis=1).mean() > 1.2 * off_mm


def test_a_simulated_sample_errs_as_the_sources_say() -> None:
    prior, count = prior_of(1, LOADINGS), 20_000
    place, force = np.full((count, 1), 150.0), np.full(count, FORCE_N)
    shown = FORCE_N * moved_by(SENSORS_MM[1], place[:1])[0]
    samples = prior.draw(place, force, np.random.default_rng(4))
    wanted = np.outer(shown, shown) * LEFT_OPEN**2 * CORRELATION + NOISE_MM**2 * np.eye(5)
    assert np.abs(np.cov(samples.T) / wanted - 1).max() < 0.08


def test_what_sensors_share_is_told_from_a_correlation() -> None:
    assert correlation_of(loadings_of(CORRELATION)) == pytest.approx(CORRELATION, abs=0.01)
    assert loadings_of(np.eye(7)).shape == (7, 0)
    assert loadings_of(np.eye(1)).shape == (1, 0)
    alike = loadings_of(np.ones((3, 3)))
    shared = (alike**2).sum(axis=1)
    assert np.all((shared > 0.9) & (shared < 1))


def test_a_fit_tells_the_correlation_of_its_sensors() -> None:
    rng = np.random.default_rng(6)
    place = np.linspace(0, 300, 60)[:, None]
    covariance = np.exp(-np.abs(place - place.T) / 40) + 0.01 * np.eye(60)
    wanted = CORRELATION[:3, :3]
    mixed = np.linalg.cholesky(covariance) @ rng.normal(size=(60, 3)) @ np.linalg.cholesky(wanted).T
    fit = SmoothFit.of(place, mixed * [1.0, 2.0, 0.5], np.ones(60))
    assert np.abs(fit.correlation - wanted).max() < 0.25
