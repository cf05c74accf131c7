"""Calibration that doubts itself: a channel that does not fit, a forgotten weight, drift, and cables swapped since."""

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import runtime
from beamtouch_models.design.calibration.calibrate import CheckedFit, calibrate, checked_fit
from beamtouch_models.design.calibration.recordings import Loads, RecordingError, read_loads
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.sweeps import silent
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.runtime import ModelFile
from models.calibration_files import write_readings
from models.doubtful_recordings import bent_mm, doubtful
from support.programs.in_process import Command
from support.surfaces.deflections import deflections_of
from support.surfaces.example_scenes import ROUGH
from support.surfaces.real_surfaces import random_imperfections, recorded

pytestmark = pytest.mark.long

PLACES_MM, FORCES_N = np.linspace(29.0, 191.0, 10), np.tile([2.25, 1.1], 5)
"""Of ten loads of two forces on the cantilever."""


@pytest.fixture
def cantilever(built_model: Callable[[str], Path]) -> ModelFile:
    return runtime.load(built_model("cantilever"))


def refusal(design_sensors_here: Command, folder: Path, model: Path, loads: Path) -> str:
    """Return the line with which `calibrate` refuses a recording."""
    done = design_sensors_here("calibrate", model, loads, "-o", folder / "out.onnx")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert not (folder / "out.onnx").exists()
    return done.stderr


@pytest.mark.promise(
    "docs/how-to/calibrate.md",
    "one channel bends as no other does: its table, its range, or a curved sensor that is described as straight",
)
def test_a_curved_sensor_that_is_described_as_straight_is_named_with_what_to_do(
    design_sensors_here: Command, built_model: Callable[[str], Path], cantilever: ModelFile, tmp_path: Path
) -> None:
    measured_mm = deflections_of(cantilever, PLACES_MM, FORCES_N)
    measured_mm[:, 2] = bent_mm(measured_mm[:, 2], 0.15)
    path = write_readings(tmp_path / "loads.csv", cantilever, measured_mm, PLACES_MM, FORCES_N)
    line = refusal(design_sensors_here, tmp_path, built_model("cantilever"), path)
    assert "s3 does not fit, as if its characteristic were another" in line
    assert "Check its table, or measure one with feeler gauges" in line
    assert line.count("does not fit") == 1
    figures = re.search(r"where it shows (\S+) mm, the loads say (\S+) mm", line)
    assert figures is not None
    shown, true = (float(number) for number in figures.groups())
    assert shown / true == pytest.approx(1.15, abs=0.04)


@pytest.mark.promise("docs/how-to/calibrate.md", "a hanger or a tray that was not weighed")
def test_a_hanger_that_nobody_weighed_is_named_with_its_weight(
    design_sensors_here: Command, built_model: Callable[[str], Path], cantilever: ModelFile, tmp_path: Path
) -> None:
    measured_mm = deflections_of(cantilever, PLACES_MM, FORCES_N + 0.4)
    path = write_readings(tmp_path / "loads.csv", cantilever, measured_mm, PLACES_MM, FORCES_N)
    line = refusal(design_sensors_here, tmp_path, built_model("cantilever"), path)
    weight = re.search(r"each load seems to press with (\S+) \+- (\S+) N more than it states", line)
    assert weight is not None
    assert float(weight[1]) == pytest.approx(0.4, abs=3 * float(weight[2]))
    assert "add its weight to force_n of each load" in line


def found_in(model: ModelFile, wrong: str, seed: int) -> tuple[CheckedFit, Imperfections]:
    """Return the fit to a recording of a random surface, and that surface."""
    rng = np.random.default_rng([seed, 7])
    real = random_imperfections(model.metadata, rng)
    loads, _ = doubtful(model.metadata, real, wrong, rng)
    return checked_fit(model, loads, silent), real


@pytest.mark.promise("docs/how-to/calibrate.md", "and the stated errors hold what that leaves open")
@pytest.mark.parametrize("wrong", [pytest.param("none", marks=pytest.mark.soak), "drift"])
def test_stated_intervals_of_the_sensors_places_hold_the_truth(wrong: str, cantilever: ModelFile) -> None:
    held = list[bool]()
    for seed in range(4):
        found, real = found_in(cantilever, wrong, seed)
        errors_mm = found.fit.nominal.standard_errors(found.fit.vector, found.fit.spread)["position"]
        off_mm = np.array(found.fit.departures.position_offset_mm) - np.array(real.position_offset_mm)
        held += (np.abs(off_mm) < 2 * errors_mm).tolist()
    assert np.mean(held) > 0.9


