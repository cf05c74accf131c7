"""The smallest force that is seen along the beam, as the model states it, against samples of its own graph."""

import json
import re
from math import erfc
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.accuracy.evaluation import estimates
from beamtouch_models.design.accuracy.thresholds import SURELY, size_per_n
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.places import on_axis
from beamtouch_models.runtime import ModelFile
from support.programs.in_process import Command

DRAWS = 2048


@pytest.mark.parametrize("share", [0.7, 0.85, 1.0])
def test_the_graph_sees_the_smallest_force_as_stated(bench: ModelFile, share: float) -> None:
    """Samples of a part of the smallest force that is seen, at both ends of the range and between."""
    metadata, prior = bench.metadata, prior_of_model(bench.metadata)
    stated, rng = metadata.smallest_force, np.random.default_rng(7)
    at, position = [0, 5, 12, 24], np.array(stated.position_mm)
    size = size_per_n(prior, on_axis(position))
    for index in at:
        least = stated.force_n[index]
        assert least is not None
        clean = np.tile(share * least * prior.influence_table(on_axis(position[[index]])), (DRAWS, 1))
        zero, noise = rng.normal(size=(2, DRAWS, prior.channels)) * [
            [prior.errors.zero_mm],
            [np.full(4, prior.errors.noise_mm)],
        ]
        odds = estimates(bench, prior, clean + zero + noise)["contact_log_odds"]
        missed = float((odds <= metadata.thresholds.touch[-1]).mean())
        # A contact moves a whitened sample by its force times `size`; noise in its own direction takes it below. Noise
        # beside this direction adds to its odds: fewer are missed, by up to half a deviation.
        margin = SURELY + (share - 1) * least * size[index]
        assert 0.5 * erfc((margin + 0.5) / 2**0.5) - 0.02 < missed < 0.5 * erfc(margin / 2**0.5) + 0.02


ROLLER = """
[beam]
length_mm = 800
material = "steel"
width_mm = 25
thickness_mm = 4
supports = [{ at_mm = 0 }, { at_mm = 403 }, { at_mm = 800 }]

[contact]
force_n = [2, 40]
position_mm = [40, 800]

[sensors]
count = 4
noise_mm = 0.002
range_mm = [1, 8]
gain_error_percent = 0.3
zero_drift_mm = 0.0004
grid_mm = 8
"""


def test_at_a_support_nothing_is_seen_and_every_command_says_so(
    design_sensors_roughly: Command, tmp_path: Path
) -> None:
    """A roller that is not among evenly spaced places, and one at the end of the range."""
    scene, model, report = (tmp_path / name for name in ("roller.toml", "roller.onnx", "report.html"))
    scene.write_text(ROLLER)
    built = design_sensors_roughly("build", scene, "-o", model, "--report", report)
    assert built.returncode == 0, built.stderr
    said = "nothing is seen at the support at 403 mm and the support at 800 mm"
    assert re.search(f": {said} (note|warning): ", built.noted)
    assert re.search(r"note: shear is [\d.]+ times the noise but not modelled: ", built.noted)
    assert "and nothing at the ends" in built.stdout
    assert said in report.read_text()
    stated = json.loads(design_sensors_roughly("inspect", model, "--json").stdout)
    evaluated = design_sensors_roughly("evaluate", model, "--draws", 200)
    assert re.search(r"smallest force +[\d.]+ and more +N, seen in 95 %", evaluated.stdout)
    assert said in evaluated.noted
    forces = dict(zip(*stated["smallest_force"].values(), strict=True))
    assert [at for at, force in forces.items() if force is None] == [403, 800]
    # The note names the whole stretch.
    beside = [at for at, force in forces.items() if 340 < at < 470 and (force is None or force > 2)]
    low, high = (float(end) for end in re.findall(r"at ([\d.]+) to ([\d.]+) mm and", built.noted)[0])
    assert (low, high) == tuple(float(f"{end:.3g}") for end in (beside[0], beside[-1]))
    assert low < 403 < high
