"""Scenes, scripts and imperfections whose numbers are texts or truth values."""

import tomllib
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from beamtouch_models.design.scene import Scene
from beamtouch_models.lab.rig.loads import Script
from beamtouch_models.lab.rig.surface import Imperfections
from support.surfaces.example_scenes import INSTEAD, OPTIONS, PLAIN
from support.surfaces.wrong_numbers import with_wrong_numbers

EVERY_KEY = {
    part: keys | {key: value for (home, key), value in OPTIONS.items() if home == part and key not in INSTEAD}
    for part, keys in PLAIN.items()
}
EVERY_KEY["beam"] |= {"supports": [{"at_mm": 0, "fixity": 0.1}, {"at_mm": 400}]}
RIGID = {
    "beam": {
        "length_mm": 400,
        "flexural_rigidity_n_mm2": 1e7,
        "segments": [{"to_mm": 400, "flexural_rigidity_n_mm2": 2e7}],
    },
    "contact": {"force_n": 10.0, "position_mm": [1, 399]},
    "sensors": {"count": [3, 4], "noise_percent_of_max": 0.2},
}
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
    ("kind", "content"),
    [
        *((Scene, EVERY_KEY), (Scene, RIGID)),
        *((Imperfections, tomllib.loads(IMPERFECTIONS)), (Script, tomllib.loads(SCRIPT))),
    ],
)
def test_only_a_number_is_a_number(kind: type[BaseModel], content: dict[str, Any]) -> None:
    kind.model_validate(content)
    taken = []
    for what, wrong in with_wrong_numbers(content):
        try:
            kind.model_validate(wrong)
        except ValidationError:
            continue
        taken.append(what)
    assert not taken
