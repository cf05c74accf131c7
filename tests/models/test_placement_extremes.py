"""Placement at the extremes of a scene: the right answer or a refusal with a reason, and never a warning."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.placing import place, place_by_position_error, recommended_count
from beamtouch_models.scene import Scene, change_scene
from example_scenes import paper_scene
from stated_problems import problem_in


def scaled_scene(length_mm: float, rigidity: float, position: tuple[float, float] = (0.0025, 0.9975)) -> Scene:
    stated = Scene.model_validate(
        {
            "beam": {"length_mm": 1.0, "flexural_rigidity_n_mm2": rigidity},
            "contact": {"force_n": 1.0, "position_mm": position},
            "sensors": {"count": 2, "noise_percent_of_max": 2, "grid_mm": 1 / 400, "size_mm": 0},
        }
    )
    # Scaled after the checks: a scene may not state beams of less than a millimetre.
    beam = stated.beam.model_copy(update={"length_mm": length_mm})
    contact = stated.contact.model_copy(update={"position_mm": (position[0] * length_mm, position[1] * length_mm)})
    sensors = stated.sensors.model_copy(update={"grid_mm": length_mm / 400})
    return stated.model_copy(update={"beam": beam, "contact": contact, "sensors": sensors})


@settings(max_examples=15)
@given(st.integers(-280, 280), st.integers(-90, 90))
def test_every_scale_has_the_same_optimum_or_is_refused(rigidity: int, length: int) -> None:
    try:
        found = place(*problem_in(scaled_scene(10.0**length, 10.0**rigidity)), 2, 0)
    except SceneError as refusal:
        assert abs(3 * length - rigidity) > 290, refusal  # noqa: PT017  # either outcome is a pass
        return
    assert np.array(found.positions_mm) / 10.0**length == pytest.approx([0.305, 0.695], rel=1e-9)
    assert found.log_eigenvalue_product == pytest.approx(-21.6047, abs=5e-5)


def test_hardly_more_than_one_load_position() -> None:
    narrow = scaled_scene(400.0, 1e7, (0.5, 0.5 + 1e-6))
    with pytest.raises(SceneError, match=r"not 3; widen contact\.position_mm"):
        place(*problem_in(narrow), 3, 0)
    one = place(*problem_in(narrow), 3, 0, leading=1)
    # A single component is the length of the deflection, so the best are the three neighbours in the middle.
    assert one.positions_mm == (199, 200, 201)


def test_a_fixed_sensor_on_a_support_measures_nothing() -> None:
    """A scene refuses it; a structure that is measured may have places that do not move."""
    influence = influence_of(paper_scene())
    rules, coarse = (Candidates(np.arange(0.0, 400.0, step), np.array([0], dtype=np.intp), 0.0) for step in (1, 40))
    for search in ("exact", "paper"):
        with pytest.raises(SceneError, match="leave no 2 positions with independent readings"):
            place(influence, rules, 2, 0, search=search)
        with pytest.raises(SceneError, match="leave no 1 positions with independent readings"):
            place(influence, rules, 1, 0, search=search)
    with pytest.raises(SceneError, match="nothing moves at 0 mm"):
        place_by_position_error(influence, coarse, 2, 0, SampleErrors(0.01))
    # It adds no component: the other two sensors stand where two sensors alone would.
    assert place(influence, rules, 3, 0, leading=2).positions_mm == (0, 122, 278)


def test_noise_larger_than_the_signal_leaves_the_prior() -> None:
    # With the range 1..399 mm alone, the best guess is its middle, with a mean error of a quarter of 398 mm.
    limit = accuracy_limit(Prior.of(influence_of(paper_scene()), np.array([122.0, 278.0]), 1e6), 1000, 0)
    assert limit.percent == pytest.approx(398 / 4 / 4, rel=1e-5)
    assert recommended_count(influence_of(paper_scene()), 1e6) == 2
    assert len(place_by_position_error(*problem_in(paper_scene(grid_mm=40)), 2, 0, SampleErrors(1e6)).positions_mm) == 2


def test_without_noise_every_component_counts() -> None:
    assert recommended_count(influence_of(paper_scene()), 0.0) == 8


@pytest.mark.parametrize(("force", "least"), [(10.0, 95), ((2.0, 20.0), 21)])
def test_the_error_at_little_noise_follows_the_expected_power_of_the_noise(force: object, least: float) -> None:
    scene = change_scene(paper_scene(), contact={"force_n": force, "position_mm": (0, 400)})
    layout = np.array([68.0, 156.0, 244.0, 332.0])
    influence = influence_of(scene)
    coarse, fine = (accuracy_limit(Prior.of(influence, layout, noise), 2000, 0).percent for noise in (1e-6, 1e-8))
    # With a known force the error is proportional to the noise. With an open force, a load at a small distance x from a
    # support changes the shape by x^3 only: x up to noise^(1/3) is hidden and costs noise^(2/3), a factor of 21.5.
    assert least < coarse / fine < 101
