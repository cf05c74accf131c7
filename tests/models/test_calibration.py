"""Calibration with known loads: the fitted values, the gain in accuracy, and refusals."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import runtime
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.limit import posterior_median_mm
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.calibration.calibrate import Calibrated, calibrate
from beamtouch_models.design.calibration.fit import fit
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import read_contacts, read_loads
from beamtouch_models.design.calibration.self_calibrate import self_calibrate
from beamtouch_models.design.calibration.session import Session
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.scene import change_scene, load_scene
from beamtouch_models.design.surface import resolve, resolve_model
from beamtouch_models.design.sweeps import silent
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.runtime import ModelFile, Weighed, evidence
from models.calibration_files import write_contacts, write_readings
from support.programs.in_process import Command
from support.surfaces.example_scenes import ROUGH, SCENES
from support.surfaces.real_surfaces import deflections_on, random_imperfections, recorded, true_prior
from support.surfaces.unlabelled_contacts import Kind, drawn, missed_mm

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def real(bench: ModelFile) -> Imperfections:
    """Return how the surface of the recording differs from its scene."""
    return random_imperfections(bench.metadata, np.random.default_rng(14))


@pytest.fixture(scope="module")
def recording(bench: ModelFile, real: Imperfections, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_readings(tmp_path_factory.mktemp("loads") / "loads.csv", bench, deflections_on(bench.metadata, real))


@pytest.fixture(scope="module")
def calibrated(bench: ModelFile, recording: Path) -> Calibrated:
    """The bench's model, fitted to that recording."""
    return calibrate(bench, read_loads(recording, bench.metadata), silent, effort=Effort(ROUGH))


def error_over_limit(model: ModelFile, real: Imperfections) -> tuple[float, float]:
    """Error of a model on the true surface over that surface's limit, and the coverage of its intervals.

    Its zeros drift as the scene states; its gains stay what they were.
    """
    drift_mm = resolve_model(model.metadata).readings.floor_mm
    prior = true_prior(model.metadata, real).with_floor(0.0, drift_mm)
    drawn = draw(prior, 3000, 9)
    stated = prior.measured(drawn.deflection_mm).astype(np.float32)
    answers = model.graph.estimate(
        stated, prior_of_model(model.metadata).errors.whitening(stated.astype(np.float64)).astype(np.float32)
    )
    best = np.abs(posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm).mean()
    held = (answers["position_low_mm"] <= drawn.position_mm) & (drawn.position_mm <= answers["position_high_mm"])
    return float(np.abs(answers["position_mm"] - drawn.position_mm).mean() / best), float(held.mean())


def test_ten_loads_bring_the_error_to_the_limit(bench: ModelFile, real: Imperfections, calibrated: Calibrated) -> None:
    before, _ = error_over_limit(bench, real)
    fresh = runtime.load_bytes(calibrated.content, "calibrated")
    assert fresh.metadata.beam == bench.metadata.beam
    after, held = error_over_limit(fresh, real)
    assert before > 2
    assert after < 1.1  # measured over twenty surfaces: 0.98 to 1.05
    assert 0.94 < held < 0.975  # measured over eight surfaces: 0.958 to 0.978
    assert calibrated.after_mm.mean() < 0.3 * calibrated.before_mm.mean()


def test_the_departures_are_found_and_the_file_says_so(
    bench: ModelFile, real: Imperfections, calibrated: Calibrated
) -> None:
    fresh = runtime.load_bytes(calibrated.content, "calibrated")  # its golden answers come out
    calibration = fresh.metadata.calibration
    assert calibration is not None
    assert calibration.loads == 10
    assert set(calibration.fitted) >= {"gain", "fixity", "curve"}
    found = calibration.departures
    assert found.fixity == pytest.approx(real.fixity, abs=0.02)
    # Gains share a factor with the rigidity; between channels they are determined.
    gain = np.array(found.gain) / found.rigidity / np.array(real.gain)
    assert gain / gain.mean() == pytest.approx(np.ones(4), abs=0.01)
    assert found.curve_per_mm == pytest.approx(real.curve_per_mm, rel=0.3)
    # What the fit leaves is no noise: it stays when readings are averaged.
    prior = prior_of_model(fresh.metadata)
    assert prior.errors.noise_mm == bench.metadata.noise.sample_mm
    least_mm = np.hypot(bench.metadata.floor.zero_mm, found.offset_mm)
    assert (np.array(fresh.metadata.floor.zero_mm) >= 0.999 * least_mm).all()
    assert (np.array(fresh.metadata.floor.zero_mm) <= np.hypot(least_mm, calibration.residual_mm)).all()
    # It has measured the gains, better than the scene states them.
    assert (np.array(fresh.metadata.floor.gain) < bench.metadata.floor.gain).all()


