"""The shipped scenes, and small ones for tests."""

from pathlib import Path
from typing import Any

from beamtouch_models.scene import Scene, parse_scene

SCENES = Path(__file__).parent.parent / "models" / "scenes"
UNIT_BEAM = {"length_mm": 1.0, "flexural_rigidity_n_mm2": 1.0}

PAPER = """
[beam]
length_mm = 400
youngs_modulus_gpa = 210
width_mm = 25
thickness_mm = 3

[contact]
force_n = 10.0
position_mm = [1, 399]

[sensors]
count = 2
noise_percent_of_max = 2
"""


def paper_scene(**sensors: Any) -> Scene:  # noqa: ANN401  # whatever a TOML value may be
    """The paper's scene with sensors of no size, as the paper has them, and other values in [sensors]."""
    scene = parse_scene(PAPER, "paper.toml").model_dump()
    return Scene.model_validate({**scene, "sensors": {**scene["sensors"], "size_mm": 0.0, **sensors}})
