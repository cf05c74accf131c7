"""Rules for the sensors that a layout may break."""

import pytest

from beamtouch_models.building.sensor_rules import check_spacing
from beamtouch_models.errors import SceneError
from example_scenes import paper_scene


def test_sensors_that_could_change_places_are_refused() -> None:
    scene = paper_scene(mounting_tolerance_mm=30.0)
    check_spacing(scene, [100.0, 131.0, 300.0])
    check_spacing(scene, [100.0])
    with pytest.raises(SceneError, match="mounting_tolerance_mm = 30: two of the sensors are 30 mm apart"):
        check_spacing(scene, [300.0, 100.0, 130.0])
