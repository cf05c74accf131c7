"""The accuracy limit and the posterior that it comes from: published limits, plain integrals, closed forms."""

import dataclasses

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy import limit
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_deviation_mm, cramer_rao_error_mm
from beamtouch_models.design.accuracy.drawing import draw, draw_evenly
from beamtouch_models.design.accuracy.limit import accuracy_limit, compare_limits, limits_without
from beamtouch_models.design.accuracy.posterior import posterior_quantiles
from beamtouch_models.design.accuracy.prior import TAIL, Prior, forces_of
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.pricing.effect import Effect
from beamtouch_models.design.scene import Scene, change_scene, load_scene
from beamtouch_models.design.scene.tables import MAX_GAIN_PERCENT
from beamtouch_models.design.surface import Surface, resolve
from beamtouch_models.places import Extent, on_axis
from beamtouch_models.runtime.error_model import Errors, whitening
from models.posterior_cases import plain_posterior, prior_of, quantiles_of
from support.surfaces.example_scenes import SCENES, paper_scene


@pytest.mark.parametrize(("layout", "percent"), [((400 / 3, 800 / 3), 4.50), ((107, 293), 3.78)])
def test_the_limits_that_are_known_for_the_paper(layout: tuple[float, float], percent: float) -> None:
    noise_mm = resolve(paper_scene()).readings.reading_mm
    prior = Prior.of(influence_of(paper_scene()), on_axis(np.array(layout)), Errors(noise_mm))
    found = accuracy_limit(prior, 4000, 1)
    assert abs(found.value - percent) < 3.5 * found.standard_error + 0.005


def test_a_posterior_of_little_noise_is_exact_where_shear_makes_a_kink() -> None:
    influence = influence_of(load_scene(SCENES / "short-deep.toml")[0])
    sensor_mm, force_n = np.array([21.0, 43.0, 62.0, 87.0]), np.array([85.0])
    largest_mm = influence.force_n[1] * float(np.abs(influence.matrix(sensor_mm)).max())
    prior = Prior.of(influence, on_axis(sensor_mm), Errors(1e-6 * largest_mm))
    position_mm = sensor_mm[1:2] + 0.014  # beside a sensor, between two entries of any table
    median_mm = limit.posterior_median_mm(prior, force_n * prior.influence_at(on_axis(position_mm)))
    bound_mm = cramer_rao_deviation_mm(prior, on_axis(position_mm), np.full(len(position_mm), force_n))[:, 0]
    assert np.all(np.abs(median_mm - position_mm) < 0.1 * bound_mm)


def test_limits_that_are_compared_share_their_contacts() -> None:
    prior = prior_of("bench", 4, 0.5, known=False)
    missing = [(0,), (1, 2)]
    whole = accuracy_limit(prior, 2000, 9).value
    for lacking, one in zip(missing, limits_without(prior, missing, 256, 3), strict=True):
        alone = accuracy_limit(prior.without(*lacking), 2000, 8).value
        assert one.ratio.standard_error < 0.08 * one.ratio.value
        assert one.limit.value == pytest.approx(alone, rel=0.1)
        assert abs(one.ratio.value - alone / whole) < 4 * one.ratio.standard_error + 0.02 * one.ratio.value
    gains = [prior.with_floor(gain, 0.0) for gain in (0.0, 0.001, 0.003)]
    compared = compare_limits(prior, gains, 256, 3)
    each = [accuracy_limit(one, 256, 3).value for one in gains]
    assert [one.limit.value for one in compared] == pytest.approx(each, rel=2e-3)
    none, little, usual = (one.ratio for one in compared)
    # The same errors, and a price that is seen although it is smaller than the scatter of either limit.
    assert (none.value, none.standard_error) == (1, 0)
    assert 1 + 3 * little.standard_error < little.value < usual.value


