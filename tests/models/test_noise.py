"""The noise of a sample behind each filter, and the filter that a scene gets."""

import math

import numpy as np
import pytest

from beamtouch_models.design.pricing.effect import Effect
from beamtouch_models.design.pricing.noise import step_mm
from beamtouch_models.design.scene import Requirements, Scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.errors import SceneError
from beamtouch_models.runtime.metadata_parts import FilterChoice
from support.surfaces.example_scenes import paper_scene


def with_latency(scene: Scene, latency_ms: float | None) -> Scene:
    return scene.model_copy(update={"requirements": Requirements(latency_ms=latency_ms)})


def test_the_noise_of_a_reading_is_that_of_the_sensor_and_of_the_steps() -> None:
    # 2 % of 10 x 400^3 / (48 x 1.18125e7) mm.
    assert resolve(paper_scene()).readings.reading_mm == pytest.approx(0.0225749559, rel=1e-9)
    # 6 bits over 3 mm with 80 % of the scale: 3 / (0.8 x 63) mm, over sqrt(12): 0.017183; with 0.022575: 0.02837.
    assert resolve(paper_scene(adc_bits=6)).readings.reading_mm == pytest.approx(0.02837, rel=1e-4)


def test_the_filter_takes_the_latency_and_no_more() -> None:
    unfiltered = resolve(with_latency(paper_scene(), None))
    assert (unfiltered.filter.kind, unfiltered.noise.sample_mm) == ("none", unfiltered.noise.reading_mm)
    with pytest.raises(SceneError, match="shorter than one reading"):
        resolve(with_latency(paper_scene(rate_hz=100), 9.0))
    # Without noise nothing tells a change, so that the mean is of the last readings.
    silent = with_latency(paper_scene(rate_hz=200, noise_percent_of_max=None, noise_mm=0.0), 20.0)
    assert resolve(silent).filter.kind == "moving-average"
    scene = with_latency(paper_scene(rate_hz=200), 20.0)
    chosen = resolve(scene).filter
    assert (chosen.kind, chosen.window, chosen.settling_ms) == ("growing-mean", 4, 20.0)
    assert resolve(scene, chosen=chosen).noise.sample_mm == pytest.approx(
        resolve(scene).readings.reading_mm / 2, rel=1e-15
    )


@pytest.mark.parametrize(
    ("max_mean_ms", "longest"),
    [(1000.0, 200), (1.0, 4), (20.0, 4), (25.0, 5), (1e9, 10_000)],  # 200 Hz; never below the latency of 20 ms
)
def test_the_mean_grows_for_as_long_as_the_scene_says(max_mean_ms: float, longest: int) -> None:
    scene = with_latency(paper_scene(rate_hz=200), 20.0)
    requirements = scene.requirements.model_copy(update={"max_mean_ms": max_mean_ms})
    assert resolve(scene.model_copy(update={"requirements": requirements})).filter.longest == longest


STEP_MM = step_mm((1.0, 4.0), 8)


def coarse(noise_in_steps: float, **sensors: object) -> Scene:
    """The paper's scene with an ADC of 8 bits and a noise in steps of it."""
    return paper_scene(noise_percent_of_max=None, noise_mm=noise_in_steps * STEP_MM, adc_bits=8, **sensors)


def steps_of(scene: Scene, window: int = 20) -> Effect:
    (found,) = (one for one in resolve(scene, chosen=filter_of(window)).effects if one.name == "ADC steps")
    return found


def filter_of(window: int) -> FilterChoice:
    return FilterChoice(kind="moving-average", window=window)


@pytest.mark.parametrize("noise", [0.0, 0.2, 0.4])
def test_the_rounding_that_stays_is_that_of_simulated_means(noise: float) -> None:
    # Means of a thousand rounded readings, at rest and under a load, with gaps anywhere between two counts.
    rng = np.random.default_rng(6)
    gaps = rng.uniform(size=(2, 1000))
    means = np.array([np.rint(gap + noise * rng.standard_normal((1000, 1000))).mean(axis=0) - gap for gap in gaps])
    averaged_out = 2 * (noise**2 + 1 / 12) / 1000
    variance = np.var(means[0] - means[1])
    assert resolve(coarse(noise)).readings.rounding_mm ** 2 == pytest.approx(
        variance * STEP_MM**2, abs=1.1 * averaged_out * STEP_MM**2, rel=0.12
    )


def test_the_floor_of_a_tared_deflection_holds_the_drift_and_the_rounding_of_two_readings() -> None:
    for noise, rounding_mm in ((0.0, STEP_MM / math.sqrt(6)), (0.6, 0.0)):
        zero_mm = resolve(coarse(noise, zero_drift_mm=0.01)).readings.floor_mm
        assert zero_mm == pytest.approx(math.hypot(0.01, rounding_mm), rel=1e-3)


@pytest.mark.promise(
    "docs/how-to/design.md",
    "and the noise is less than half a step, no filter averages the rounding away either; the intervals include it.",
)
def test_rounding_that_stays_is_priced_and_never_left_out() -> None:
    hidden, dithered = steps_of(coarse(0.1), 1000), steps_of(coarse(0.6), 1000)
    noise_mm = resolve(coarse(0.1), chosen=filter_of(1000)).noise.sample_mm
    assert hidden.price == pytest.approx(
        math.hypot(resolve(coarse(0.1)).readings.rounding_mm, STEP_MM / math.sqrt(12_000)) / noise_mm
    )
    assert "stay in every mean" in hidden.reason
    assert dithered.price is not None
    assert dithered.price < 0.5
    assert "stay in every mean" not in dithered.reason
    fine = coarse(4.0)
    small = steps_of(fine)
    assert small.price is not None
    assert small.price < 0.1
    assert resolve(fine, chosen=filter_of(20)).readings.floor_mm == pytest.approx(0.2 * 4 * STEP_MM, rel=1e-2)
