"""Scenes, scripts and imperfections whose numbers are texts or truth values."""

import tomllib

import pytest
from pydantic import BaseModel, ValidationError

from beamtouch_models.rig.loads import Script
from beamtouch_models.rig.surface import Imperfections
from beamtouch_models.scene import Scene
from wrong_numbers import with_wrong_numbers

SCENE = """
[beam]
length_mm = 400
supports = [{at_mm = 0, fixity = 0.1}, {at_mm = 400}]
youngs_modulus_gpa = 210
shear_modulus_gpa = 80
width_mm = 25
thickness_mm = 3
density_kg_m3 = 7850
foundation_n_mm2 = 0.1
segments = [{to_mm = 200, width_mm = 20, thickness_mm = 4}, {to_mm = 400}]
[contact]
force_n = [2.0, 20.0]
position_mm = [1, 399]
width_mm = 2
[sensors]
count = [3, 4]
noise_mm = 0.005
gain_error_percent = 0.3
zero_drift_mm = 0.001
mounting_tolerance_mm = 1
rate_hz = 200
range_mm = [1, 4]
standoff_mm = 3
adc_bits = 16
min_distance_mm = 5
keep_out_mm = [[100, 120]]
fixed_mm = [50]
grid_mm = 1
[requirements]
position_error_mm = 5
latency_ms = 20
false_contacts_per_day = 0.03
"""
COUNTED = SCENE.replace("[3, 4]", "4").replace("noise_mm = 0.005", "noise_percent_of_max = 0.2")
RIGID = """
[beam]
length_mm = 400
flexural_rigidity_n_mm2 = 1e7
segments = [{to_mm = 400, flexural_rigidity_n_mm2 = 2e7}]
[contact]
force_n = 10.0
position_mm = [1, 399]
[sensors]
noise_mm = 0.005
"""
IMPERFECTIONS = """
position_offset_mm = [1, 0.5]
gain = [1, 1.01]
offset_mm = [0, 0.1]
curve_per_mm = 0.01
fixity = [0.1, 0]
rigidity = 1.02
damping_ratio = 0.01
"""
SCRIPT = """
repeat = true
step = [{seconds = 1, position_mm = 100, force_n = 5}, {seconds = 2, position_mm = [100, 300], force_n = [5, 8]}]
"""


@pytest.mark.parametrize(
    ("kind", "text"),
    [(Scene, SCENE), (Scene, COUNTED), (Scene, RIGID), (Imperfections, IMPERFECTIONS), (Script, SCRIPT)],
)
def test_only_a_number_is_a_number(kind: type[BaseModel], text: str) -> None:
    content = tomllib.loads(text)
    kind.model_validate(content)
    taken = []
    for what, wrong in with_wrong_numbers(content):
        try:
            kind.model_validate(wrong)
        except ValidationError:
            continue
        taken.append(what)
    assert not taken


@pytest.mark.parametrize("repeat", ["yes", 1, "true"])
def test_only_a_truth_value_repeats_a_script(repeat: object) -> None:
    with pytest.raises(ValidationError, match="repeat"):
        Script.model_validate({"repeat": repeat, "step": [{"seconds": 1}]})
