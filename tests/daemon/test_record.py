"""`record`: known loads to a CSV file, from the command line, over a real socket."""

import asyncio
import os
import subprocess
import sys
from pathlib import Path

import pytest
from pymodbus.constants import ExcCodes

from support.surfaces import configs

from .conftest import Refused
from .devices import pymodbus_server
from .process import command
from .recording import DOWN, LIMITS, PLATE_LIMITS, REST, UP, noisy, rows_of, stated, talk

pytestmark = pytest.mark.anyio

HEADER = [
    "unix_time_s,load,position_mm,force_n",
    "s1_counts,s1_deflection_mm,s1_quality",
    "s2_counts,s2_deflection_mm,s2_quality",
]
AT_THREE = ("--at", 100, 5, "--at", 200, 6, "--at", 300, 7)
OF_BENCH = ("--surface", "bench")
NAMED = "bench: not recorded: 5 N at 100 mm; put them on again"


@pytest.mark.promise(
    "docs/how-to/calibrate.md",
    "After a wrong answer, or a load that it refuses, `record` asks again.",
    "`record` refuses a load outside `[surfaces.NAME.loads]` of the configuration",
)
async def test_loads_that_are_typed_are_recorded_and_wrong_answers_asked_again(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    typed = ["150 10", "abc", "-3 5", "60 0", "9999 10", "150 10000", "250,5 5", ""]
    done = await talk(tmp_path, typed, "--seconds", 0.3)
    assert done.code == 0
    calibrate, build = (
        f"design-sensors {words}"
        for words in (f"calibrate MODEL {path} -o MODEL", f"build --loads {path} -o bench.onnx")
    )
    assert done.out == f"2 loads in {path}; next: {calibrate}, or without a model {build}\n"
    for said in (
        "give two numbers",
        "a position of -3 mm is not on the beam",
        "is no load",
        "9999 mm is not within 0 to 400 mm",
        "10000 N is more than 20 N",
        "load 2: 5 N at 250.5 mm",
    ):
        assert said in done.err
    assert path.read_text().splitlines()[0] == ",".join(HEADER)
    rows = rows_of(path)
    assert stated(path) == [("1", "150.0", "10.0"), ("2", "250.5", "5.0")]
    assert len(rows) == 120  # 200 Hz, twice 0.3 s
    for row in rows:
        assert (row["s1_counts"], row["s2_counts"], row["s1_quality"]) == ("20000", "21000", "good")
        assert float(row["s1_deflection_mm"]) == pytest.approx(0, abs=1e-9)
        assert row["s2_deflection_mm"] == "0.100000"  # to the nanometre, never as a power of ten


@pytest.mark.promise(
    "docs/how-to/calibrate.md",
    "On a plate, a load has three numbers, `x`, `y` and force, and the file has the columns `x_mm` and `y_mm`.",
)
async def test_loads_on_a_plate_have_two_coordinates(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    typed = ["150 10", "-1 80 10", "150 301 10", "150 80 10", "250,5 20 500 accept", ""]
    done = await talk(tmp_path, typed, limits=PLATE_LIMITS)
    assert done.code == 0
    for said in (
        "load 1: put it on, then enter x and y in mm and force in N",
        "give three numbers: x and y in mm from the corner, and the force in N, as in 150 80 10",
        "x = -1 mm is not on the plate; count from its lower left corner",
        "y = 301 mm is not within 0 to 300 mm, the range that the model covers",
        "load 2: 500 N at 250.5, 20 mm",
    ):
        assert said in done.err
    found = {(row["load"], row["x_mm"], row["y_mm"], row["force_n"]) for row in rows_of(path)}
    assert found == {("1", "150.0", "80.0", "10.0"), ("2", "250.5", "20.0", "500.0")}
    given = await talk(tmp_path, [""], "--append", "--at", 60, 70, 5, limits=PLATE_LIMITS)
    assert (given.code, rows_of(path)[-1]["y_mm"]) == (0, "70.0")
    beam = await talk(tmp_path, [], "--append", "--at", 60, 5)
    assert "its columns are not those of this surface; write to another file" in beam.err


async def test_loads_are_appended_and_the_last_one_can_be_taken_back(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    rests = noisy(0, 0.0)  # noise is not taken for motion
    first = await talk(tmp_path, ["abc", "150 10", "250 5", "undo", "100 5", ""], action=rests)
    assert (first.code, first.err.count("load 1: put it on, then enter position in mm and force in N")) == (0, 2)
    assert "load 2, 5 N at 250 mm, is removed" in first.err
    assert stated(path) == [("1", "150.0", "10.0"), ("2", "100.0", "5.0")]
    refused = await talk(tmp_path, [], "--at", 100, 10)
    assert (refused.code, refused.out, refused.err.count("\n")) == (2, "", 1)
    assert "already exists; add --append" in refused.err
    second = await talk(tmp_path, ["undo", "70 5", "undo", "undo", ""], "--append", "--seconds", 0.001)
    assert second.err.count("there is no load to remove") == 2
    given = await talk(tmp_path, ["", "undo", "", ""], "--at", 80, 5, "--at", 90, 5, "--append", "--seconds", 0.001)
    assert given.code == 0
    assert [load[1] for load in stated(path)] == ["150.0", "100.0", "80.0", "90.0"]
    loads = [row["load"] for row in rows_of(path)]
    assert min(loads.count(load) for load in "1234") >= 2  # however short the recording is
    one_sign = await talk(tmp_path, [""], "--at", 60, 5, "--at", 50, 5, "--append")
    assert one_sign.code == 0
    assert [load[1] for load in stated(path)][4:] == ["60.0"]  # the other one was never put on


@pytest.mark.promise(
    "docs/how-to/calibrate.md",
    "The answer `accept` after the load records it anyway; `undo` removes the last load.",
    "a load that deflects no channel clearly",
)
@pytest.mark.parametrize(
    ("turns", "options", "code", "loads", "said"),
    [
        # A load that is refused is asked for again; undo removes the one that was recorded last.
        (["", (REST, ""), (DOWN, "undo"), "", "", ""], AT_THREE, 0, [5, 6, 7], "load 1, 5 N at 100 mm, is removed"),
        (["", "undo"], AT_THREE, 1, [], NAMED),
        ([(REST, ""), (DOWN, ""), (REST, "")], (*AT_THREE[:3], *AT_THREE[:3]), 1, [5], NAMED),
        ([(UP, ""), "accept"], AT_THREE[:6], 0, [5], "the largest deflection is negative: -0.1 mm (s2), against the"),
        ([(REST, "150 10"), "150 10 accept", ""], (), 0, [10], "no load is seen: the largest deflection is "),
        ([""], ("--at", 9999, 30, "--accept"), 0, [30], "load 1: 30 N at 9999 mm"),
    ],
    ids=["undo", "removed", "equal", "lifted", "not seen", "beyond"],
)
async def test_a_load_that_is_refused_or_removed_is_asked_for_again_or_named_or_accepted(
    tmp_path: Path, turns: list[str], options: tuple[object, ...], code: int, loads: list[float], said: str
) -> None:
    told = await talk(tmp_path, turns, *options)
    assert said in told.err
    assert [float(force) for _, _, force in stated(tmp_path / "loads.csv")] == loads
    assert told.code == code


@pytest.mark.parametrize("words", [["--at", "150", "10"], ["--at", "150 10"], ["--at=150 10"]])
async def test_loads_may_stand_before_the_configuration(tmp_path: Path, words: list[str]) -> None:
    missing = tmp_path / "missing.toml"
    told = await command("record", *words, "--at", "80", "-5", missing, "-o", tmp_path / "loads.csv")
    assert (told.code, told.err) == (2, f"beamtouch-daemon: {missing}: No such file or directory\n")


@pytest.mark.promise("docs/how-to/calibrate.md", "and a load that moves while it is recorded")
async def test_a_load_that_moves_while_it_is_recorded_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    slow = noisy(moves_after=150, counts_per_reading=1.7)  # 33 um in a second, after it has settled
    told = await talk(tmp_path, ["150 10", ""], "--seconds", 2, action=slow)
    assert told.code == 1
    assert "10 N at 150 mm not recorded: the load moved while it was recorded: s2, standard deviation" in told.err
    assert not (tmp_path / "loads.csv").exists()


async def test_a_surface_that_does_not_settle_is_not_recorded(tmp_path: Path) -> None:
    impatient = "from beamtouch_daemon.commands import record; record.GIVE_UP_S = 2.0"
    told = await talk(tmp_path, ["150 10", ""], action=noisy(0, 5.0), code=impatient)
    assert "10 N at 150 mm not recorded: not settled within 2 s: s2" in told.err
    assert (told.code, (tmp_path / "loads.csv").exists()) == (1, False)


async def test_answers_that_cannot_be_read_record_nothing(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 21_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        command = [sys.executable, "-m", "beamtouch_daemon", "record", str(config), "-o", str(tmp_path / "loads.csv")]
        environment = os.environ | {"PYTHONIOENCODING": "utf-8:strict"}  # as with LANG=en_US.UTF-8
        done = await asyncio.to_thread(
            subprocess.run, command, input=b"150\xa0mm 10\n", capture_output=True, timeout=120, env=environment
        )
    said = done.stderr.decode().splitlines()
    assert (done.returncode, said[-2].startswith("load 1: put it on, then enter ")) == (1, True)
    assert any(line.startswith("give two numbers") for line in said)
    path = tmp_path / "loads.csv"
    assert said[-1] == f"beamtouch-daemon: bench: no load is recorded, so {path} is not written"
    assert not path.exists()


async def test_a_source_that_fails_ends_the_recording_and_leaves_no_empty_file(tmp_path: Path) -> None:
    async def fails(*_: object) -> ExcCodes:
        return ExcCodes.DEVICE_FAILURE

    told = await talk(tmp_path, ["150 10"], action=fails)
    assert told.code == 1
    assert told.err.endswith("; no load is recorded\n")
    assert not (tmp_path / "loads.csv").exists()


@pytest.mark.parametrize("turns", [[], [""], ["150 10", "undo", ""]], ids=["interrupted", "none", "removed"])
async def test_an_ended_recording_leaves_no_empty_file_and_can_begin_again(tmp_path: Path, turns: list[str]) -> None:
    path = tmp_path / "loads.csv"
    first = await talk(tmp_path, turns)
    assert (first.code, path.exists()) == (1, False)
    again = await talk(tmp_path, ["150 10", ""])
    assert (again.code, stated(path)) == (0, [("1", "150.0", "10.0")])
    appended = await talk(tmp_path, ["undo", ""], "--append")
    assert (appended.code, stated(path)) == (0, [("1", "150.0", "10.0")])


async def test_a_load_that_does_not_fit_on_the_disk_leaves_the_loads_before_it(tmp_path: Path) -> None:
    small = "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
    limited = f"{small}resource.setrlimit(resource.RLIMIT_FSIZE, (6000, 6000))"
    told = await talk(tmp_path, ["150 10", "250 5"], "--seconds", 0.3, code=limited)
    path = tmp_path / "loads.csv"
    assert told.code == 1
    assert f"{path}: File too large; 1 loads are in {path}" in told.err
    assert stated(path) == [("1", "150.0", "10.0")]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((*OF_BENCH, "--seconds", 0), "--seconds: give more than 0"),
        ((*OF_BENCH, "--at", 9999, 10), "--at: 9999 mm is not within 0 to 400 mm"),
        ((*OF_BENCH, "--at", 150, 10_000), "--at: 10000 N is more than 20 N"),
        ((*OF_BENCH, "-o", "{folder}/absent/x.csv"), "{folder}/absent: no such folder; create it first"),
        (("--surface", "press"), "--surface: there is no surface press; choose one of bench, press-7"),
        ((), "--surface: choose one of bench, press-7"),
    ],
)
def test_wrong_input_is_one_line_and_writes_nothing(
    tmp_path: Path, refused: Refused, options: tuple[object, ...], said: str
) -> None:
    config = configs.write(tmp_path, configs.surface() + LIMITS, configs.surface("press-7"))
    words = [str(word).format(folder=tmp_path) for word in options]
    assert said.format(folder=tmp_path) in refused("record", config, "-o", tmp_path / "loads.csv", *words)
    assert not (tmp_path / "loads.csv").exists()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (",".join(HEADER).encode() + b"\n1.5,1,150.0,10.0,20", "not a recording; write to another file"),
        (b"\xff\xfe\n", "not a text file in UTF-8"),
        ("load\n".encode("utf-16"), "in UTF-16, not in UTF-8; save it as UTF-8"),
        (b"unix_time_s,load\n1,1\n", "its columns are not those of this surface; write to another file"),
    ],
    ids=["half a row", "no text", "UTF-16", "of another surface"],
)
def test_what_is_no_recording_of_this_surface_is_not_appended_to(
    tmp_path: Path, refused: Refused, content: bytes, said: str
) -> None:
    path = tmp_path / "loads.csv"
    path.write_bytes(content)
    assert refused("record", configs.write(tmp_path, configs.surface()), "-o", path, "--append") == f"{path}: {said}"
    assert path.read_bytes() == content
