"""Recordings of known loads: accepted and refused files."""

import re
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.calibration.recordings import RecordingError, read_loads
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.rig.surface import Imperfections
from imperfect_surface import readings
from in_process import Command


def test_a_recording_that_a_spreadsheet_saved_is_read(bench: ModelFile, tmp_path: Path) -> None:
    path = readings(tmp_path, bench, Imperfections())
    honest = read_loads(path, bench.metadata)
    without_time = "".join(line.partition(",")[2] for line in path.read_text().splitlines(keepends=True))
    path.write_text(without_time, encoding="utf-8-sig")  # with a byte order mark before the first column
    assert np.array_equal(read_loads(path, bench.metadata).measured_mm, honest.measured_mm)
    path.write_text(without_time.replace(",", ", "))
    assert np.array_equal(read_loads(path, bench.metadata).measured_mm, honest.measured_mm)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda text: re.sub(r"([-\d.e]+),good", lambda cell: f"{-float(cell[1])},good", text),
            "deflections are -1 times what the model expects: a deflection is positive in the direction of the load",
        ),
        (
            lambda text: text.replace(".0,12.0,", ".0,1.2232,"),  # in kg
            "deflections are 9.8 times what the model expects: check the units of deflections and forces (1 kg weighs",
        ),
    ],
)
def test_a_recording_that_is_wrong_by_a_factor_is_refused_with_the_factor(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, tmp_path: Path, change: object, said: str
) -> None:
    # Few loads, as each is left out in turn.
    path = readings(tmp_path, bench, Imperfections(), position=np.linspace(20.0, 380.0, 5), force=np.full(5, 12.0))
    assert callable(change)
    path.write_text(change(path.read_text()))
    done = design_sensors_here("calibrate", bench_model, path, "-o", tmp_path / "out.onnx")
    assert (done.returncode, done.stdout) == (1, "")
    assert said in done.stderr


def test_a_load_number_that_was_used_twice_is_refused(bench: ModelFile, tmp_path: Path) -> None:
    path = readings(tmp_path, bench, Imperfections())
    path.write_text(path.read_text().replace("0.0,2,60.0,12.0", "0.0,1,60.0,12.0"))
    with pytest.raises(RecordingError, match=r"load 1 has a position_mm of 20 in line 2 and of 60 in line 202"):
        read_loads(path, bench.metadata)


def without_most_of_load_3(text: str) -> str:
    """The recording with four samples of its third load."""
    lines = text.splitlines(keepends=True)
    return "".join([*lines[:405], *lines[601:]])


def once_each(text: str) -> str:
    """The recording with one sample of each load, as somebody types it who does not know better."""
    head, *rows = text.splitlines()
    return "\n".join([head, *rows[::200]])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda text: text.replace("s3_deflection_mm", "s9_deflection_mm"),
            "s3_deflection_mm is missing; this model needs",
        ),
        (
            lambda text: text.replace(",", ";").replace(".", ","),
            "semicolons separate the columns; separate them",
        ),
        (lambda text: text.replace(",", "\t"), "tabs separate the columns"),
        (once_each, "no load has 5 good samples of a channel; each load needs 5 rows or more"),
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


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "No such file or directory"), (b"\xff\xfe\x00load", "not a CSV file"), (b"", "no samples; record loads")],
)
def test_a_recording_that_cannot_be_read_is_refused(
    design_sensors_here: Command, bench_model: Path, tmp_path: Path, content: bytes | None, said: str
) -> None:
    path = tmp_path / "loads.csv"
    if content is not None:
        path.write_bytes(content)
    done = design_sensors_here("calibrate", bench_model, path, "-o", tmp_path / "out.onnx")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert f"{path}: {said}" in done.stderr
