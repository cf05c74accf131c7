"""Calibration: what is fitted, what it is worth, what is refused."""

import contextlib
import csv
import dataclasses
import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import cli, command_line, modelfile
from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.model_prior import physics_of, prior_of_model
from beamtouch_models.arrays import Floats
from beamtouch_models.calibration.calibrate import Calibrated, calibrate, checked_fit
from beamtouch_models.calibration.fit import Theory, fit, supported_fit
from beamtouch_models.calibration.loads import Loads, LoadsError, read_loads
from beamtouch_models.calibration.mistaken import mistaken
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.modelfile import Metadata, ModelFile
from beamtouch_models.rig.imperfections import Imperfections
from imperfect_surface import imperfections, true_prior, write_readings
from in_process import Command
from recorded_loads import MISTAKES, random_imperfections, recorded, with_mistake

pytestmark = pytest.mark.long

COMMAND = str(Path(sys.executable).parent / "design-sensors")
POSITIONS = np.linspace(20.0, 380.0, 10)
FORCES = np.full(10, 12.0)
SMALL = ("conveyor", "20 mm")
"""On 1200 mm this load moves the sensors by less than eight noises: see docs/figures.md."""


def quiet(_doing: str, _done: float) -> None:
    pass


def readings(tmp_path: Path, model: ModelFile, real: Imperfections, *, seed: int = 1, **others: Floats) -> Path:
    path = tmp_path / "loads.csv"
    position, force = others.get("position", POSITIONS), others.get("force", FORCES)
    write_readings(path, model.metadata, true_prior(model.metadata, real), position, force, seed=seed)
    return path


