"""The whole line of a structure that no scene describes, with curved sensors: from measured loads to `GET /contact`."""

from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import change_scene, daemon_config, format_scene, resolve
from line import Surface
from models.test_measured_structures import optical, recorded_loads
from support.programs.forked_line import ForkedLine
from support.surfaces.tapered_leaf import scene_of

pytestmark = pytest.mark.long

PLACE_MM, FORCE_N, OFF_MM = 170.0, 9.0, 4.0
SCRIPT = f"""
[[step]]
seconds = 1.5
[[step]]
seconds = 600
position_mm = {PLACE_MM}
force_n = {FORCE_N}
"""


@pytest.mark.soak
def test_a_contact_on_a_measured_structure_is_at_its_place(tmp_path: Path) -> None:
    table = recorded_loads(np.linspace(15, 285, 24), [3.0, 6.0, 12.0, 20.0], optical)
    scene = change_scene(scene_of(influence=table, curved=True), sensors={"range_mm": [1, 19]})
    model = resolve(scene).place().build("leaf", effort=0.05)
    model.save(tmp_path / "leaf.onnx")
    for name, text in (
        ("leaf.toml", format_scene(scene)),
        ("built.toml", daemon_config(model.metadata)),
        ("script.toml", SCRIPT),
    ):
        (tmp_path / name).write_text(text)
    surface = Surface("leaf", "modbus-tcp", tmp_path / "script.toml")
    with ForkedLine(
        tmp_path, tmp_path / "leaf.toml", tmp_path / "leaf.onnx", tmp_path / "built.toml", [surface]
    ) as line:
        found = line.wait_for_still_contact()
    assert abs(found["position_mm"] - PLACE_MM) < OFF_MM, found
    assert abs(found["force_n"] - FORCE_N) < 0.1 * FORCE_N, found
