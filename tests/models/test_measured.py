"""What is measured of an estimator: the thresholds of touch, the accuracy, the golden answers."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.accuracy.thresholds import (
    directions,
    noise_at_rest,
    rate_per_sample,
    shapes_at_rest,
    smallest_force_n,
    touch_threshold,
    touch_thresholds,
)
from beamtouch_models.building.measure import Measured, measure, thresholds_of
from beamtouch_models.building.sensors import place_sensors
from beamtouch_models.estimators.estimator import estimator_of
from beamtouch_models.estimators.onnx_graph import to_bytes
from beamtouch_models.placement.placing import DEFAULT_AIM
from beamtouch_models.scene import change_scene, load_scene
from beamtouch_models.session import runner
from beamtouch_models.surface import Surface
from beamtouch_models.sweeps import silent
from example_scenes import SCENES
from few_draws import short_work
from posterior_cases import answers_of, exceeding, graph_of, prior_of
from stated_problems import fewest_mm, real_prior


@pytest.mark.parametrize(("sensors", "rate"), [(2, 1e-2), pytest.param(5, 1e-3, marks=pytest.mark.soak)])
def test_samples_at_rest_exceed_the_threshold_at_the_stated_rate(sensors: int, rate: float) -> None:
    prior = prior_of("bench", sensors, 1.0, known=False)
    threshold = touch_thresholds(prior, rate)[-1]
    draws = 100_000
    rest = np.random.default_rng(9).normal(scale=prior.noise_mm, size=(draws, sensors))
    found = (answers_of(graph_of(prior), prior, rest)["contact_log_odds"] > threshold).mean()
    assert found == pytest.approx(rate, abs=4 * (rate / draws) ** 0.5 + 0.1 * rate)


def test_the_threshold_of_a_single_channel_is_the_normal_tail() -> None:
    # The rarest millionth of a normal distribution lies above 4.7534 deviations (tables); the odds are half its square.
    prior = prior_of("cantilever", 1, 2.0, known=True)
    (threshold,) = touch_thresholds(prior, 1e-6)
    assert threshold == pytest.approx(4.7534**2 / 2, abs=0.15)


@pytest.mark.parametrize("name", ["short-deep", pytest.param("two-spans", marks=pytest.mark.soak)])
def test_any_covariance_holds_the_false_contacts_that_were_asked_for(name: str) -> None:
    scene, _ = load_scene(SCENES / f"{name}.toml")
    chosen = Surface.of(scene).filter
    noise_mm = Surface.of(scene, chosen).noise.sample_mm
    layout = fewest_mm(scene, noise_mm)
    prior = real_prior(scene, layout, noise_mm)
    rate = rate_per_sample(1 / 30, scene.sensors.rate_hz, chosen.window)
    threshold = touch_thresholds(prior, rate)[-1]
    run = runner(to_bytes(graph_of(prior)))
    every, white = tuple(range(prior.channels)), np.eye(prior.channels) * noise_mm**2
    # Fewer readings in the mean, one noisy channel, and the first mode of a beam that still rings a little.
    noisy = white * np.array([1, *[25] * (prior.channels - 1)])
    mode = np.sin(np.pi * layout / prior.length_mm)
    for covariance in (white * 16, noisy, white + 25 * noise_mm**2 * np.outer(mode, mode)):
        assert 0.4 < exceeding(run, prior, covariance, every, rate, threshold) < 2.5


@pytest.mark.parametrize(("sensors", "zeros"), [(2, 10.0), (6, 10.0), (8, 3.0)])
def test_zeros_that_outweigh_the_noise_give_the_false_contacts_that_were_asked_for(sensors: int, zeros: float) -> None:
    prior = prior_of("bench", sensors, 0.1, known=False)
    prior, rate = replace(prior, zero_mm=zeros * prior.noise_mm), 2e-9
    thresholds, run = touch_thresholds(prior, rate), runner(to_bytes(graph_of(prior)))
    white = np.eye(sensors) * prior.noise_mm**2
    assert 0.7 < exceeding(run, prior, white, tuple(range(sensors)), rate, thresholds[-1]) < 1.2
    # The threshold of a size is that of its worst set.
    assert exceeding(run, prior, white, (0, sensors - 1), rate, thresholds[1]) < 1.2


@pytest.mark.long
def test_no_set_of_channels_has_a_threshold_above_that_of_its_size() -> None:
    prior = prior_of("cantilever", 6, 0.1, known=False)
    prior, rate = replace(prior, zero_mm=3 * prior.noise_mm), 2e-9
    thresholds, whole, noise = touch_thresholds(prior, rate), shapes_at_rest(prior), noise_at_rest(prior)
    for size, threshold in enumerate(thresholds, start=1):
        each = [
            touch_threshold(directions(whole[:, kept]), noise[list(kept)], rate)
            for kept in combinations(range(prior.channels), size)
        ]
        assert threshold == pytest.approx(max(each), abs=1e-3)
    # As many sensors as a scene may have are no more sets than can be looked at.
    assert len(touch_thresholds(prior_of("bench", 24, 0.1, known=False), rate)) == 24


def test_overlapping_windows_cluster_their_false_contacts() -> None:
    # By simulation of a moving average that exceeds three deviations: clusters, over samples that exceed.
    rng = np.random.default_rng(0)
    for window in (1, 20):
        mean = np.convolve(rng.normal(size=1_000_000), np.ones(window) / window**0.5, "valid")
        above = mean > 3.0
        starts = np.flatnonzero(above[1:] & ~above[:-1])
        # Excursions of one window are one contact.
        clusters = 1 + (np.diff(starts) > window).sum()
        per_day = clusters / len(mean) * 86_400
        assert rate_per_sample(per_day, 1.0, window) == pytest.approx(above.mean(), rel=0.35)


def test_the_smallest_force_is_seen_in_19_of_20_samples() -> None:
    prior = prior_of("bench", 3, 1.0, known=False)
    threshold = touch_thresholds(prior, 1e-8)[-1]
    position = np.array([60.0, 200.0, 350.0])
    force = smallest_force_n(prior, threshold, position)
    rng = np.random.default_rng(2)
    clean = np.repeat(force[:, None] * prior.influence_at(position), 4000, axis=0)
    odds = answers_of(graph_of(prior), prior, clean + rng.normal(scale=prior.noise_mm, size=clean.shape))
    seen = (odds["contact_log_odds"] > threshold).reshape(3, 4000).mean(axis=1)
    assert seen == pytest.approx([0.95] * 3, abs=0.02)


def test_fewer_false_contacts_cost_a_little_force() -> None:
    scene, _ = load_scene(SCENES / "bench.toml")
    prior = prior_of("bench", 3, 0.1, known=False)
    monthly, daily = (
        thresholds_of(prior, Surface.of(change_scene(scene, requirements={"false_contacts_per_day": per_day})))
        for per_day in (1 / 30, 1.0)
    )
    # The odds of rest fall by e for each unit of the log odds, nearly.
    assert monthly.touch[-1] - daily.touch[-1] == pytest.approx(np.log(30), rel=0.1)
    weakest = [smallest_force_n(prior, one.touch[-1], np.array([200.0]))[0] for one in (monthly, daily)]
    assert 1 < weakest[0] / weakest[1] < 1.2


def measured(draws: AbstractContextManager[None], times: int) -> list[Measured]:
    """Measure a model of two perfect sensors on the bench several times."""
    scene, _ = load_scene(SCENES / "bench.toml")
    sensors = place_sensors(Surface.of(scene), kept_mm=(100.0, 300.0))
    prior = replace(sensors.prior, noise_mm=0.0226, gain=0.0, zero_mm=0.0)  # 1 % of the largest deflection
    made = estimator_of("posterior", prior, min_noise_mm=prior.noise_mm, with_force=True, seed=4, progress=silent)
    with draws:
        return [measure(made, prior, sensors.surface, sensors.world, 4, DEFAULT_AIM) for _ in range(times)]


def test_the_same_seed_measures_the_same() -> None:
    once, again = measured(short_work(), 2)
    assert once == again
    assert once.accuracy.ratio == pytest.approx(1, abs=0.03)
    assert once.golden.answers["force_n"][0] > 0


@pytest.mark.soak
def test_a_build_measures_the_accuracy_within_a_hundredth() -> None:
    (found,) = measured(nullcontext(), 1)
    assert found.accuracy.ratio == pytest.approx(1, abs=0.01)
    # Four thousand plain contacts leave 1.2 % at best.
    assert 0 < found.accuracy.limit_standard_error < 0.01 * found.accuracy.limit_percent
    assert 0 < found.accuracy.error_standard_error < 0.01 * found.accuracy.error_percent
    assert 0 < found.accuracy.ratio_standard_error < 0.001
