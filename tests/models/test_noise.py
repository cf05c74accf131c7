import pytest

from beamtouch_models.errors import SceneError
from beamtouch_models.pricing.noise import choose_filter, noise_of, reading_noise_mm
from beamtouch_models.scene import Requirements, Scene
from example_scenes import paper_scene


def with_latency(scene: Scene, latency_ms: float | None) -> Scene:
    return scene.model_copy(update={"requirements": Requirements(latency_ms=latency_ms)})


def test_percent_of_the_largest_deflection() -> None:
    # 2 % of 10 x 400^3 / (48 x 1.18125e7) mm.
    assert reading_noise_mm(paper_scene()) == pytest.approx(0.0225749559, rel=1e-9)


def test_the_steps_of_the_adc_add_their_share() -> None:
    # 6 bits over 3 mm with 80 % of the scale: 3 / (0.8 x 63) mm, over sqrt(12): 0.017183; with 0.022575: 0.02837.
    assert reading_noise_mm(paper_scene(adc_bits=6)) == pytest.approx(0.02837, rel=1e-4)


def test_without_latency_a_sample_is_a_reading() -> None:
    chosen = choose_filter(with_latency(paper_scene(), None))
    assert chosen.kind == "none"
    noise = noise_of(paper_scene(), chosen)
    assert noise.sample_mm == noise.reading_mm


def test_the_filter_takes_the_latency_and_no_more() -> None:
    scene = with_latency(paper_scene(rate_hz=200), 20.0)
    chosen = choose_filter(scene)
    assert (chosen.kind, chosen.window, chosen.settling_ms) == ("moving-average", 4, 20.0)
    assert noise_of(scene, chosen).sample_mm == pytest.approx(reading_noise_mm(scene) / 2, rel=1e-15)


def test_a_latency_shorter_than_one_reading_is_refused() -> None:
    with pytest.raises(SceneError, match="shorter than one reading"):
        choose_filter(with_latency(paper_scene(rate_hz=100), 9.0))