@pytest.mark.parametrize("known", [True, False])
def test_no_estimator_beats_the_limit_under_the_largest_errors_of_gains_that_a_scene_may_state(known: bool) -> None:
    """The exact posterior: the variance of each channel follows from the contact, for every force."""
    gain = MAX_GAIN_PERCENT / 100
    prior = prior_of("bench", 4, 0.2, known=known).with_floor(gain, 0.0)
    drawn = draw_evenly(prior, 64, 1)
    grid = np.linspace(*prior.extent.range_mm, 400)
    force = np.linspace(*prior.force_n, 1 if known else 60)[:, None, None]
    mean = force * prior.influence_at(on_axis(grid))
    variance = prior.errors.noise_mm**2 + (gain * mean) ** 2
    exact = []
    for sample in drawn.deflection_mm:
        log_density = -(((sample - mean) ** 2 / variance + np.log(variance)).sum(axis=2)) / 2
        density = np.exp(log_density - log_density.max()).sum(axis=0)
        median = grid[np.searchsorted(np.cumsum(density), density.sum() / 2)]
        exact.append(float((np.abs(grid - median) * density).sum() / density.sum()))
    claimed = posterior_quantiles(prior, drawn.deflection_mm)[1]
    expected = (np.array(exact) * drawn.weight).mean()
    assert (claimed * drawn.weight).mean() == pytest.approx(expected, rel=0.01 if known else 0.03)


def correlated(channels: int, noise_mm: float) -> Floats:
    """A covariance with an excess along one direction, as a sample has just after a touch."""
    along = np.sin(np.arange(1, channels + 1))
    made: Floats = noise_mm**2 * (np.eye(channels) + 30.0 * np.outer(along, along))
    return made


@pytest.mark.parametrize("tail", [0.0, TAIL])
@pytest.mark.parametrize("known", [True, False])
def test_quantiles_are_those_of_a_plain_integral_under_any_covariance(tail: float, known: bool) -> None:
    prior = prior_of("bench", 3, 2.0, known=known)
    covariance = correlated(3, prior.errors.noise_mm)
    rng = np.random.default_rng(4)
    drawn = draw(prior, 4, 7)
    reading = drawn.deflection_mm + rng.multivariate_normal(np.zeros(3), covariance, 4)
    found, distance = posterior_quantiles(
        prior,
        reading,
        np.tile([0.025, 0.5, 0.975], (4, 1)),
        whitening_per_mm=whitening(reading, covariance, 0.003, 1e-3),
        tail=tail,
    )
    for row, one in enumerate(reading):
        total = covariance + np.diag((0.003 * one) ** 2 + 1e-6)
        grid, density = plain_posterior(prior, one, total, forces_of(prior.force_n, tail))
        expected = quantiles_of(grid, density, 0.025, 0.5, 0.975)
        width = expected[2] - expected[0]
        assert found[row] == pytest.approx(expected, abs=2e-3 * width + 0.02)
        mean = np.trapezoid(density * np.abs(grid - expected[1]), grid) / np.trapezoid(density, grid)
        assert distance[row] == pytest.approx(mean, rel=5e-3)


def test_gains_and_zeros_scatter_as_the_floor_says_and_intervals_hold_the_truth_under_them() -> None:
    bare = prior_of("bench", 4, 0.05, known=False)
    prior = bare.with_floor(0.01, bare.errors.noise_mm * np.array([0.0, 1.0, 2.0, 3.0]))
    drawn, evenly = draw(prior, 20_000, 3), draw_evenly(prior, 4096, 3)
    for one in (drawn, evenly):
        clean = one.force_n[:, None] * prior.influence_at(one.place_mm)
        deviation = np.sqrt(prior.errors.noise_mm**2 + (0.01 * clean) ** 2 + np.square(prior.errors.zero_mm))
        assert ((one.deflection_mm - clean) / deviation).std(axis=0) == pytest.approx(np.ones(4), rel=0.04)
    limits = (accuracy_limit(one, 500, 1).value for one in (bare, bare.with_floor(0.0, prior.errors.zero_mm)))
    least, drifted = limits
    assert drifted > 1.2 * least
    levels = np.tile([0.025, 0.975], (1000, 1))
    low, high = posterior_quantiles(prior, drawn.deflection_mm[:1000], levels)[0].T
    assert ((low <= drawn.position_mm[:1000]) & (drawn.position_mm[:1000] <= high)).mean() == pytest.approx(
        0.95, abs=0.03
    )