@pytest.fixture(scope="module")
def calibrated(bench: ModelFile, tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    """The bench's model, fitted to an imperfect surface."""
    path = readings(tmp_path_factory.mktemp("loads"), bench, imperfections(4, bench.metadata))
    return calibrate(bench, read_loads(path, bench.metadata), quiet)


def error_over_limit(model: ModelFile, real: Imperfections) -> tuple[float, float]:
    """Error of a model on the true surface over that surface's limit, and the coverage of its intervals."""
    prior = true_prior(model.metadata, real)
    drawn = limit.draw(prior, 4000, 9)
    stated = prior.stated(drawn.deflection_mm).astype(np.float32)
    answers = model.estimate(
        stated, prior_of_model(model.metadata).whitening(stated.astype(np.float64)).astype(np.float32)
    )
    best = np.abs(limit.posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm).mean()
    held = (answers["position_low_mm"] <= drawn.position_mm) & (drawn.position_mm <= answers["position_high_mm"])
    return float(np.abs(answers["position_mm"] - drawn.position_mm).mean() / best), float(held.mean())


def test_ten_loads_bring_the_error_to_the_limit(bench: ModelFile, calibrated: Calibrated) -> None:
    real = imperfections(4, bench.metadata)
    before, _ = error_over_limit(bench, real)
    fresh = modelfile.load_bytes(calibrated.content, "calibrated")
    after, held = error_over_limit(fresh, real)
    assert before > 2
    assert after < 1.1  # measured over twenty surfaces: 0.98 to 1.05
    # The floor allows for errors of gain and zero that this surface has not got beyond those that were fitted.
    assert 0.94 < held < 0.995
    assert calibrated.after_mm.mean() < 0.3 * calibrated.before_mm.mean()


def test_the_departures_are_found(bench: ModelFile, calibrated: Calibrated) -> None:
    real, found = imperfections(4, bench.metadata), calibrated.fit.departures
    assert set(calibrated.fit.kinds) >= {"gain", "fixity", "curve"}
    assert found.fixity == pytest.approx(real.fixity, abs=0.02)
    # Gains share a factor with the rigidity; between channels they are determined.
    gain = np.array(found.gain) / found.rigidity / np.array(real.gain)
    assert gain / gain.mean() == pytest.approx(np.ones(4), abs=0.01)
    assert np.sign(found.curve_per_mm) == -np.sign(real.curve_per_mm)


def test_the_file_says_what_was_fitted_and_rebuilds_from_itself(calibrated: Calibrated, bench: ModelFile) -> None:
    fresh = modelfile.load_bytes(calibrated.content, "calibrated")  # its golden answers come out
    calibration = fresh.metadata.calibration
    assert calibration is not None
    assert calibration.loads == 10
    assert calibration.fitted == list(calibrated.fit.kinds)
    prior = prior_of_model(fresh.metadata)
    # What the fit leaves is no noise: it stays when readings are averaged.
    assert prior.noise_mm == bench.metadata.noise.sample_mm
    floor = np.hypot(bench.metadata.floor.zero_mm, calibration.residual_mm)
    assert prior.zero_mm == pytest.approx(floor)
    assert fresh.metadata.floor.zero_mm == pytest.approx(floor.tolist())
    drawn = limit.draw(prior, 2000, 3)
    stated = prior.stated(drawn.deflection_mm).astype(np.float32)
    answers = fresh.estimate(
        stated, prior_of_model(fresh.metadata).whitening(stated.astype(np.float64)).astype(np.float32)
    )
    best = limit.posterior_median_mm(prior, drawn.deflection_mm)
    assert np.abs(answers["position_mm"] - drawn.position_mm).mean() < 1.02 * np.abs(best - drawn.position_mm).mean()
    # What is stated is undone by the graph: y + curve y^2 is the deflection again.
    reading = prior.stated(drawn.deflection_mm) - np.array(calibration.departures.offset_mm)
    linear = reading + calibration.departures.curve_per_mm * reading**2
    assert linear == pytest.approx(drawn.deflection_mm, abs=1e-12)


def test_a_perfect_surface_has_little_to_fit(bench: ModelFile, tmp_path: Path) -> None:
    path = readings(tmp_path, bench, Imperfections())
    theory = Theory.of(physics_of(bench.metadata), bench.metadata)
    found = supported_fit(theory, read_loads(path, bench.metadata), lambda _done: None)
    departures = found.departures
    assert departures.gain == pytest.approx([1] * 4, abs=2e-3)
    assert departures.position_offset_mm == pytest.approx([0] * 4, abs=0.3)
    assert departures.fixity == pytest.approx((0, 0), abs=5e-3)


def test_leverages_leave_out_as_fitting_again_does(bench: ModelFile, tmp_path: Path) -> None:
    path = readings(tmp_path, bench, imperfections(2, bench.metadata))
    loads = read_loads(path, bench.metadata)
    theory = Theory.of(physics_of(bench.metadata), bench.metadata)
    kinds = ("gain", "curve")
    whole = fit(theory, loads, kinds)
    for index in (0, 4, 9):
        rest = fit(theory, loads.without(index), kinds)
        off = loads.stated_mm[index] - theory.stated_mm(rest.vector, loads)[index]
        assert whole.left_out_mm[index] == pytest.approx(off, rel=0.2, abs=0.05 * np.abs(whole.left_out_mm).max())


def change_load(path: Path, number: str, column: str, value: str) -> None:
    """Mistype a number of a load."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows({**row, column: value} if row["load"] == number else row for row in rows)


def test_a_mistyped_load_is_named_and_can_be_left_out(
    design_sensors_here: Command, built_model: Callable[[str], Path], tmp_path: Path
) -> None:
    path, output, model = tmp_path / "loads.csv", tmp_path / "out.onnx", built_model("cantilever")
    metadata = modelfile.load(model).metadata
    real = random_imperfections(metadata, np.random.default_rng(1))
    position = np.linspace(29.0, 191.0, 10)
    write_readings(path, metadata, true_prior(metadata, real), position, np.full(10, 2.25), seed=1)
    change_load(path, "6", "position_mm", "179")  # by 60 mm: it pressed at 119
    given = ("calibrate", model, path, "-o", output)
    done = design_sensors_here(*given)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "load 6 (lines 1002 to 1201) says 179 mm and 2.25 N, but the other loads" in done.stderr
    place = re.search(r"place it at (\S+) mm with (\S+) N", done.stderr)
    assert place is not None
    assert [float(number) for number in place.groups()] == pytest.approx([119, 2.25], rel=0.05)
    assert not output.exists()
    missing = design_sensors_here(*given, "--leave-out", "77")
    assert (missing.returncode, missing.stderr.count("\n")) == (2, 1)
    assert "no load 77 to leave out" in missing.stderr
    done = design_sensors_here(*given, "--leave-out", "6", "--json")
    found = json.loads(done.stdout)
    assert found["loads_left_out"] == [6]
    assert found["error_after_mm"]["mean"] < found["error_before_mm"]["mean"]
    assert output.exists()


def test_two_exchanged_loads_are_both_named(built_model: Callable[[str], Path]) -> None:
    model = modelfile.load(built_model("cantilever"))
    rng = np.random.default_rng(1)
    loads = recorded(model.metadata, random_imperfections(model.metadata, rng), rng)
    loads.position_mm[[2, 6]] = loads.position_mm[[6, 2]]
    with pytest.raises(LoadsError, match=r"load 3 \(lines .*; load 7 \(lines .*; correct.*--leave-out 3 --leave-out 7"):
        checked_fit(model, loads, quiet)


@dataclasses.dataclass(frozen=True)
class Mistyped:
    """Loads with one mistyped load, and the true loads."""

    theory: Theory
    honest: Loads
    loads: Loads
    wrong: int
    real: Imperfections


def mistyped(metadata: Metadata, mistake: str) -> Mistyped:
    rng = np.random.default_rng([5, 5])
    real = random_imperfections(metadata, rng)
    honest = recorded(metadata, real, rng, hand_mm=0.3)
    position, force, wrong = with_mistake(mistake, honest, metadata.ranges.position_mm, rng)
    loads = dataclasses.replace(honest, position_mm=position, force_n=force)
    return Mistyped(Theory.of(physics_of(metadata), metadata), honest, loads, wrong, real)


@pytest.mark.parametrize("name", ["conveyor", "cantilever"])
def test_honest_loads_of_other_surfaces_are_accepted(name: str, built_model: Callable[[str], Path]) -> None:
    case = mistyped(modelfile.load(built_model(name)).metadata, MISTAKES[0])
    assert mistaken(case.theory, case.honest) == ()


@pytest.mark.parametrize(
    ("name", "mistake"),
    [(name, mistake) for name in ("conveyor", "cantilever") for mistake in MISTAKES if (name, mistake) != SMALL],
)
def test_a_mistyped_load_is_named_on_other_surfaces(
    name: str, mistake: str, built_model: Callable[[str], Path]
) -> None:
    case = mistyped(modelfile.load(built_model(name)).metadata, mistake)
    assert [one.index for one in mistaken(case.theory, case.loads)] == [case.wrong]


def test_a_mistyped_load_that_is_accepted_does_no_harm(built_model: Callable[[str], Path]) -> None:
    name, mistake = SMALL
    metadata = modelfile.load(built_model(name)).metadata
    case = mistyped(metadata, mistake)
    assert mistaken(case.theory, case.loads) == ()
    found = supported_fit(case.theory, case.loads, lambda _done: None)
    exact = recorded(metadata, case.real, np.random.default_rng(9))
    scene, fitted = (
        np.sqrt(np.mean((case.theory.stated_mm(vector, exact) - exact.stated_mm) ** 2)) / metadata.noise.sample_mm
        for vector in (np.zeros(case.theory.size), found.vector)
    )
    assert scene > 20
    assert fitted < 1  # 0.6 noises of a sample; 0.3 with honest loads


def test_swapped_channels_are_named(bench: ModelFile) -> None:
    rng = np.random.default_rng(3)
    loads = recorded(bench.metadata, random_imperfections(bench.metadata, rng), rng)
    loads = dataclasses.replace(loads, stated_mm=loads.stated_mm[:, [0, 2, 1, 3]])
    with pytest.raises(LoadsError, match="s2 and s3 seem to be swapped"):
        checked_fit(bench, loads, quiet)


@pytest.mark.parametrize("name", ["bench", "conveyor"])
def test_channels_in_reverse_order_are_named(name: str, built_model: Callable[[str], Path]) -> None:
    model, rng = modelfile.load(built_model(name)), np.random.default_rng([0, 1])
    loads = recorded(model.metadata, random_imperfections(model.metadata, rng), rng)
    with pytest.raises(LoadsError, match="channels seem to be in reverse order, or positions to be measured from the"):
        checked_fit(model, dataclasses.replace(loads, stated_mm=loads.stated_mm[:, ::-1]), quiet)
    mirrored = model.metadata.length_mm - loads.position_mm
    with pytest.raises(LoadsError, match="channels seem to be in reverse order, or positions to be measured from the"):
        checked_fit(model, dataclasses.replace(loads, position_mm=mirrored), quiet)


@pytest.mark.parametrize("stated_mm", ["all zero", "all the same", "of a mirrored beam", "of shuffled loads"])
def test_a_recording_that_is_of_another_surface_makes_no_model(
    stated_mm: str, built_model: Callable[[str], Path]
) -> None:
    model, rng = modelfile.load(built_model("cantilever")), np.random.default_rng(5)
    loads = recorded(model.metadata, random_imperfections(model.metadata, rng), rng)
    changed = {
        "all zero": np.zeros_like(loads.stated_mm),
        "all the same": np.full_like(loads.stated_mm, 0.1),
        "of a mirrored beam": loads.stated_mm[::-1],
        "of shuffled loads": rng.permutation(loads.stated_mm),
    }[stated_mm]
    with pytest.raises(NotGoodEnoughError, match="nothing was written: the recording does not fit this model's"):
        checked_fit(model, dataclasses.replace(loads, stated_mm=changed), quiet)


def test_a_surface_without_departures_is_accepted(built_model: Callable[[str], Path]) -> None:
    model, rng = modelfile.load(built_model("cantilever")), np.random.default_rng(6)
    accepted = 0
    for _ in range(6):
        with contextlib.suppress(NotGoodEnoughError):  # a fit that follows the noise is refused
            loads = recorded(model.metadata, Imperfections(), rng)
            accepted += checked_fit(model, loads, quiet).after_mm.mean() < 5
    assert accepted


def test_a_model_that_is_no_better_is_not_written(
    built_model: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # On a surface without departures a fit only follows the noise, and is no better about every other time.
    model_path, output = built_model("cantilever"), tmp_path / "out.onnx"
    model, position = modelfile.load(model_path), np.linspace(29.0, 191.0, 10)
    code = command_line.DONE
    for seed in range(10):
        path = readings(tmp_path, model, Imperfections(), seed=seed, position=position, force=np.full(10, 2.25))
        code = cli.main(["calibrate", str(model_path), str(path), "-o", str(output), "--json"])
        told = capsys.readouterr()
        if code != command_line.DONE:
            break
        found = json.loads(told.out)
        assert found["error_after_mm"]["mean"] <= found["error_before_mm"]["mean"]
        output.unlink()
    means = re.search(r"left-out loads to (\S+) mm, the given model to (\S+) mm", told.err)
    assert (code, told.out) == (command_line.FAILED, "")
    assert means is not None
    assert float(means[1]) >= float(means[2])
    assert not output.exists()


def test_a_recording_that_a_spreadsheet_saved_is_read(bench: ModelFile, tmp_path: Path) -> None:
    path = readings(tmp_path, bench, Imperfections())
    honest = read_loads(path, bench.metadata)
    without_time = "".join(line.partition(",")[2] for line in path.read_text().splitlines(keepends=True))
    path.write_text(without_time, encoding="utf-8-sig")  # with a byte order mark before the first column
    assert np.array_equal(read_loads(path, bench.metadata).stated_mm, honest.stated_mm)


def test_a_load_number_that_was_used_twice_is_refused(bench: ModelFile, tmp_path: Path) -> None:
    path = readings(tmp_path, bench, Imperfections())
    path.write_text(path.read_text().replace("0.0,2,60.0,12.0", "0.0,1,60.0,12.0"))
    with pytest.raises(LoadsError, match=r"load 1 has a position_mm of 20 in line 2 and of 60 in line 202"):
        read_loads(path, bench.metadata)


def test_a_fit_leaves_a_fixity_of_zero(bench: ModelFile) -> None:
    rng = np.random.default_rng(1)
    metadata = bench.metadata
    loads = recorded(metadata, random_imperfections(metadata, rng), rng)
    theory = Theory.of(physics_of(metadata), metadata)
    assert fit(theory, loads, tuple(theory.kinds)).error_mm < 2 * metadata.noise.sample_mm


def without_most_of_load_3(text: str) -> str:
    """The recording with four samples of its third load."""
    lines = text.splitlines(keepends=True)
    return "".join([*lines[:405], *lines[601:]])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("s3_deflection_mm", "s9_deflection_mm"), "column s3_deflection_mm is missing"),
        (lambda text: text.splitlines()[0] + "\n", "no samples"),
        (lambda text: text.replace(",20.0,12.0,", ",20.0,-1,"), "has a force of -1 N"),
        (lambda text: text.replace(",20.0,12.0,", ",20.0,1e300,"), "load 1 (lines 2 to 201) has a force of 1e+300 N"),
        (lambda text: text.replace(",20.0,12.0,", ",20.0,5e-324,"), "load 1 (lines 2 to 201) has a force of 4.94"),
        (
            lambda text: re.sub(r"(?m)^(0.0,2,60.0,12.0,1000,)[^,]*", r"\g<1>1e308", text),
            "s1 states 1e+308 mm in line 202",
        ),
        (lambda text: re.sub(r"(?m)([^,]*),good$", r"\g<1>e5,good", text), "s4 states "),
        (lambda text: text.replace(",20.0,12.0,", ",900.0,12.0,"), "is not within 1..399 mm"),
        (lambda text: text.replace(",20.0,12.0,", ",abc,12.0,"), "not a number"),
        (lambda text: "\n".join(text.splitlines()[:601]), "cannot determine a fit"),
        (lambda text: re.sub(r"(.*,[\d.-]+),good", r"\1,stuck", text), "s4 has no good samples"),
        (without_most_of_load_3, "load 3 (lines 402 to 405) has fewer than 5 good samples of each"),
        (
            lambda text: re.sub(r"(?m)^(0.0,3,.*)$", lambda row: row[0].replace("good", "stuck"), text),
            "--leave-out 3\n",
        ),
        (
            lambda text: re.sub(r"(?m)^(0.0,3,(?:[^,]*,){3}).*$", r"\1", text),
            "load 3 (lines 402 to 601) has fewer than",
        ),
    ],
)
def test_an_unusable_recording_is_refused_in_one_line(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, tmp_path: Path, change: object, said: str
) -> None:
    path = readings(tmp_path, bench, Imperfections())
    assert callable(change)
    path.write_text(change(path.read_text()))
    output = tmp_path / "out.onnx"
    done = design_sensors_here("calibrate", bench_model, path, "-o", output)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr
    assert not output.exists()


def test_the_command_prints_the_departures(bench_model: Path, bench: ModelFile, tmp_path: Path) -> None:
    path = readings(tmp_path, bench, imperfections(3, bench.metadata))
    output = tmp_path / "real.onnx"
    command = [COMMAND, "calibrate", str(bench_model), str(path), "-o", str(output), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["model"] == modelfile.load(output).identity
    assert found["error_after_mm"]["mean"] < found["error_before_mm"]["mean"]
    assert found["standard_errors"]["gain"]
    shown = subprocess.run([COMMAND, "inspect", str(output)], capture_output=True, text=True, check=True)
    assert "calibrated with 10 loads" in shown.stdout
