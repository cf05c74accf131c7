"""The shipped scenes, and small ones for tests."""

from pathlib import Path
from typing import Any

from beamtouch_models.design.scene import Scene, parse_scene

ROUGH = 0.06
"""Effort of builds whose figures no test asks for."""
SCENES = Path(__file__).parents[3] / "models" / "scenes"
Tables = dict[str, dict[str, Any]]
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
    """The paper's scene, its force exact and its sensors of no size, and other values in [sensors]."""
    scene = parse_scene(PAPER, "paper.toml").model_dump()
    contact = {**scene["contact"], "force_n": (10.0, 10.0)}
    return Scene.model_validate(
        {**scene, "contact": contact, "sensors": {**scene["sensors"], "size_mm": 0.0, **sensors}}
    )


PLAIN: Tables = {
    "beam": {"length_mm": 400.0, "youngs_modulus_gpa": 210.0, "width_mm": 25.0, "thickness_mm": 3.0},
    "contact": {"force_n": [2.0, 20.0], "position_mm": [1.0, 399.0]},
    "sensors": {"count": 2, "noise_mm": 0.01, "range_mm": [1.0, 4.0], "grid_mm": 8.0, "rate_hz": 200.0},
    "requirements": {"latency_ms": 20.0},
    "environment": {},
}
OPTIONS: dict[tuple[str, str], Any] = {
    ("beam", "flexural_rigidity_n_mm2"): 1.18e7,
    ("beam", "density_kg_m3"): 7850.0,
    ("beam", "shear_modulus_gpa"): 80.0,
    ("beam", "foundation_n_mm2"): 0.05,
    ("beam", "segments"): [{"to_mm": 150.0}, {"to_mm": 400.0, "thickness_mm": 4.0}],
    ("beam", "damping_ratio"): 0.02,
    ("beam", "expansion_um_per_m_k"): 12.0,
    ("contact", "width_mm"): 3.0,
    ("sensors", "noise_percent_of_max"): 1.0,
    ("sensors", "adc_bits"): 12,
    ("sensors", "gain_error_percent"): 1.0,
    ("sensors", "zero_drift_mm"): 0.02,
    ("sensors", "mounting_tolerance_mm"): 1.0,
    ("sensors", "min_distance_mm"): 30.0,
    ("sensors", "size_mm"): 20.0,
    ("sensors", "standoff_mm"): 3.5,
    ("sensors", "keep_out_mm"): [[90.0, 120.0]],
    ("sensors", "fixed_mm"): [152.0],
    ("requirements", "max_mean_ms"): 500.0,
    ("requirements", "position_error_mm"): 30.0,
    ("requirements", "descriptors"): ["position", "force"],
    ("environment", "temperature_range_k"): [-5.0, 3.0],
}
"""All other keys of a scene, with everyday values."""
INSTEAD = {"flexural_rigidity_n_mm2": "youngs_modulus_gpa", "noise_percent_of_max": "noise_mm"}
"""Keys that take the place of others."""