@pytest.mark.parametrize("known", [True, False])
def test_the_limit_lies_between_the_bound_and_a_guess(known: bool) -> None:
    prior = dataclasses.replace(prior_of("bench", 4, 0.003, known=known), extent=Extent.of_beam((80.0, 320.0)))
    best, bound = accuracy_limit(prior, 1000, 1), cramer_rao_error_mm(prior) / prior.diagonal_mm * 100
    assert best.value == pytest.approx(bound, abs=4 * best.standard_error + 0.02 * bound)
    # At x in 1..399 a uniform guess is off by ((x - 1)^2 + (399 - x)^2) / (2 * 398), which is 398 / 3 on average, and
    # the best one, the middle of the range, by a quarter of it.
    hidden = prior_of("bench", 2, 1e7, known=known)
    assert cramer_rao_error_mm(hidden) == pytest.approx(398 / 3, rel=1e-3)
    assert accuracy_limit(hidden, 1000, 0).value == pytest.approx(398 / 4 / 4, rel=1e-4)
    # The bound is as large as the noise, however small that makes what a newton does beside it.
    noisy = prior.at_noise(1e9 * prior.errors.noise_mm)
    bounds = (
        cramer_rao_deviation_mm(one, np.array([[100.0], [150.0], [310.0]]), np.full(3, 10.0)) for one in (noisy, prior)
    )
    assert np.divide(*bounds) == pytest.approx(1e9)
    # One channel gives no position if the force is open.
    one = dataclasses.replace(
        Prior.of(influence_of(paper_scene()), np.array([[122.0]]), Errors(0.002)), force_n=(2.0, 20.0)
    )
    assert cramer_rao_deviation_mm(one, np.array([[50.0], [200.0]]), np.full(2, 10.0)).min() > 1e6


SOFT_MIDDLE = [{"to_mm": 150, "thickness_mm": 3}, {"to_mm": 200, "thickness_mm": 2.99}, {"to_mm": 400}]


@pytest.mark.parametrize(
    ("name", "beam"), [("shear", {"shear_modulus_gpa": 80.0}), ("steps", {"segments": SOFT_MIDDLE})]
)
def test_a_barely_negligible_effect_changes_the_accuracy_by_less_than_a_percent(
    name: str, beam: dict[str, object]
) -> None:
    def with_noise(noise_mm: float) -> tuple[Scene, Surface, Effect]:
        paper = paper_scene(noise_percent_of_max=None, noise_mm=noise_mm)
        scene = change_scene(paper, beam=beam, contact={"force_n": (2.0, 20.0)})
        surface = resolve(scene)
        return scene, surface, next(effect for effect in surface.effects if effect.name == name)

    # At this noise the price is 0.095, so the effect is out; at half of the noise it is in.
    noise_mm = 0.01 * (with_noise(0.01)[2].price or 0.0) / 0.095
    (scene, surface, effect), (_, _, dearer) = with_noise(noise_mm), with_noise(noise_mm / 2)
    assert (effect.verdict, dearer.verdict) == ("out", "in")
    assert surface.beam != scene.beam
    # The same contacts with the same noise, estimated with the effect and without it.
    layout_mm = np.array([68.0, 156.0, 244.0, 332.0])
    having, lacking = (
        Prior.of(one, on_axis(layout_mm), Errors(noise_mm)) for one in (influence_of(scene), surface.influence)
    )
    drawn = draw(having, 1000, 1)
    best, without = (
        np.abs(limit.posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm).mean()
        for prior in (having, lacking)
    )
    assert abs(without / best - 1) < 0.01


@pytest.mark.parametrize(("force", "least"), [((10.0, 10.0), 95), ((2.0, 20.0), 21)])
def test_the_error_at_little_noise_follows_the_expected_power_of_the_noise(force: object, least: float) -> None:
    scene = change_scene(paper_scene(), contact={"force_n": force, "position_mm": (0, 400)})
    layout = np.array([68.0, 156.0, 244.0, 332.0])
    influence = influence_of(scene)
    coarse, fine = (
        accuracy_limit(Prior.of(influence, on_axis(layout), Errors(noise)), 2000, 0).value for noise in (1e-6, 1e-8)
    )
    # With a known force the error is proportional to the noise. With an open force, a load at a small distance x from a
    # support changes the shape by x^3 only: x up to noise^(1/3) is hidden and costs noise^(2/3), a factor of 21.5.
    assert least < coarse / fine < 101
