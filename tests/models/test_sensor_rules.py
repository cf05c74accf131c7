"""Rules for the sensors that a layout may break."""

import pytest

from beamtouch_models.building.sensor_rules import check_spacing, sensor_of
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import check_small_angles
from beamtouch_models.rounding import at_most
from beamtouch_models.scene import Scene, parse_scene
from example_scenes import SCENES, paper_scene


def test_sensors_that_could_change_places_are_refused() -> None:
    scene = paper_scene(mounting_tolerance_mm=30.0)
    check_spacing(scene, [100.0, 131.0, 300.0])
    check_spacing(scene, [100.0])
    with pytest.raises(SceneError, match="mounting_tolerance_mm = 30: two of the sensors are 30 mm apart"):
        check_spacing(scene, [300.0, 100.0, 130.0])


def bench(force_n: float, sensors: str = "") -> Scene:
    text = (SCENES / "bench.toml").read_text()
    return parse_scene(
        text.replace("[2.0, 20.0]", f"[0.1, {force_n}]").replace("count = 4", f"count = 4\n{sensors}"), "bench.toml"
    )


def test_the_force_that_a_refusal_names_keeps_the_beam_within_the_range_of_the_sensors() -> None:
    with pytest.raises(SceneError, match=r"travels 3.386 mm and leaves sensors.range_mm = \[1, 4\]; end .* at 26 N"):
        sensor_of(bench(30))
    sensor_of(bench(26))
    with pytest.raises(SceneError, match="leaves"):
        sensor_of(bench(27))


def test_the_stand_off_that_a_refusal_names_is_in_the_middle() -> None:
    with pytest.raises(SceneError, match=r"from sensors.standoff_mm = 1.2 the beam .* write standoff_mm = 3.629"):
        sensor_of(bench(20, "standoff_mm = 1.2"))
    assert sensor_of(bench(20, "standoff_mm = 3.629")).standoff_mm == 3.629
    assert sensor_of(bench(20)).standoff_mm == pytest.approx(3.629, abs=5e-4)


def test_the_force_that_a_refusal_names_keeps_to_small_angles() -> None:
    with pytest.raises(SceneError, match=r"at 300 N the beam slopes by 0.261 rad.* end contact.force_n at 110 N"):
        check_small_angles(bench(300))
    check_small_angles(bench(110))
    with pytest.raises(SceneError, match="slopes"):
        check_small_angles(bench(120))


@pytest.mark.parametrize(("value", "rounded"), [(26.99, 26), (110.4, 110), (0.0199, 0.019), (3.0, 3), (1e-320, 0)])
def test_a_largest_number_is_never_rounded_up(value: float, rounded: float) -> None:
    assert at_most(value) == pytest.approx(rounded)
    assert at_most(value) <= value
