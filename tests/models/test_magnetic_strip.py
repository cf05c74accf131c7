"""Sensors that are no gaps: Hall sensors in uT that show less than nothing beside a contact, and curved ones in V."""

import numpy as np
import pytest

from beamtouch_models import change_scene, daemon_config, resolve
from beamtouch_models.errors import InputError
from models.test_measured_structures import optical, recorded_loads
from support.surfaces import strain_gauges
from support.surfaces.magnetic_strip import SENSORS_MM, influence, loads_csv, scene_of, true_influence
from support.surfaces.tapered_leaf import influence as of_leaf
from support.surfaces.tapered_leaf import scene_of as scene_of_leaf

EFFORT, DRAWS = 0.05, 4000
VOLTS = 0.6
"""That a sensor shows where the light of its contact has doubled."""


def test_magnets_over_hall_sensors_tell_the_place_of_a_contact() -> None:
    assert influence(np.array(list(SENSORS_MM.values())), np.array([20.0])).min() < -0.3
    model = resolve(scene_of(loads_csv(30))).place().build("strip", effort=EFFORT)
    found = model.evaluate(influence=true_influence(), draws=DRAWS)
    assert found.span.ratio is not None
    assert found.span.ratio.value < 1.2
    assert found.position_coverage is not None
    assert found.position_coverage.value > 0.93
    assert {channel.unit for channel in model.metadata.layout} == {"uT"}


def test_noise_of_a_light_load_far_from_a_sensor_is_no_contradiction() -> None:
    """Under 2 N, h6 shows 2.3 deviations of its noise, where the others say it shows nothing."""
    assert resolve(scene_of(loads_csv(30, seed=1))).influence.matrix(np.array([[20.0]])).max() > 0


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/measured.md", "A characteristic is in the unit of its sensor, too")
def test_curved_sensors_may_show_another_unit() -> None:
    forces_n = [3.0, 6.0, 12.0, 20.0]
    table = recorded_loads(np.linspace(15, 285, 24), forces_n, lambda mm: VOLTS * optical(mm))
    scene = scene_of_leaf(influence=table.replace("deflection_mm", "deflection_V"), curved=True)
    model = resolve(change_scene(scene, sensors={"range_mm": [-1, 19]})).place().build("leaf", effort=EFFORT)
    rng = np.random.default_rng(4)
    place_mm, force_n = rng.uniform(20, 280, 300), rng.uniform(3, 20, 300)
    volts = VOLTS * optical(force_n[:, None] * of_leaf(model.metadata.layout_mm, place_mm))
    shown = model.straighten(volts + 0.004 / np.sqrt(5) * rng.normal(size=volts.shape))
    answers = model.estimate(shown.deflection_mm, noise_mm=shown.noise_mm / np.sqrt(5))
    assert (answers["state"] == "contact").mean() > 0.95
    held = (answers["position_low_mm"] <= place_mm) & (place_mm <= answers["position_high_mm"])
    assert held.mean() > 0.93
    configured = daemon_config(model.metadata)
    assert 'value_unit = "V"' in configured
    assert "\ntable = [[" in configured


def test_curved_sensors_that_show_less_than_at_rest_are_refused() -> None:
    gauges = strain_gauges.scene_of(strain_gauges.loads_csv(30))
    with pytest.raises(InputError, match="g1 shows less than at rest under most loads, and a characteristic grows"):
        resolve(change_scene(gauges, measured={"curved": True}))
