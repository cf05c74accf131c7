"""The posterior graph at the extremes of noise, force and input: finite, in order, in range, right where it can be."""

import dataclasses
import itertools

import numpy as np
import pytest

from beamtouch_models.accuracy import limit
from beamtouch_models.physics.beam import travel_of
from beamtouch_models.scene import load_scene
from beamtouch_models.surface import Surface
from example_scenes import SCENES
from posterior_cases import answers_of, check_sane, graph_of, nonsense, prior_of


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    ("name", "sensors", "noise_percent"), [("bench", 2, 100.0), ("bench", 2, 1.0), ("two-spans", 5, 1e-4)]
)
def test_nonsense_gets_a_sane_answer(name: str, sensors: int, noise_percent: float, known: bool) -> None:
    prior = prior_of(name, sensors, noise_percent, known=known)
    graph, readings = graph_of(prior), nonsense(prior_of(name, sensors, noise_percent, known=known))
    for kept in (range(sensors), [0], []):
        valid = np.zeros(readings.shape, np.bool_)
        valid[:, list(kept)] = True
        check_sane(prior, answers_of(graph, prior, readings, valid))


def test_without_any_channel_the_answer_is_the_whole_range() -> None:
    prior = prior_of("bench", 3, 1.0, known=False)
    answers = answers_of(graph_of(prior), prior, np.zeros((1, 3)), np.zeros((1, 3), np.bool_))
    low, high = prior.position_mm
    assert answers["position_mm"][0] == pytest.approx((low + high) / 2, rel=1e-3)
    assert answers["position_high_mm"][0] - answers["position_low_mm"][0] >= 0.949 * (high - low)
    assert answers["contact_log_odds"][0] == pytest.approx(0, abs=1e-3)


def test_with_noise_as_large_as_the_deflection_the_posterior_is_still_right() -> None:
    prior = prior_of("bench", 3, 100.0, known=False)
    drawn = limit.draw(prior, 1500, 1)
    answers = answers_of(graph_of(prior), prior, drawn.deflection_mm)
    best = limit.posterior_median_mm(prior, drawn.deflection_mm)
    width = answers["position_high_mm"] - answers["position_low_mm"]
    assert (np.abs(answers["position_mm"] - best) < 0.07 * width).all()
    held = (answers["position_low_mm"] <= drawn.position_mm) & (drawn.position_mm <= answers["position_high_mm"])
    # The interval does not lean on the range of the force, which is all that is known here.
    assert held.mean() > 0.93


@pytest.mark.parametrize(
    ("name", "sensors", "known"),
    # Shear gives the curve a kink at each sensor.
    [("paper", 2, True), ("bench", 4, False), ("short-deep", 3, True)],
)
def test_the_limit_holds_down_to_the_noise_that_float32_carries(name: str, sensors: int, known: bool) -> None:
    prior = prior_of(name, sensors, 1e-4, known=known)
    drawn = limit.draw(prior, 1000, 5)
    answers = answers_of(graph_of(prior), prior, drawn.deflection_mm)
    best = np.abs(limit.posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm).mean()
    assert np.abs(answers["position_mm"] - drawn.position_mm).mean() / best < 1.05
    held = (answers["position_low_mm"] <= drawn.position_mm) & (drawn.position_mm <= answers["position_high_mm"])
    assert 0.93 < held.mean() < 0.995


def test_forces_over_six_decades() -> None:
    prior = dataclasses.replace(prior_of("bench", 4, 0.1, known=False), force_n=(2e-5, 20.0))
    drawn = limit.draw(prior, 1500, 3)
    # Evenly over the decades instead of over the range: most contacts are then below the noise.
    rng = np.random.default_rng(3)
    force = 10 ** rng.uniform(np.log10(2e-5), np.log10(20), len(drawn.force_n))
    clean = force[:, None] * prior.influence_at(drawn.position_mm)
    readings = clean + rng.normal(scale=prior.noise_mm, size=clean.shape)
    answers = answers_of(graph_of(prior), prior, readings)
    check_sane(prior, answers)
    best = limit.posterior_median_mm(prior, readings)
    width = answers["position_high_mm"] - answers["position_low_mm"]
    # Where nothing speaks for a contact, the position means nothing.
    seen = answers["contact_log_odds"] > 5
    assert seen.mean() > 0.2
    assert np.abs(answers["position_mm"] - best)[seen].mean() < 0.02 * width[seen].mean()


def test_counts_of_16_bits_at_the_rails_get_a_sane_answer() -> None:
    scene, _ = load_scene(SCENES / "bench.toml")
    prior = prior_of("bench", 4, 0.2, known=False)
    scene = scene.model_copy(update={"sensors": scene.sensors.model_copy(update={"adc_bits": 16})})
    sensor = Surface.of(scene).sensor
    rails = np.array(list(itertools.product((0, 1, 32768, 65534, 65535), repeat=4)))
    deflection = sensor.standoff_mm - (sensor.offset_mm + sensor.gain_mm_per_count * rails)
    assert deflection.min() < 0 < travel_of(scene).largest_mm < deflection.max()  # beyond what any contact gives
    check_sane(prior, answers_of(graph_of(prior), prior, deflection))


def test_a_load_on_the_support_is_a_beam_at_rest() -> None:
    prior = dataclasses.replace(prior_of("bench", 4, 0.1, known=False), position_mm=(0.0, 400.0))
    answers = answers_of(graph_of(prior), prior, 20 * prior.influence_at(np.array([0.0, 400.0])))
    check_sane(prior, answers)
    assert (answers["contact_log_odds"] < 1e-3).all()