@pytest.mark.promise(
    "docs/how-to/calibrate.md",
    "Zeros that drift while you record are fitted with the times of the loads.",
)
@pytest.mark.promise(
    "docs/reference/loads.md",
    "if each row has it, the drift of the zeros during the recording is fitted",
)
def test_drift_during_the_session_is_fitted_with_the_times_of_the_loads(cantilever: ModelFile) -> None:
    metadata, rng = cantilever.metadata, np.random.default_rng(3)
    loads = recorded(metadata, random_imperfections(metadata, rng), rng)
    rates = np.array([4.0, 6.0, 3.0])
    drifted_mm = loads.measured_mm + 1e-3 * rates * loads.minutes[:, None]
    found = checked_fit(cantilever, dataclasses.replace(loads, measured_mm=drifted_mm), silent).fit
    assert found.session.rates_um_per_min(found.vector) == pytest.approx(rates, abs=0.5)


def test_the_times_of_a_recording_are_those_of_its_loads(cantilever: ModelFile, tmp_path: Path) -> None:
    measured_mm = deflections_of(cantilever, PLACES_MM, FORCES_N)
    path = write_readings(tmp_path / "loads.csv", cantilever, measured_mm, PLACES_MM, FORCES_N)
    text = re.sub(r"(?m)^0\.0,(\d+),", lambda row: f"{1.7e9 + 30 * int(row[1])},{row[1]},", path.read_text())
    path.write_text(text)
    assert read_loads(path, cantilever.metadata).minutes == pytest.approx(np.arange(10) / 2)
    # Typed by hand, one has no time.
    path.write_text(text.replace("1700000060.0,2,", ",2,", 1))
    assert not read_loads(path, cantilever.metadata).minutes.any()


def swapped_since_the_tare(loads: Loads, rest_mm: float) -> Loads:
    """Return loads of three channels whose outer cables were swapped after the tare, with rest gaps that differ."""
    swapped_mm = loads.measured_mm[:, ::-1] + rest_mm * np.array([1.0, 0.0, -1.0])
    return dataclasses.replace(loads, measured_mm=swapped_mm)


@pytest.mark.promise("docs/how-to/calibrate.md", "two cables, also if they were swapped after the tare")
def test_cables_that_were_swapped_since_the_tare_are_named_where_rest_gaps_differ(cantilever: ModelFile) -> None:
    rng = np.random.default_rng(4)
    loads = recorded(cantilever.metadata, random_imperfections(cantilever.metadata, rng), rng)
    for rest_mm in (0.0, 0.3, -1.0):
        with pytest.raises(RecordingError, match="s1 and s3 seem to be swapped; check the wiring"):
            checked_fit(cantilever, swapped_since_the_tare(loads, rest_mm), silent)


@pytest.mark.promise("docs/how-to/calibrate.md", "a knock, or a load that lay on the beam at the tare")
def test_zeros_that_moved_far_since_the_tare_are_named(cantilever: ModelFile) -> None:
    rng = np.random.default_rng(4)
    loads = recorded(cantilever.metadata, random_imperfections(cantilever.metadata, rng), rng)
    moved = dataclasses.replace(loads, measured_mm=loads.measured_mm + np.array([0.0, 0.3, 0.0]))
    with pytest.raises(RecordingError, match=r"zeros have moved since the tare: s2 by 0\.3\d* mm; tare with nothing"):
        checked_fit(cantilever, moved, silent)


def test_what_zeros_drifted_while_loads_were_recorded_is_in_the_floor(cantilever: ModelFile) -> None:
    metadata, rng = cantilever.metadata, np.random.default_rng(3)
    loads = recorded(metadata, random_imperfections(metadata, rng), rng)
    drift_mm = 1e-3 * np.array([4.0, 6.0, 3.0]) * loads.minutes[:, None]
    moved = dataclasses.replace(loads, measured_mm=loads.measured_mm + drift_mm)
    floor = calibrate(cantilever, moved, silent, effort=Effort(ROUGH)).metadata.floor
    assert (np.array(floor.zero_mm) > 0.9 * drift_mm.max(axis=0)).all()