@pytest.mark.soak
def test_a_beam_rests_before_and_after_its_next_tare(built_model: Callable[[str], Path]) -> None:
    model, rng = runtime.load(built_model("cantilever")), np.random.default_rng(1)
    noise_mm, channels = model.metadata.noise.sample_mm, len(model.channels)
    # The zeros moved between the tare and the recording.
    drifted_mm = 4 * noise_mm * (-1.0) ** np.arange(channels)
    loads = recorded(model.metadata, random_imperfections(model.metadata, rng), rng, count=12)
    drifted = dataclasses.replace(loads, measured_mm=loads.measured_mm + drifted_mm)
    found = calibrate(model, drifted, silent, effort=Effort(ROUGH))
    fresh = runtime.load_bytes(found.content, "calibrated")
    assert fresh.metadata.departures.offset_mm == pytest.approx(drifted_mm.tolist(), abs=0.5 * noise_mm)
    rest_mm, noise_mm2 = np.array([drifted_mm, 0 * drifted_mm]), np.full((2, channels), noise_mm**2)
    samples = Weighed(rest_mm, noise_mm2[:, :, None] * np.eye(channels), noise_mm2, np.ones((2, channels), np.bool_))
    for said in evidence(fresh.metadata, fresh.run, samples):
        assert said.rest_misfit < fresh.metadata.thresholds.rest[-1] / 4
        assert said.log_odds < fresh.metadata.thresholds.touch[-1] / 8


@pytest.mark.soak
def test_unlabelled_contacts_go_on_from_a_calibrated_model(
    bench: ModelFile, real: Imperfections, calibrated: Calibrated
) -> None:
    model = runtime.load_bytes(calibrated.content, "calibrated with loads")
    nominal, departures = NominalSurface.of(model.metadata), model.metadata.departures
    start = nominal.vector_of(departures)
    # Since the loads, one gain has fallen by 3 %.
    aged = real.model_copy(update={"gain": (real.gain[0], real.gain[1] * 0.97, *real.gain[2:])})
    contacts = drawn(model.metadata, aged, Kind(), np.random.default_rng(5), 100)
    second = self_calibrate(model, contacts, silent, Effort(ROUGH))
    vector, calibration = second.found.fit.vector, second.metadata.calibration
    assert missed_mm(nominal, vector, bench.metadata, aged) < 0.4 * missed_mm(nominal, start, bench.metadata, aged)
    assert calibration is not None
    assert (calibration.loads, calibration.contacts) == (10, 100)
    assert calibration.departures.fixity == pytest.approx(departures.fixity)


def test_leverages_leave_out_as_fitting_again_does(bench: ModelFile) -> None:
    rng = np.random.default_rng(2)
    # Few loads, so that each of them bends the fit.
    loads = recorded(bench.metadata, random_imperfections(bench.metadata, rng), rng, count=6)
    nominal = NominalSurface.of(bench.metadata)
    kinds = ("gain", "curve")
    # With the same errors, as each fit would find its own.
    loads = dataclasses.replace(loads, errors=fit(nominal, loads, kinds).errors)
    whole = fit(nominal, loads, kinds, rounds=1)
    for index in (0, 3, 5):
        rest = fit(nominal, loads.without(index), kinds, rounds=1)
        off = Session(nominal, loads).residuals(rest.vector).left_mm[index]
        assert whole.left_out_mm[index] == pytest.approx(off, rel=0.2, abs=0.05 * np.abs(whole.left_out_mm).max())


