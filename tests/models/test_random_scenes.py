"""Scenes at which a command once divided by zero, and a few random ones: a model or one line, without warnings.

`python tests/random_scenes.py` runs as many as one likes.
"""

from pathlib import Path

import pytest

from beamtouch_models.loading import load
from few_draws import short_work
from random_scenes import random_scene, run_here, try_scene

ON_SUPPORTS = """
[beam]
length_mm = 400
youngs_modulus_gpa = 210
width_mm = 25
thickness_mm = 3

[contact]
force_n = [2, 20]
position_mm = [0, 400]

[sensors]
count = 4
noise_mm = 0.002
zero_drift_mm = 0.02

[requirements]
latency_ms = 50
"""

ZEROS_FAR_ABOVE_NOISE = """
[beam]
length_mm = 158.3
flexural_rigidity_n_mm2 = 139.2e9
supports = [
    { at_mm = 34.6 }, { at_mm = 82.5 }, { at_mm = 103.3 }, { at_mm = 124.1 }, { at_mm = 145.3, kind = "fixed" },
]

[contact]
force_n = [198e3, 396e3]
position_mm = [2, 156]

[sensors]
count = 5
rate_hz = 8.4
noise_mm = 1e-4
zero_drift_mm = 0.003
size_mm = 1.8

[requirements]
latency_ms = 78e3
"""


def test_a_model_is_built_where_contacts_may_stand_on_supports_and_zeros_drift(tmp_path: Path) -> None:
    (tmp_path / "strip.toml").write_text(ON_SUPPORTS)

    with short_work():
        assert run_here(["build", str(tmp_path / "strip.toml"), "-o", str(tmp_path / "strip.onnx"), "--json"]) == "done"

    seen = load(tmp_path / "strip.onnx").metadata.smallest_force
    assert seen.force_n[0] is seen.force_n[-1] is None
    assert min(force for force in seen.force_n if force is not None) < 2


def test_a_model_is_built_where_zeros_drift_far_more_than_readings_scatter(tmp_path: Path) -> None:
    (tmp_path / "frame.toml").write_text(ZEROS_FAR_ABOVE_NOISE)
    quick = ["--criterion", "eigenvalue-product", "--json"]

    with short_work():
        assert run_here(["build", str(tmp_path / "frame.toml"), "-o", str(tmp_path / "frame.onnx"), *quick]) == "done"

    thresholds = load(tmp_path / "frame.onnx").metadata.thresholds
    # Zeros lie within two of their deviations: alone, they move one channel by no more, which is odds of 2^2 / 2.
    assert 0 < thresholds.touch[0] < 2.1
    assert thresholds.touch[-1] > 1


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(1, 5))])
def test_a_random_scene_is_explained_and_placed_or_refused_in_one_line(seed: int, tmp_path: Path) -> None:
    with short_work():
        told = dict(try_scene(seed, ["explain", "place"], tmp_path))

    assert set(told) == {"explain", "place"}, random_scene(seed)
