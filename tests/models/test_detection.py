"""Missed contacts along the beam, as the model states them, against many samples of its own graph."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.accuracy.evaluation import at_noise, estimates, seen_along
from beamtouch_models.accuracy.thresholds import size_per_n
from beamtouch_models.detection import detection_of, extremes, missed_shares
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.surface import prior_of_model
from in_process import Command

DRAWS = 2048


@pytest.mark.parametrize("share", [0.7, 0.85, 1.0])
def test_the_graph_misses_as_many_as_stated(bench: ModelFile, share: float) -> None:
    """Samples of a part of the smallest force that is seen, at both ends of the range and between."""
    metadata, prior = bench.metadata, prior_of_model(bench.metadata)
    stated, rng = detection_of(metadata), np.random.default_rng(7)
    assert stated is not None
    at, position = [0, 5, 12, 24], np.array(stated.position_mm)
    smallest, size = stated.smallest_force_n, size_per_n(prior, position)
    for index in at:
        least = smallest[index]
        assert least is not None
        force = share * least
        expected = missed_shares(force, [least], size[[index]])[0]
        clean = np.tile(force * prior.table(position[[index]]), (DRAWS, 1))
        zero, noise = rng.normal(size=(2, DRAWS, prior.channels)) * [[prior.zero_mm], [np.full(4, prior.noise_mm)]]
        odds = estimates(bench, prior, clean + zero + noise)["contact_log_odds"]
        missed = float((odds <= metadata.thresholds.touch[-1]).mean())
        # Noise beside the contact's own direction adds to its odds: fewer are missed, by up to half a deviation.
        assert missed < expected + 0.02
        assert missed > missed_shares(force + 0.5 / size[index], [least], size[[index]])[0] - 0.02


def test_at_the_smallest_force_one_of_twenty_is_missed_and_without_any_force_nearly_all() -> None:
    size = np.array([10.0, 4.0, 0.0])
    assert missed_shares(2.0, [2.0, 5.0, None], size) == pytest.approx([0.05, 1.0, 1.0], abs=1e-4)
    # Abramowitz & Stegun, table 26.1: Phi(-1.645 - 2) = 1.337e-4.
    assert missed_shares(2.2, [2.0], size[:1]) == pytest.approx([1.337e-4], rel=1e-3)


@pytest.mark.usefixtures("short_work")
def test_build_and_evaluate_state_the_same_along_the_beam(
    bench: ModelFile, bench_model: Path, design_sensors_here: Command
) -> None:
    described = json.loads(design_sensors_here("inspect", bench_model, "--json").stdout)["detection"]
    (evaluated,) = json.loads(design_sensors_here("evaluate", bench_model, "--draws", 200, "--json").stdout)[
        "evaluations"
    ]
    found = evaluated["detection"]
    assert described["force_n"] == found["force_n"] == 2.0
    assert described["false_contacts_per_day"] == found["false_contacts_per_day"] == pytest.approx(1 / 30)
    assert described["smallest_force_n"] == bench.metadata.smallest_force.force_n
    between = np.interp(described["position_mm"], found["position_mm"], found["smallest_force_n"])
    assert between == pytest.approx(described["smallest_force_n"], rel=0.03)
    assert max(described["missed"]) == pytest.approx(max(found["missed"]), abs=1e-6)
    assert evaluated["smallest_force_n"] == [min(found["smallest_force_n"]), max(found["smallest_force_n"])]


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


@pytest.mark.usefixtures("short_work")
def test_at_a_support_nothing_is_seen_and_every_command_says_so(design_sensors_here: Command, tmp_path: Path) -> None:
    """A roller that is not among evenly spaced places, and one at the end of the range."""
    scene, model, report = (tmp_path / name for name in ("roller.toml", "roller.onnx", "report.html"))
    scene.write_text(ROLLER)
    built = design_sensors_here("build", scene, "-o", model, "--report", report)
    assert built.returncode == 0, built.stderr
    said = "nothing is seen at the support at 403 mm and the support at 800 mm"
    assert f": {said}\n" in built.stderr
    assert "none at the ends of the range" in built.stdout
    assert said in report.read_text()
    stated = json.loads(design_sensors_here("inspect", model, "--json").stdout)
    evaluated = design_sensors_here("evaluate", model, "--draws", 200)
    assert f"along the range; {said}" in " ".join(evaluated.stdout.split())
    (found,) = json.loads(design_sensors_here("evaluate", model, "--draws", 200, "--json").stdout)["evaluations"]
    assert found["smallest_force_n"][1] is None
    for along in (stated["detection"], found["detection"]):
        forces = dict(zip(along["position_mm"], along["smallest_force_n"], strict=True))
        shares = dict(zip(along["position_mm"], along["missed"], strict=True))
        assert [at for at, force in forces.items() if force is None] == [403, 800]
        assert shares[403] == shares[800] == 1
        # The note names the whole stretch, to less than a millimetre, and not only the places in it.
        beside = [at for at, share in shares.items() if 340 < at < 470 and share > 0.05]
        low, high = (float(end) for end in re.findall(r"at ([\d.]+)\.\.([\d.]+) mm and", built.stderr)[0])
        assert low < beside[0] < 403 < beside[-1] < high


def test_more_noise_misses_more(bench: ModelFile) -> None:
    prior = prior_of_model(bench.metadata)
    usual, noisy = (seen_along(bench, at_noise(prior, times * prior.noise_mm)) for times in (1, 20))
    assert usual is not None
    assert noisy is not None
    assert max(noisy.missed) > max(usual.missed)
    least, most = (extremes(one.smallest_force_n)[0] for one in (usual, noisy))
    assert (most or 0) > 10 * (least or np.inf)
    assert seen_along(bench, at_noise(prior, 0.0)) is None
