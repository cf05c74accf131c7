"""Files of contacts of unknown place and force: the rows that count, and what is refused in one line."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from beamtouch_models.calibration.recordings import MAX_BYTES, UnlabelledContacts, read_contacts
from beamtouch_models.calibration.self_calibrate import MIN_CONTACTS
from beamtouch_models.loading import load
from beamtouch_models.modelfile import ModelFile
from in_process import Command
from unlabelled_contacts import OFF, drawn, surface, write_contacts


def test_rows_of_the_newest_characteristic_count_and_each_event_once(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, tmp_path: Path
) -> None:
    real = surface(bench.metadata, OFF, np.random.default_rng(1))
    contacts = drawn(bench.metadata, real, OFF, np.random.default_rng(2), 9)
    path = write_contacts(tmp_path / "contacts.csv", bench, contacts)
    head, *rows = path.read_text().splitlines()
    old = [row.replace(",a1,", ",a0,") for row in rows[:4]]
    path.write_text(
        "\n".join([f"{head},s1_rest_mm,s1_rest_sd_mm", *(f"{row},," for row in [*old, *rows[4:], *rows[6:]])])
    )
    done = design_sensors_here("calibrate", bench_model, "--events", path, "-o", tmp_path / "new.onnx")
    assert "4 contacts with an older characteristic are left out; the newest 5 are used" in done.stderr
    found = read_contacts(path, bench.metadata)
    assert (len(found), found.other_characteristic) == (5, 4)
    assert found.measured_mm == pytest.approx(contacts.measured_mm[4:], abs=1e-9)
    assert found.deviation_mm == pytest.approx(contacts.deviation_mm[4:], abs=1e-9)


def _with_rests(path: Path, rest_mm: NDArray[np.floating], deviation_mm: float) -> Path:
    """Add rests (contacts, channels) to a file of contacts."""
    head, *rows = path.read_text().splitlines()
    names = [f"s{channel + 1}_rest_{end}mm" for end in ("", "sd_") for channel in range(rest_mm.shape[1])]
    cells = [[f"{value:.9f}" for value in [*each, *[deviation_mm] * len(each)]] for each in rest_mm]
    path.write_text(
        "\n".join(",".join(row) for row in zip([head, *rows], [",".join(one) for one in [names, *cells]], strict=True))
    )
    return path


def test_contacts_whose_zeros_moved_are_told(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, tmp_path: Path
) -> None:
    real, rng = surface(bench.metadata, OFF, np.random.default_rng(1)), np.random.default_rng(2)
    # Too few to be used, so that it is quick.
    contacts = drawn(bench.metadata, real, OFF, rng, 11)
    zero_mm, deviation_mm = np.array(bench.metadata.floor.zero_mm), 3 * bench.metadata.floor.zero_mm[1]
    for moved, named in ((0.0, False), (60.0, True)):
        rest_mm = rng.normal(scale=deviation_mm, size=contacts.measured_mm.shape)
        rest_mm[6:, 1] += moved * zero_mm[1]
        path = _with_rests(write_contacts(tmp_path / "contacts.csv", bench, contacts), rest_mm, deviation_mm)
        done = design_sensors_here("calibrate", bench_model, "--events", path, "-o", tmp_path / "new.onnx")
        assert done.returncode == 1
        assert ("the zeros of s2 moved" in done.stderr) is named
        assert ("?since=" in done.stderr) is named


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda _text: "", "column event is missing"),
        (lambda text: text.splitlines()[0], "no contacts"),
        (lambda text: text.replace("s3_sd_mm", "other"), "column s3_sd_mm is missing"),
        (lambda text: text.replace("s4_mm", "s5_mm").replace("s4_sd", "s5_sd"), "column s4_mm is missing"),
        (lambda text: _with_column(text, "s5"), "a channel s5, which this model has not"),
        (lambda text: _with_column(text, "s1_rest", "inf"), "line 2: the rest before it is larger than any deflection"),
        (lambda text: text.replace("bench@", "press@"), "line 2: it is of the model press@"),
        (lambda text: text.replace("2026-11-22T00:00:01.000Z", "yesterday"), "line 2: a value is missing, or not a"),
        (lambda text: text.replace(".000Z", ".000"), "has no zone"),
        (lambda text: _with_first(text, "nan"), "line 2: s1 must have a finite deflection"),
        (lambda text: _with_first(text, "inf"), "line 2: s1 must have a finite deflection"),
        (lambda text: _with_first(text, ""), "line 2: a value is missing, or not a"),
        (lambda text: _with_first(text, "12000"), "check the unit"),
        (lambda text: text.rsplit(",", 1)[0] + ",0", "positive finite deviation"),
        (lambda text: text.rsplit(",", 1)[0], "a value is missing, or not a"),
        (lambda text: "\0" + text, "column event is missing"),
    ],
)
def test_wrong_files_are_refused_in_one_line(
    design_sensors_here: Command,
    bench_model: Path,
    bench: ModelFile,
    tmp_path: Path,
    change: Callable[[str], str],
    reason: str,
) -> None:
    path = write_contacts(
        tmp_path / "contacts.csv", bench, UnlabelledContacts(np.full((3, 4), 0.1), np.full((3, 4), 0.001))
    )
    path.write_text(change(path.read_text().replace("\r", "").rstrip("\n")))
    done = design_sensors_here("calibrate", bench_model, "--events", path, "-o", tmp_path / "new.onnx")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert f"{path}: " in done.stderr
    assert reason in done.stderr
    assert not (tmp_path / "new.onnx").exists()


def test_deviations_that_no_sensor_has_end_in_words(
    design_sensors_here: Command, built_model: Callable[[str], Path], tmp_path: Path
) -> None:
    model = load(built_model("paper"))
    real = surface(model.metadata, OFF, np.random.default_rng(1))
    contacts = drawn(model.metadata, real, OFF, np.random.default_rng(2), MIN_CONTACTS)
    path = write_contacts(tmp_path / "contacts.csv", model, contacts)
    deviation = f",{contacts.deviation_mm[0, 0]:.9f},{contacts.deviation_mm[0, 1]:.9f}"
    text = path.read_text()
    assert text.count(deviation) == MIN_CONTACTS
    path.write_text(text.replace(deviation, ",1e-300,1e-300"))
    done = design_sensors_here("calibrate", built_model("paper"), "--events", path, "-o", tmp_path / "new.onnx")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert "the contacts do not fit this model's surface" in done.stderr


def _with_first(text: str, value: str) -> str:
    """Put a value into the first deflection."""
    return text.replace(",4,0.100000000,", f",4,{value},", 1)


def _with_column(text: str, channel: str, value: str = "0.1") -> str:
    head, *rows = text.splitlines()
    return "\n".join([f"{head},{channel}_mm,{channel}_sd_mm", *(f"{row},{value},0.001" for row in rows)])


def test_a_file_that_cannot_be_read_is_refused(design_sensors_here: Command, bench_model: Path, tmp_path: Path) -> None:
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    with (tmp_path / "large").open("wb") as file:
        file.truncate(MAX_BYTES + 1)  # a hole, which takes no room on the disk
    for name, said in (
        ("binary", ""),
        ("missing", "No such file"),
        ("large", "larger than 64 MiB; fetch fewer contacts, with ?limit="),
    ):
        done = design_sensors_here("calibrate", bench_model, "--events", tmp_path / name, "-o", tmp_path / "new.onnx")
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert said in done.stderr
