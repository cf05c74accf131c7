"""The whole line of a skin that is known from loads alone: by the guide's commands to `GET /contact` with two axes."""

from pathlib import Path

import pytest

from beamtouch_models import cli
from line import Surface
from models.test_measured_skins import GRID, recorded
from support.programs.forked_line import ForkedLine

pytestmark = pytest.mark.long

X_MM, Y_MM, FORCE_N, OFF_MM = 22.0, 26.0, 4.0, 3.0
SCRIPT = f"""
[[step]]
seconds = 1.5
[[step]]
seconds = 600
x_mm = {X_MM}
y_mm = {Y_MM}
force_n = {FORCE_N}
"""
SCENE = """
[measured]
influence = "skin.csv"
[contact]
force_n = [1, 5]
x_mm = [3, 57]
y_mm = [3, 37]
[sensors]
noise_mm = 0.5
range_mm = [-2000, 2000]
"""
"""For the rig, which plays a structure that the table allows."""


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/measured.md", "The answer has `x_mm` and `y_mm`, each with its interval.")
def test_a_contact_on_a_skin_is_at_its_place(tmp_path: Path) -> None:
    files = {"skin.csv": recorded(len(GRID)), "skin.toml": SCENE, "script.toml": SCRIPT}
    loads, scene, script = (tmp_path / name for name in files)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    model, built = tmp_path / "skin.onnx", tmp_path / "built.toml"
    words = ["build", "--loads", loads, "-o", model, "--daemon-config", built, "--effort", "0.01"]
    assert cli.main([str(word) for word in words]) == 0
    with ForkedLine(tmp_path, scene, model, built, [Surface("skin", "modbus-tcp", script)]) as line:
        found = line.wait_for_still_contact()
    for axis, true_mm in (("x", X_MM), ("y", Y_MM)):
        assert abs(found[f"{axis}_mm"] - true_mm) < OFF_MM, found
        assert found[f"{axis}_low_mm"] < found[f"{axis}_mm"] < found[f"{axis}_high_mm"], found
    assert abs(found["force_n"] - FORCE_N) < 0.1 * FORCE_N, found
