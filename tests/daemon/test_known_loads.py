"""Known loads: what is taken for one, and the file that `calibrate` reads."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from beamtouch_common.errors import FailedError, InputError
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.known_loads import Load, LoadFile, parse_load
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Quality, Sample

from .surfaces import surface_of

BEAM = surface_of(loads={"position_mm": [25.0, 400.0], "max_force_n": 20.0})
PLATE = surface_of(loads={"x_mm": [10.0, 400.0], "y_mm": [20.0, 300.0], "max_force_n": 20.0})
ANY = surface_of()


@pytest.mark.parametrize(
    ("surface", "words", "load"),
    [
        (BEAM, ["25", "20"], Load((25.0,), 20.0)),
        (BEAM, ["400", "0,5"], Load((400.0,), 0.5)),
        (PLATE, ["10", "300", "7.5"], Load((10.0, 300.0), 7.5)),
        (ANY, ["0", "1e6"], Load((0.0,), 1e6)),
    ],
)
def test_a_load_is_a_place_and_a_force_within_the_limits(surface: Surface, words: list[str], load: Load) -> None:
    assert parse_load(words, surface, is_accepted=False) == load


BEAM_WORDS = "give two numbers: the position in mm from the left end, and the force in N, as in 150 10"
PLATE_WORDS = "give three numbers: x and y in mm from the corner, and the force in N, as in 150 80 10"


@pytest.mark.parametrize(
    ("surface", "words", "said"),
    [
        *((BEAM, words.split(), BEAM_WORDS) for words in ("", "150", "150 10 3", "150 ten")),
        *((PLATE, words.split(), PLATE_WORDS) for words in ("", "150 10", "1 2 3 4")),
        (ANY, ["-1", "10"], "a position of -1 mm is not on the beam; count from its left end"),
        (ANY, ["inf", "10"], "a position of inf mm is not on the beam; count from its left end"),
        (ANY, ["nan", "10"], "a position of nan mm is not on the beam; count from its left end"),
        (PLATE, ["30", "-2", "10"], "y = -2 mm is not on the plate; count from its lower left corner"),
        (BEAM, ["24.9", "10"], "24.9 mm is not within 25 to 400 mm, the range that the model covers"),
        (BEAM, ["400.1", "10"], "400.1 mm is not within 25 to 400 mm, the range that the model covers"),
        (PLATE, ["30", "300.5", "10"], "y = 300.5 mm is not within 20 to 300 mm, the range that the model covers"),
        (PLATE, ["9.5", "30", "10"], "x = 9.5 mm is not within 10 to 400 mm, the range that the model covers"),
        (BEAM, ["150", "0"], "a force of 0 N is no load; give newtons (1 kg weighs 9.81 N)"),
        (ANY, ["150", "inf"], "a force of inf N is no load; give newtons (1 kg weighs 9.81 N)"),
        (BEAM, ["150", "20.5"], "20.5 N is more than 20 N, the largest force that the model covers"),
    ],
)
def test_what_is_no_load_is_said(surface: Surface, words: list[str], said: str) -> None:
    with pytest.raises(ValueError, match=r".") as raised:
        parse_load(words, surface, is_accepted=False)
    assert str(raised.value) == said


def test_a_load_that_is_accepted_may_be_outside_the_limits_but_not_off_the_beam() -> None:
    load = parse_load(["500", "90"], BEAM, is_accepted=True)
    assert (load, load.is_accepted) == (Load((500.0,), 90.0), True)
    for words in (["-1", "10"], ["150", "-10"]):
        with pytest.raises(ValueError, match="is no"):
            parse_load(words, BEAM, is_accepted=True)


def test_a_load_is_named_by_its_force_and_its_place() -> None:
    assert str(Load((150.0, 80.5), 7.5)) == "7.5 N at 150, 80.5 mm"


def sample(counts: Sequence[float | None], values: Sequence[float | None]) -> TimedSample:
    quality = [Quality.MISSING if value is None else Quality.GOOD for value in values]
    taken = Sample.model_validate(
        {"sequence": 1, "acquired_unix_us": 1_700_000_000_250_000, "deflection_mm": values, "quality": quality}
    )
    return TimedSample(Reading(0.0, tuple(counts)), taken)


ONE = sample([20_345.0, 19_000.5], [0.0345678, -0.00000001])
NONE = sample([None, 7.0], [None, 2.5])


def test_the_file_has_a_row_for_each_sample_with_counts_deflection_and_quality(tmp_path: Path) -> None:
    file = LoadFile(tmp_path / "loads.csv", PLATE, append=False)
    assert (str(file), file.loads, file.path.exists()) == ("no load is recorded", 0, False)
    file.write(Load((150.0, 80.5), 7.5), [ONE, NONE])
    file.write(Load((30.0, 40.0), 3.0), [ONE])
    assert file.path.read_text() == (
        "unix_time_s,load,x_mm,y_mm,force_n,s1_counts,s1_deflection_mm,s1_quality,s2_counts,s2_deflection_mm,"
        "s2_quality\n"
        "1700000000.250000,1,150.0,80.5,7.5,20345,0.034568,good,19000.5,0.000000,good\n"
        "1700000000.250000,1,150.0,80.5,7.5,,,missing,7,2.500000,good\n"
        "1700000000.250000,2,30.0,40.0,3.0,20345,0.034568,good,19000.5,0.000000,good\n"
    )
    assert str(file) == f"2 loads are in {file.path}"


def test_values_in_another_unit_have_nine_digits_and_their_column_names_it(tmp_path: Path) -> None:
    file = LoadFile(tmp_path / "loads.csv", surface_of(2, {"value_unit": "uT"}), append=False)
    file.write(Load((150.0,), 7.5), [sample([1.0, 2.0], [1234.56789012, -0.000123456789012])])
    head, row = file.path.read_text().splitlines()
    assert head.split(",")[5] == "s1_deflection_uT"
    assert row.split(",")[5::3] == ["1234.56789", "-0.000123456789"]


def test_the_load_that_was_added_last_can_be_removed_up_to_the_first_one(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    LoadFile(path, BEAM, append=False).write(Load((50.0,), 5.0), [ONE])
    before = path.read_bytes()
    file = LoadFile(path, BEAM, append=True)
    assert (file.loads, file.remove_last()) == (1, None)
    loads = [Load((100.0,), 6.0), Load((200.0,), 7.0)]
    for load in loads:
        file.write(load, [ONE, NONE])
    assert [row.split(",")[1] for row in path.read_text().splitlines()[1:]] == ["1", "2", "2", "3", "3"]
    assert [file.remove_last(), file.loads, file.remove_last(), file.loads] == [loads[1], 2, loads[0], 1]
    assert (path.read_bytes(), file.remove_last()) == (before, None)


def test_without_a_load_there_is_no_file(tmp_path: Path) -> None:
    file = LoadFile(tmp_path / "loads.csv", BEAM, append=True)
    file.write(Load((50.0,), 5.0), [ONE])
    file.remove_last()
    assert (file.path.exists(), file.loads) == (False, 0)


@pytest.mark.parametrize(
    ("content", "append", "said"),
    [
        ("load\n", False, "already exists; add --append or name another file"),
        ("load\n", True, "its columns are not those of this surface; write to another file"),
        ("HEADER", True, "not a recording; write to another file"),  # it broke off
        ("HEADER\n1.5,1,50\n", True, "not a recording; write to another file"),
        ("HEADER\n1.5,one,50.0,5.0,1,1,good,1,1,good\n", True, "not a recording; write to another file"),
    ],
)
def test_a_file_that_is_no_recording_of_the_surface_is_refused(
    tmp_path: Path, content: str, append: bool, said: str
) -> None:
    path = tmp_path / "loads.csv"
    header = (
        "unix_time_s,load,position_mm,force_n,s1_counts,s1_deflection_mm,s1_quality,s2_counts,s2_deflection_mm,"
        "s2_quality"
    )
    path.write_text(content.replace("HEADER", header))
    with pytest.raises(InputError) as raised:
        LoadFile(path, BEAM, append=append)
    assert str(raised.value) == f"{path}: {said}"
    path.write_text(f"{header}\n1.5,4,50.0,5.0,1,1,good,1,1,good\n1.5,3,50.0,5.0,1,1,good,1,1,good\n")
    assert LoadFile(path, BEAM, append=True).loads == 4
    path.write_text(f"{header}\n")
    assert LoadFile(path, BEAM, append=True).loads == 0


def test_a_load_that_cannot_be_written_whole_leaves_the_file_as_it_was(tmp_path: Path) -> None:
    file = LoadFile(tmp_path / "loads.csv", BEAM, append=False)
    file.write(Load((50.0,), 5.0), [ONE])
    before = file.path.read_bytes()

    class Interrupting(float):
        """A force that is written once; then somebody presses Ctrl-C."""

        is_written = False

        def __repr__(self) -> str:
            if self.is_written:
                raise KeyboardInterrupt
            self.is_written = True
            return "6.0"

    with pytest.raises(KeyboardInterrupt):
        file.write(Load((60.0,), Interrupting(6.0)), [ONE] * 2)
    assert (file.path.read_bytes(), file.loads, file.remove_last()) == (before, 1, Load((50.0,), 5.0))
    with pytest.raises(KeyboardInterrupt):
        file.write(Load((60.0,), Interrupting(6.0)), [ONE] * 2)
    assert not file.path.exists()
    file.path.mkdir()
    with pytest.raises(FailedError) as raised:
        file.write(Load((60.0,), 6.0), [ONE])
    assert str(raised.value) == f"{file.path}: Is a directory; no load is recorded"
