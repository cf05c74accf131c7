"""Rules for the sensors that a layout may break."""

import numpy as np
import pytest

from beamtouch_models import change_scene
from beamtouch_models.design.physics.beam import check_small_angles, influence_of
from beamtouch_models.design.physics.influence_function import travel_of
from beamtouch_models.design.scene import Scene, parse_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.errors import SceneError
from support.surfaces.example_scenes import SCENES, paper_scene


def test_sensors_that_could_change_places_are_refused() -> None:
    surface = resolve(paper_scene(mounting_tolerance_mm=30.0))
    surface.check_spacing(np.array([[100.0], [131.0], [300.0]]))
    surface.check_spacing(np.array([[100.0]]))
    with pytest.raises(SceneError, match="mounting_tolerance_mm = 30: two of the sensors are 30 mm apart"):
        surface.check_spacing(np.array([[300.0], [100.0], [130.0]]))


def bench(force_n: float, sensors: str = "") -> Scene:
    text = (SCENES / "bench.toml").read_text()
    return parse_scene(
        text.replace("[2.0, 20.0]", f"[0.1, {force_n}]").replace("count = 4", f"count = 4\n{sensors}"), "bench.toml"
    )


def stiffened(scene: Scene, times: float) -> Scene:
    assert scene.beam.thickness_mm is not None
    return change_scene(scene, beam={"thickness_mm": scene.beam.thickness_mm * times ** (1 / 3)})


@pytest.mark.promise(
    "docs/how-to/design.md",
    "The line names the largest force that the beam may bear, and how stiff it would have to be",
)
@pytest.mark.parametrize(
    ("force_n", "said", "stiffer"),
    [
        (30, r"travels 3.386 mm and leaves sensors.range_mm = \[1, 4\]; end .* at 26 N", 1.2),
        (300, r"slopes by .* and travels 33.86 mm, .* end contact.force_n at 26 N, .* 12 ", 12),
    ],
)
def test_the_force_and_the_stiffness_that_a_refusal_names_keep_the_beam_within_the_range_of_the_sensors(
    force_n: float, said: str, stiffer: float
) -> None:
    with pytest.raises(SceneError, match=said):
        resolve(bench(force_n)).check()
    resolve(bench(26)).check()
    resolve(stiffened(bench(force_n), stiffer)).check()
    with pytest.raises(SceneError, match="leaves"):
        resolve(bench(27)).check()


def test_the_stand_off_that_a_refusal_names_is_in_the_middle() -> None:
    # docs/mistakes.md has the refusal.
    assert resolve(bench(20, "standoff_mm = 3.629")).sensor.standoff_mm == 3.629
    assert resolve(bench(20)).sensor.standoff_mm == pytest.approx(3.629, abs=5e-4)


@pytest.mark.promise("docs/how-to/design.md", "A scene is refused if the beam slopes by more than 0.1 rad")
def test_the_force_that_a_refusal_names_keeps_to_small_angles() -> None:
    with pytest.raises(SceneError, match=r"at 300 N the beam slopes by 0.261 rad.* end contact.force_n at 110 N"):
        check_small_angles(travel_of(influence_of(bench(300))))
    check_small_angles(travel_of(influence_of(bench(110))))
    check_small_angles(travel_of(influence_of(stiffened(bench(300), 2.7))))
    with pytest.raises(SceneError, match="slopes"):
        check_small_angles(travel_of(influence_of(bench(120))))
