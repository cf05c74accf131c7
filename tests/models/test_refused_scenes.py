"""Scenes of which no surface can be built: `place`, `build` and `explain` refuse them with the same line.

Only `place` and `build` find what takes placing the sensors.
"""

from pathlib import Path

import pytest

from support.programs.in_process import Command, Refusal
from support.surfaces.example_scenes import PAPER

NOISE, COUNT, FORCE = "noise_percent_of_max = 2", "count = 2", "force_n = 10.0"
CASES = {
    "foundation": ("[beam]", "[beam]\nfoundation_n_mm2 = 1e30", "too stiff beside this beam"),
    "rigid": (
        "youngs_modulus_gpa = 210",
        "flexural_rigidity_n_mm2 = 1e30",
        "the largest deflection is 1.35e-23 mm, which no sensor measures",  # F l^3 / (48 EI), F within 1 % of 10 N
    ),
    "beyond numbers": (FORCE, "force_n = [2.0, 1e308]", "beyond the 0.1 rad of small-angle theory"),
    "range": (COUNT, "count = 2\nrange_mm = [1, 2]", "leaves sensors.range_mm"),
    "no noise": (NOISE, "noise_mm = 0", "a noise of 0"),
    "little noise": (NOISE, "noise_mm = 1e-310", "less than 1e-4 % of the largest deflection"),
    "much noise": (NOISE, "noise_percent_of_max = 1e6", "hides the largest deflection"),
    "noise in um": (
        NOISE,
        "noise_mm = 3",
        "is more than a tenth of range_mm; if it is in um, write 0.003",
    ),
    "drift": (COUNT, "count = 2\nzero_drift_mm = 1e200", "zero_drift_mm = 1e+200 hides the largest deflection"),
    "long latency": (NOISE, f"{NOISE}\n[requirements]\nlatency_ms = 1e300", "more than 10000 readings"),
    "fixed": (COUNT, "count = 2\nfixed_mm = [100, 200, 300]", "more than the 2 to be placed"),
    "twice": (COUNT, "count = 3\nfixed_mm = [100, 200, 100]", "fixed_mm names 100 mm twice"),
    "grid": (COUNT, "count = 5\ngrid_mm = 80", "5 sensors do not fit on 4 places"),
    "fine grid": (COUNT, "count = 2\ngrid_mm = 1e-6", "more than 20000 positions"),
    "no room": (COUNT, "count = 2\nkeep_out_mm = [[0, 400]]", "fewer than two positions"),
    "neighbours": (
        COUNT,
        "count = 2\nfixed_mm = [200, 209]\nmounting_tolerance_mm = 10",
        "no layout of 2 sensors keeps the rules",
    ),
}
PLACED = {
    "open count": (COUNT, 'count = "auto"', "give requirements.position_error_mm, or a number of sensors"),
    "out of reach": (
        f"{COUNT}\n{NOISE}\n",
        f"count = [2, 3]\ngrid_mm = 57\n{NOISE}\n[requirements]\nposition_error_mm = 0.01\n",
        "not even 3 sensors reach requirements.position_error_mm",
    ),
    "no room for more": (
        f"{COUNT}\n{NOISE}\n",
        f"count = [2, 5]\ngrid_mm = 57\n{NOISE}\nmin_distance_mm = 250\n[requirements]\nposition_error_mm = 0.01\n",
        "not even 2 sensors reach requirements.position_error_mm = 0.01: the accuracy limit is",
    ),
    "nothing is seen": (NOISE, "noise_percent_of_max = 90\ngrid_mm = 57", "no contact of the scene is seen"),
}


@pytest.mark.parametrize("name", [*CASES, *PLACED])
def test_every_command_refuses_a_scene_with_the_same_line(
    design_sensors_roughly: Command, refused: Refusal, tmp_path: Path, name: str
) -> None:
    old, new, said = (CASES | PLACED)[name]
    scene, model, config = tmp_path / "scene.toml", tmp_path / "model.onnx", tmp_path / "daemon.toml"
    assert old in PAPER
    scene.write_text(PAPER.replace(old, new, 1))
    commands = {"place": (), "build": ("-o", model, "--daemon-config", config), "explain": ()}
    lines = set()
    for command, options in commands.items():
        if command == "explain" and name in PLACED:
            assert "contact width" in design_sensors_roughly(command, scene).stdout
        else:
            lines.add(refused(command, scene, *options))
    assert len(lines) == 1
    assert said in lines.pop()
    assert list(tmp_path.iterdir()) == [scene]
