"""Files for `calibrate`: recordings of known loads, and contacts of unknown place and force; what is refused."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import load_model
from beamtouch_models.arrays import Floats
from beamtouch_models.runtime import ModelFile
from models.calibration_files import write_contacts, write_readings
from support.programs.in_process import Command, Outcome, Refusal
from support.surfaces.deflections import deflections_of
from support.surfaces.real_surfaces import FORCES, POSITIONS

Calibrate = Callable[..., Outcome]
MAX_BYTES = 64 * 2**20
"""The largest file that is read."""
MIN_CONTACTS = 12
"""With fewer contacts, there is no fit."""


def off_contacts(model: ModelFile, count: int) -> tuple[Floats, Floats]:
    """Return contacts over the ranges of a model on sensors whose gains are off by 2 %, and their deviations."""
    ranges, rng = model.metadata.ranges, np.random.default_rng(2)
    clean_mm = deflections_of(model, rng.uniform(*ranges.position_mm, count), rng.uniform(*ranges.force_n, count))
    deviation_mm = np.full(clean_mm.shape, model.metadata.noise.sample_mm)
    gain = 1 + 0.02 * rng.normal(size=len(model.channels))
    return gain * clean_mm + deviation_mm * rng.normal(size=clean_mm.shape), deviation_mm


@pytest.fixture
def calibrate(design_sensors_here: Command, bench_model: Path, tmp_path: Path) -> Calibrate:
    """`design-sensors calibrate` of the bench, which writes `new.onnx`."""

    def run(*given: object) -> Outcome:
        return design_sensors_here("calibrate", bench_model, *given, "-o", tmp_path / "new.onnx")

    return run


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
    calibrate: Calibrate, bench: ModelFile, tmp_path: Path, change: Callable[[str], str], said: str
) -> None:
    # Few loads, as each is left out in turn.
    some = np.linspace(20.0, 380.0, 5), np.full(5, 12.0)
    path = write_readings(tmp_path / "loads.csv", bench, deflections_of(bench, *some), *some)
    path.write_text(change(path.read_text()))
    done = calibrate(path)
    assert (done.returncode, done.stdout) == (1, "")
    assert said in done.stderr


def test_contacts_of_an_older_characteristic_are_left_out(
    calibrate: Calibrate, bench: ModelFile, tmp_path: Path
) -> None:
    path = write_contacts(tmp_path / "contacts.csv", bench, *off_contacts(bench, 9))
    head, *rows = path.read_text().splitlines()
    rows[:4] = [f"{row.replace(',a1,', ',a0,')}" for row in rows[:4]]
    path.write_text("\n".join([f"{head},s1_rest_mm,s1_rest_sd_mm", *(f"{row},," for row in rows)]))
    done = calibrate("--events", path)
    assert "4 contacts with an older characteristic are left out; the newest 5 are used" in done.stderr
    assert "5 contacts are too few" in done.stderr


@pytest.mark.promise(
    "docs/how-to/calibrate-without-loads.md",
    "If the rests between the contacts show that a zero moved, one line says so",
)
def test_contacts_that_are_too_few_write_nothing_and_those_whose_zeros_moved_are_told(
    calibrate: Calibrate, bench: ModelFile, tmp_path: Path
) -> None:
    rng, floor_mm = np.random.default_rng(2), bench.metadata.floor.zero_mm[1]
    path = write_contacts(tmp_path / "contacts.csv", bench, *off_contacts(bench, MIN_CONTACTS - 1))
    head, *rows = path.read_text().splitlines()
    names = [f"s{channel}_rest_{end}mm" for end in ("", "sd_") for channel in (1, 2, 3, 4)]
    for moved, named in ((0.0, False), (60.0, True)):
        rest_mm = rng.normal(scale=3 * floor_mm, size=(MIN_CONTACTS - 1, 4))
        rest_mm[6:, 1] += moved * floor_mm
        rests = [",".join(f"{value:.9f}" for value in [*each, *[3 * floor_mm] * 4]) for each in rest_mm]
        cells = zip([head, *rows], [",".join(names), *rests], strict=True)
        path.write_text("\n".join(",".join(row) for row in cells))
        done = calibrate("--events", path)
        assert (done.returncode, done.stdout) == (1, "")
        assert "11 contacts are too few" in done.stderr
        assert ("the zeros of s2 moved" in done.stderr) is ("?since=" in done.stderr) is named
        assert not (tmp_path / "new.onnx").exists()


Change = Callable[[str], str]


def substituted(pattern: str, replacement: str) -> Change:
    """Return what changes all parts of a text that a pattern matches; ^ and $ are the ends of its lines."""
    return lambda text: re.sub(pattern, replacement, text, flags=re.MULTILINE)


def with_first(value: str) -> Change:
    """Return what puts a value into the first deflection of a file of contacts."""
    return lambda text: text.replace(",4,0.100000000,", f",4,{value},", 1)


def with_column(channel: str, value: str = "0.1") -> Change:
    """Return what adds a channel to a file of contacts."""

    def change(text: str) -> str:
        head, *rows = text.splitlines()
        return "\n".join([f"{head},{channel}_mm,{channel}_sd_mm", *(f"{row},{value},0.001" for row in rows)])

    return change


def once_each(text: str) -> str:
    """The recording with one sample of each load, as somebody types it who does not know better."""
    head, *rows = text.splitlines()
    return "\n".join([head, *rows[::200]])


LOADS: list[tuple[Change, str]] = [
    (
        lambda text: text.replace("s3_deflection_mm", "s9_deflection_mm"),
        "s3_deflection_mm is missing; this model needs",
    ),
    (lambda text: text.replace(",", ";").replace(".", ","), "semicolons separate the columns; separate them"),
    (lambda text: text.replace(",", "\t"), "tabs separate the columns"),
    (once_each, "no load has 5 good samples of a channel; each load needs 5 rows or more"),
    (lambda text: text.splitlines()[0], "no samples; record loads"),
    (lambda text: text.replace(",20.0,12.0,", ",20.0,-1,"), "has a force of -1 N"),
    (lambda text: text.replace(",20.0,12.0,", ",20.0,1e300,"), "load 1 (lines 2 to 201) has a force of 1e+300 N"),
    (lambda text: text.replace(",20.0,12.0,", ",20.0,5e-324,"), "load 1 (lines 2 to 201) has a force of 4.94"),
    (substituted(r"^(0.0,2,60.0,12.0,1000,)[^,]*", r"\g<1>1e308"), "s1 states 1e+308 mm in line 202"),
    (substituted(r"([^,]*),good$", r"\g<1>e5,good"), "s4 states "),
    (lambda text: text.replace(",20.0,12.0,", ",900.0,12.0,"), "is not within 1..399 mm"),
    (lambda text: text.replace(",60.0,12.0,", ",60 mm,12.0,"), "line 202: position_mm states '60 mm', which is not a"),
    (lambda text: text.replace(",60.0,12.0,", ",60.0,,"), "line 202: force_n is empty; write 12.5, without a unit"),
    (lambda text: text.replace(",60.0,12.0,", ',60.0,"12,0",'), "line 202: force_n states '12,0', which is not a"),
    (
        lambda text: text.replace(",60.0,12.0,", ",60.0,12,0,"),
        "line 202 has 17 values in 16 columns; write decimals with",
    ),
    (
        lambda text: text.replace("0.0,2,60.0,12.0", "\n0.0,2.5,60.0,12.0", 1),
        "line 203: load is 2.5; number the loads 1,",
    ),
    (lambda text: text.replace("force_n", "position_mm"), "two columns are named position_mm; take one out"),
    (lambda text: f"# the first bench\n{text}", "column load is missing"),
    (lambda text: f"\n{text}", "column load is missing"),
    (lambda text: "\n".join(text.splitlines()[:601]), "cannot determine a fit"),
    (
        lambda text: text.replace("0.0,2,60.0,12.0", "0.0,1,60.0,12.0"),
        "load 1 has a position_mm of 20 in line 2 and of 60 in line 202",
    ),
    (substituted(r"(.*,[\d.-]+),good", r"\1,stuck"), "s4 has no good samples"),
    # Load 3 has four samples; without its channels or with all of them stuck, it can be left out.
    (
        lambda text: "\n".join(text.splitlines()[:405] + text.splitlines()[601:]),
        "load 3 (lines 402 to 405) has fewer than 5 good samples of each",
    ),
    (
        lambda text: re.sub(r"(?m)^(0.0,3,.*)$", lambda row: row[0].replace("good", "stuck"), text),
        "--leave-out 3\n",
    ),
    (substituted(r"^(0.0,3,(?:[^,]*,){3}).*$", r"\1"), "load 3 (lines 402 to 601) has fewer than"),
]
CONTACTS: list[tuple[Change, str]] = [
    (lambda _text: "", "column event is missing"),
    (lambda text: text.splitlines()[0], "no contacts"),
    (lambda text: text.replace("s3_sd_mm", "other"), "column s3_sd_mm is missing"),
    (with_column("s5"), "a channel s5, which this model has not"),
    (with_column("s1_rest", "inf"), "line 2: the rest before it is larger than any deflection"),
    (lambda text: text.replace("bench@", "press@"), "line 2: it is of the model press@"),
    (lambda text: text.replace("2026-11-22T00:00:01.000Z", "yesterday"), "line 2: a value is missing, or not a"),
    (lambda text: text.replace(".000Z", ".000"), "has no zone"),
    (with_first("nan"), "line 2: s1 must have a finite deflection"),
    (with_first("inf"), "line 2: s1 must have a finite deflection"),
    (with_first(""), "line 2: a value is missing, or not a"),
    (with_first("12000"), "check the unit"),
    (lambda text: text.rsplit(",", 1)[0] + ",0", "positive finite deviation"),
    (lambda text: text.rsplit(",", 1)[0], "a value is missing, or not a"),
    (lambda text: "\0" + text, "not a CSV file: not a text file in UTF-8"),
]


@pytest.mark.promise("docs/reference/loads.md", "A load that breaks a rule is named with its lines.")
@pytest.mark.parametrize(
    ("option", "change", "said"),
    [
        *(((), *one) for one in LOADS),
        (("--leave-out", "99"), str, "no load 99 to leave out; the loads are 1, 2, "),
        *((("--events",), *one) for one in CONTACTS),
    ],
)
def test_an_unusable_file_is_refused_in_one_line(
    refused: Refusal,
    bench_model: Path,
    bench: ModelFile,
    tmp_path: Path,
    option: tuple[str, ...],
    change: Change,
    said: str,
) -> None:
    path = tmp_path / "file.csv"
    if "--events" in option:
        write_contacts(path, bench, np.full((3, 4), 0.1), np.full((3, 4), 0.001))
    else:
        write_readings(path, bench, deflections_of(bench, POSITIONS, FORCES))
    path.write_text(change(path.read_text().rstrip("\n")))
    given = (path, *option) if "--leave-out" in option else (*option, path)
    line = refused("calibrate", bench_model, *given, "-o", tmp_path / "new.onnx")
    assert f"{path}: " in line
    assert said in line
    assert not (tmp_path / "new.onnx").exists()


@pytest.mark.parametrize(
    ("option", "content", "said"),
    [
        ((), None, "No such file or directory"),
        ((), b"\xff\xfe\x00load", "not a CSV file: not a text file in UTF-8"),
        ((), "load,position_mm\n".encode("utf-16"), "not a CSV file: in UTF-16, not in UTF-8; save it as UTF-8"),
        (
            (),
            "load,Gr\u00f6\u00dfe\n".encode("cp1252"),
            "not a CSV file: in Windows-1252 (ANSI), not in UTF-8 (line 1); ",
        ),
        ((), b"", "no samples; record loads"),
        (("--events",), bytes(range(256)), ""),
        (("--events",), MAX_BYTES + 1, "it is larger than 64 MiB; fetch fewer contacts, with ?limit="),
    ],
)
def test_a_file_that_cannot_be_read_is_refused(
    refused: Refusal,
    bench_model: Path,
    tmp_path: Path,
    option: tuple[str, ...],
    content: bytes | int | None,
    said: str,
) -> None:
    path = tmp_path / "file.csv"
    if isinstance(content, int):
        with path.open("wb") as file:
            file.truncate(content)  # a hole, which takes no room on the disk
    elif content is not None:
        path.write_bytes(content)
    assert f"{path}: {said}" in refused("calibrate", bench_model, *option, path, "-o", tmp_path / "new.onnx")


def test_deviations_that_no_sensor_has_end_in_words(
    design_sensors_here: Command, built_model: Callable[[str], Path], tmp_path: Path
) -> None:
    model = load_model(built_model("paper"))
    measured_mm, _ = off_contacts(model, MIN_CONTACTS)
    path = write_contacts(tmp_path / "contacts.csv", model, measured_mm, np.zeros_like(measured_mm))
    path.write_text(path.read_text().replace(",0.000000000,0.000000000", ",1e-300,1e-300"))
    done = design_sensors_here("calibrate", built_model("paper"), "--events", path, "-o", tmp_path / "new.onnx")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert "the contacts do not fit this model's surface" in done.stderr
