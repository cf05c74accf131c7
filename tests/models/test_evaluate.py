"""`design-sensors evaluate`: its figures by other ways, the command, and a requirement that is missed."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from beamtouch_common.digits import digits
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.evaluation import evaluate
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.numbers import with_error
from beamtouch_models.places import Extent
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.description import unseen
from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER


@pytest.mark.long
def test_the_model_of_the_bench_is_at_its_limit(bench: ModelFile) -> None:
    prior = prior_of_model(bench.metadata)
    found = evaluate(bench, prior, draws=8000, seed=5)
    for errors in (found.span, found.middle):
        assert errors is not None
        assert errors.ratio is not None
        assert 0.999 < errors.ratio.value - 3 * errors.ratio.standard_error < 1.05
    assert found.position_coverage is not None
    assert abs(found.position_coverage.value - 0.95) < 0.01 + 4 * found.position_coverage.standard_error
    assert found.force_coverage is not None
    assert abs(found.force_coverage.value - 0.95) < 0.01 + 4 * found.force_coverage.standard_error
    assert found.unexplained is not None
    assert found.unexplained.value < 1e-3
    # Plain draws, by hand.
    drawn = draw(prior, 40_000, 5)
    answer = bench.run(drawn.deflection_mm, prior.errors.whitening(drawn.deflection_mm))
    error = np.abs(answer["position_mm"] - drawn.position_mm)
    mean = found.span.mean_mm
    assert abs(mean.value - error.mean()) < 4 * np.hypot(mean.standard_error, error.std() / 200)
    assert mean.standard_error < 0.01 * mean.value < error.std() / 40_000**0.5
    calls = answer["contact_log_odds"] > bench.metadata.thresholds.touch[-1]
    assert found.missed is not None
    assert found.missed.value == pytest.approx(1 - calls.mean(), abs=4 * found.missed.standard_error + 4 * (1e-3 / 200))


def test_a_model_answers_to_the_noise_that_a_sample_states(bench: ModelFile) -> None:
    prior = prior_of_model(bench.metadata).at_noise(5 * bench.metadata.noise.sample_mm)
    found = evaluate(bench, prior, draws=2000, seed=5)
    assert found.position_coverage is not None
    assert found.position_coverage.value == pytest.approx(0.95, abs=0.02)
    assert found.span.ratio is not None
    assert found.span.ratio.value < 1.03


def test_one_json_object_and_a_table(design_sensors_roughly: Command, bench_model: Path, bench: ModelFile) -> None:
    noises = [option for noise in (0.01, 0, bench.metadata.noise.sample_mm) for option in ("--noise", noise)]
    done = design_sensors_roughly("evaluate", bench_model, "--draws", 400, *noises, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert found["model"] == bench.identity
    noisy, silent, usual = found["evaluations"]
    forces = [force for force in bench.metadata.smallest_force.force_n if force is not None]
    assert usual["smallest_force_n"] == pytest.approx([min(forces), max(forces)])
    assert noisy["noise_mm"] == 0.01
    assert noisy["span"]["ratio"]["standard_error"] > 0
    assert silent["span"]["ratio"] is silent["cramer_rao_mean_mm"] is None
    table = design_sensors_roughly("evaluate", bench_model, "--draws", 400, "--noise", 0.01, "--noise", 0).stdout
    said = " ".join(table.split())
    assert re.search(r"without noise the limit is 0, so there is no ratio", said)
    assert re.search(r"limit, mean -", said)
    for line in told_lines(noisy):
        assert f" {line} " in said


def told_lines(evaluation: dict[str, Any]) -> Iterator[str]:
    """Yield what the command says of an evaluation on a beam of 400 mm, without the spaces between columns."""

    def told(measured: dict[str, float], scale: float = 1.0) -> str:
        return with_error(scale * measured["value"], scale * measured["standard_error"])

    parts = evaluation["span"], evaluation["middle"]
    for label, name in (
        ("mean", "mean_mm"),
        ("95th percentile", "p95_mm"),
        ("limit, mean", "limit_mean_mm"),
        ("limit, 95th", "limit_p95_mm"),
    ):
        yield f"{label} {' '.join(told(part[name], scale) for part in parts for scale in (1, 1 / 4))}"
    yield f"worst {' '.join(digits(scale * part['worst_mm'], 3) for part in parts for scale in (1, 1 / 4))}"
    yield f"error over limit {' '.join(told(part['ratio']) for part in parts)}"
    yield f"position held {told(evaluation['position_coverage'], 100)} % of contacts"
    yield f"interval {told(evaluation['position_width_mm'])} mm"
    yield f"force held {told(evaluation['force_coverage'], 100)} % of forces"
    yield f"force error {told(evaluation['force_error_n'])} N,"
    yield f"missed {told(evaluation['missed'], 100)} % of contacts"
    yield f"unexplained {told(evaluation['unexplained'], 100)} % of contacts"
    yield f"smallest force {'..'.join(digits(force_n, 3) for force_n in evaluation['smallest_force_n'])} N,"
    yield f"Cramer-Rao {digits(evaluation['cramer_rao_mean_mm'], 3)} mm,"


def test_the_middle_has_figures_only_where_enough_contacts_lie_in_it(bench: ModelFile) -> None:
    # Of 400 mm the middle begins at 80, so that one contact in eighty lies in it, or one in 160.
    for end_mm in (80.5, 81.0):
        prior = replace(prior_of_model(bench.metadata), extent=Extent.of_beam((1.0, end_mm)))
        for draws in (100, 512):
            found = evaluate(bench, prior, draws=draws, seed=0)
            assert found.span.mean_mm.standard_error > 0
            assert found.middle is None or found.middle.p95_mm.standard_error > 0
    assert evaluate(bench, replace(prior, extent=Extent.of_beam((1.0, 200.0))), draws=512, seed=0).middle is not None


def test_a_force_of_the_scene_that_is_missed_is_noted(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, tmp_path: Path
) -> None:
    # A contact 1 mm from a support is missed, whatever the layout.
    assert (bench.metadata.smallest_force.force_n[0] or 0) > 2
    assert not unseen(bench.metadata)
    model = onnx.load(bench_model)
    weakest, seen = bench.metadata.ranges.force_n[0], bench.metadata.smallest_force
    force = [2.4 * weakest if position > 350 else weakest for position in seen.position_mm]
    (entry,) = [entry for entry in model.metadata_props if entry.key == "beamtouch.smallest_force"]
    entry.value = json.dumps({"position_mm": seen.position_mm, "force_n": force})
    onnx.save(model, tmp_path / "weak.onnx")
    done = design_sensors_here("evaluate", tmp_path / "weak.onnx", "--draws", 200, "--json")
    assert json.loads(done.stdout)["evaluations"]
    first, last = (min(at for at in seen.position_mm if at > 350), max(seen.position_mm))
    assert f"note: the scene's smallest force, {weakest:g} N, is missed" in done.noted
    assert f"at {first:.3g} to {last:.3g} mm: up to {2.4 * weakest:.2g} N is needed there" in done.noted


def test_every_command_says_that_a_required_error_is_missed(design_sensors_roughly: Command, tmp_path: Path) -> None:
    scene, model = tmp_path / "paper.toml", tmp_path / "paper.onnx"
    coarse = PAPER.replace("count = 2", "count = 2\ngrid_mm = 57")
    missed = (
        r"note: the (?:mean error|accuracy limit) is [\d.]+ mm, more than requirements.position_error_mm = 0.5; use"
    )
    commands = (("place", scene), ("build", scene, "-o", model), ("evaluate", model, "--draws", 100))
    for wanted_mm, is_missed in ((0.5, True), (50, False)):
        scene.write_text(f"{coarse}\n[requirements]\nposition_error_mm = {wanted_mm}\n")
        for arguments in commands:
            done = design_sensors_roughly(*arguments, "--json")
            assert done.returncode == 0, done.stderr
            assert bool(re.search(missed, done.noted)) is is_missed, done.stderr
