"""False contacts and false stretches of `unexplained`: as many as were asked for, whatever the noise and the zeros.

The benchmark false_alarms takes all masks.
"""

import numpy as np
import pytest

from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import (
    misfit_threshold,
    rate_per_sample,
    touch_thresholds,
    unexplained_thresholds,
)
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.scene import load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.session import runner
from models.false_alarms import (
    false_contacts_per_day,
    false_stretches_of_contacts_per_day,
    false_stretches_per_day,
    surface,
)
from models.posterior_cases import graph_of, prior_of
from models.rare_rest import exceeding
from support.surfaces.example_scenes import SCENES, paper_scene
from support.surfaces.stated_problems import fewest_mm, real_prior

pytestmark = pytest.mark.long


@pytest.mark.promise(
    "docs/reference/contact.md",
    "A beam at rest exceeds it as often as the scene's `false_contacts_per_day` allows.",
)
@pytest.mark.parametrize(
    ("name", "kept"), [("bench", (0, 1, 2, 3)), pytest.param("short-deep", (1,), marks=pytest.mark.soak)]
)
def test_false_contacts_come_once_a_month_wherever_zeros_lie(name: str, kept: tuple[int, ...]) -> None:
    on = surface(name)
    assert on.thresholds.false_contacts_per_day == pytest.approx(1 / 30)
    assert 0.5 < 30 * false_contacts_per_day(on, kept, 512) < 2


@pytest.mark.parametrize(
    ("name", "kept", "draws"),
    [
        ("bench", (0, 1, 2, 3), 1024),
        pytest.param("bench", (0, 1, 2, 3), 4096, marks=pytest.mark.soak),
        pytest.param("cantilever", (0, 1, 2), 4096, marks=pytest.mark.soak),
    ],
)
def test_false_stretches_come_at_most_once_a_day_at_rest_and_during_contacts(
    name: str, kept: tuple[int, ...], draws: int
) -> None:
    on = surface(name)
    assert 0.01 < false_stretches_per_day(on, kept, draws) < 1
    assert 0.03 < false_stretches_of_contacts_per_day(on, kept, draws) < 1


def test_thresholds_of_noise_alone_follow_the_chi_square_distribution() -> None:
    # Once in 2e7 samples, the squares of 1, 2 and 6 directions exceed 29.7, 33.6 and 44.9 (tables). An exact force
    # leaves one more direction than an open one.
    for channels, square in ((3, 29.7), (4, 33.6), (8, 44.9)):
        rate_hz = 0.5 / 86_400 * 2e7
        for size, checked in ((channels, 0.0), (channels - 1, 1.0)):
            # Means of very many readings are all alike.
            assert misfit_threshold(1.0, size, checked, rate_hz, readings=63) == pytest.approx(square, rel=0.03)
            # To raise three means of two readings takes twice the squares that raise one.
            assert 0.4 * square < misfit_threshold(1.0, size, checked, rate_hz, readings=2) < 0.65 * square


def test_thresholds_rise_with_readings_that_successive_means_share_and_rest_is_no_lower_than_misfit() -> None:
    prior = surface("bench").prior
    short, long = (unexplained_thresholds(prior, 100.0, readings) for readings in (4, 24))
    for few, many in zip(short, long, strict=True):
        assert np.all(np.array(few) < many)
    for rest, misfit in (short, long):
        assert np.all(np.array(rest) >= misfit)


def test_many_sensors_have_no_more_sets_than_can_be_looked_at() -> None:
    prior = Prior.of(influence_of(paper_scene()), on_axis(np.linspace(20.0, 380.0, 16)), Errors(0.001, zero_mm=0.003))
    assert len(touch_thresholds(prior, 2e-9)) == 16


def test_the_threshold_of_a_single_channel_is_the_normal_tail() -> None:
    # The rarest millionth of a normal distribution lies above 4.7534 deviations (tables); the odds are half its square.
    prior = prior_of("cantilever", 1, 2.0, known=True)
    (threshold,) = touch_thresholds(prior, 1e-6)
    assert threshold == pytest.approx(4.7534**2 / 2, abs=0.15)


@pytest.mark.parametrize("name", ["short-deep", pytest.param("two-spans", marks=pytest.mark.soak)])
def test_any_covariance_holds_the_false_contacts_that_were_asked_for(name: str) -> None:
    scene, _ = load_scene(SCENES / f"{name}.toml")
    chosen = resolve(scene).filter
    noise_mm = resolve(scene, chosen=chosen).noise.sample_mm
    layout = fewest_mm(scene, noise_mm)
    prior = real_prior(scene, layout, noise_mm)
    rate = rate_per_sample(1 / 30, scene.sensors.rate_hz, chosen.window)
    threshold = touch_thresholds(prior, rate)[-1]
    run = runner(to_bytes(graph_of(prior)))
    every, white = tuple(range(prior.channels)), np.eye(prior.channels) * noise_mm**2
    # Fewer readings in the mean, one noisy channel, and the first mode of a beam that still rings a little.
    noisy = white * np.array([1, *[25] * (prior.channels - 1)])
    mode = np.sin(np.pi * layout / prior.diagonal_mm)
    for covariance in (white * 16, noisy, white + 25 * noise_mm**2 * np.outer(mode, mode)):
        assert 0.4 < exceeding(run, prior, covariance, every, rate, threshold) < 2.5


@pytest.mark.parametrize(("sensors", "zeros"), [(2, 10.0), (6, 10.0), (8, 3.0)])
def test_zeros_that_outweigh_the_noise_give_the_false_contacts_that_were_asked_for(sensors: int, zeros: float) -> None:
    prior = prior_of("bench", sensors, 0.1, known=False)
    prior, rate = prior.with_floor(0.0, zeros * prior.errors.noise_mm), 2e-9
    thresholds, run = touch_thresholds(prior, rate), runner(to_bytes(graph_of(prior)))
    white = np.eye(sensors) * prior.errors.noise_mm**2
    assert 0.7 < exceeding(run, prior, white, tuple(range(sensors)), rate, thresholds[-1]) < 1.2
    # The threshold of a size is that of its worst set.
    assert exceeding(run, prior, white, (0, sensors - 1), rate, thresholds[1]) < 1.2


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