def test_the_command_prints_the_departures(
    design_sensors_here: Command,
    bench_model: Path,
    recording: Path,
    calibrated: Calibrated,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # The fit was made above; other tests of this command make theirs.
    monkeypatch.setattr("beamtouch_models.commands.calibrate.calibrate", lambda *_given: calibrated)
    output = tmp_path / "real.onnx"
    done = design_sensors_here("calibrate", bench_model, recording, "-o", output, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["model"] == runtime.load(output).identity
    assert found["error_after_mm"]["mean"] < found["error_before_mm"]["mean"]
    assert found["standard_errors"]["gain"]
    assert "fitted   to the real beam, with 10 loads" in design_sensors_here("inspect", output).stdout
    table = design_sensors_here("calibrate", bench_model, recording, "-o", output)
    lines = dict(line.split(maxsplit=1) for line in table.stdout.splitlines())
    assert list(lines) == [
        *("model", "loads", "scale", "gain", "position", "curve", "offset", "fixity", "before", "after", "limit"),
    ]
    assert lines["model"] == found["model"]
    assert [float(number) for number in re.findall(r"s\d (\S+) \+-", lines["gain"])] == pytest.approx(
        [100 * (gain - 1) for gain in found["calibration"]["departures"]["gain"]], abs=0.006
    )


@pytest.mark.promise("docs/reference/loads.md", "and columns are found by name, so their order does not matter.")
def test_a_recording_that_a_spreadsheet_saved_is_read(bench: ModelFile, recording: Path, tmp_path: Path) -> None:
    honest, path = read_loads(recording, bench.metadata), tmp_path / "loads.csv"
    without_time = "".join(line.partition(",")[2] for line in recording.read_text().splitlines(keepends=True))
    path.write_text(without_time, encoding="utf-8-sig")  # with a byte order mark before the first column
    assert np.array_equal(read_loads(path, bench.metadata).measured_mm, honest.measured_mm)
    path.write_text(without_time.replace(",", ", "))
    assert np.array_equal(read_loads(path, bench.metadata).measured_mm, honest.measured_mm)
    # Empty rows, as a sheet has them between two loads and after the last one.
    path.write_text(without_time.replace("2,60.0,", ",,,\n\n2,60.0,", 1) + ",,,,\n")
    found = read_loads(path, bench.metadata)
    assert np.array_equal(found.measured_mm, honest.measured_mm)
    assert found.in_words(1) == "load 2 (lines 204 to 403)"


def test_rows_of_the_newest_characteristic_count_and_each_event_once(bench: ModelFile, tmp_path: Path) -> None:
    measured_mm = np.random.default_rng(2).uniform(0.0, 1.0, (9, 4))
    deviation_mm = np.linspace(0.001, 0.002, 36).reshape(9, 4)
    path = write_contacts(tmp_path / "contacts.csv", bench, measured_mm, deviation_mm)
    head, *rows = path.read_text().splitlines()
    old = [row.replace(",a1,", ",a0,") for row in rows[:4]]
    path.write_text("\n".join([head, *old, *rows[4:], *rows[6:]]))
    found = read_contacts(path, bench.metadata)
    assert (len(found), found.other_characteristic) == (5, 4)
    assert found.measured_mm == pytest.approx(measured_mm[4:], abs=1e-9)
    assert found.deviation_mm == pytest.approx(deviation_mm[4:], abs=1e-9)


@pytest.mark.soak
@pytest.mark.filterwarnings("error")
def test_one_sensor_under_an_open_force_is_calibrated_to_what_it_can_tell() -> None:
    scene = change_scene(load_scene(SCENES / "bench.toml")[0], sensors={"count": 1})
    model = resolve(scene).layout([130.0]).build(effort=0.01)
    loads = recorded(model.metadata, Imperfections(gain=(1.02,)), np.random.default_rng(4))
    fitted = calibrate(model, loads, silent, effort=Effort(0.01))
    floor, before = fitted.metadata.floor, model.metadata.floor
    assert 0 < floor.gain[0] <= 0.05
    assert np.isfinite([*floor.gain, *floor.zero_mm, *before.gain]).all()
