"""`record`: known loads to a CSV file, from the command line, over a real socket."""

import asyncio
from pathlib import Path

import pytest

from beamtouch_daemon.commands import record as record_command
from beamtouch_daemon.commands.loads import Load, parse_load
from beamtouch_daemon.commands.record import LoadRefusedError, record_load
from beamtouch_daemon.config.file import load_config

from . import configs
from .devices import pymodbus_server
from .process import command
from .recording import noisy, on_beam, record, record_at_terminal, rows_of, stated, talk

pytestmark = pytest.mark.anyio

HEADER = [
    "unix_time_s,load,position_mm,force_n",
    "s1_counts,s1_deflection_mm,s1_quality",
    "s2_counts,s2_deflection_mm,s2_quality",
]


async def test_loads_that_are_typed_at_a_terminal_are_recorded_and_wrong_answers_asked_again(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    typed = "150 10\nabc\n-3 5\n60 0\n9999 10\n150 10000\n250,5 5\n\n"
    done = await on_beam(typed, tmp_path, "--seconds", 0.3, at_terminal=True)
    assert done.returncode == 0
    assert done.stdout == f"2 loads in {path}; next: design-sensors calibrate MODEL {path} -o MODEL\n"
    for said in (
        "give two numbers",
        "a position of -3 mm is not on the beam",
        "is no load",
        "9999 mm is not within 0 to 400 mm",
        "10000 N is more than 20 N",
        "load 2: 5 N at 250.5 mm",
    ):
        assert said in done.stderr
    assert path.read_text().splitlines()[0] == ",".join(HEADER)
    rows = rows_of(path)
    assert stated(path) == [("1", "150.0", "10.0"), ("2", "250.5", "5.0")]
    assert len(rows) == 120  # 200 Hz, twice 0.3 s
    for row in rows:
        assert (row["s1_counts"], row["s2_counts"], row["s1_quality"]) == ("20000", "21000", "good")
        assert float(row["s1_deflection_mm"]) == pytest.approx(0, abs=1e-9)
        assert row["s2_deflection_mm"] == "0.100000"  # to the nanometre, never as a power of ten


async def test_after_a_wrong_answer_from_a_pipe_it_asks_again_too(tmp_path: Path) -> None:
    done = await on_beam("abc\n150 nan\n9999 10\n150 10000\n150 10\n", tmp_path, "--seconds", 0.2)
    assert done.returncode == 0
    for said in ("give two numbers", "is no load", "is not within 0 to 400 mm", "is more than 20 N"):
        assert said in done.stderr
    assert done.stderr.count("load 1: put it on, then enter position in mm and force in N") == 5
    assert stated(tmp_path / "loads.csv") == [("1", "150.0", "10.0")]


@pytest.mark.parametrize("words", [("9999", "10"), ("150", "10000")])
async def test_a_given_load_that_the_surface_cannot_have_is_wrong_input(tmp_path: Path, words: tuple[str, str]) -> None:
    done = await on_beam("\n", tmp_path, "--at", *words)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith("beamtouch-daemon: --at: ")
    assert not (tmp_path / "loads.csv").exists()
    taken = await on_beam("\n", tmp_path, "--at", *words, "--accept", "--seconds", 0.2)
    assert taken.returncode == 0
    assert len(stated(tmp_path / "loads.csv")) == 1


async def test_a_load_that_deflects_nothing_is_refused_and_can_be_accepted(tmp_path: Path) -> None:
    nothing = noisy(0, 0.0, loaded=0.0)
    done = await on_beam("150 10\n\n", tmp_path, "--seconds", 0.5, action=nothing)
    assert done.returncode == 1
    assert "10 N at 150 mm not recorded: no load is seen: the largest deflection is " in done.stderr
    assert done.stderr.splitlines()[-1] == "beamtouch-daemon: bench: not recorded: 10 N at 150 mm; put them on again"
    assert rows_of(tmp_path / "loads.csv") == []
    taken = await on_beam("150 10 accept\n\n", tmp_path, "--seconds", 0.5, "--append", action=nothing)
    assert taken.returncode == 0
    assert stated(tmp_path / "loads.csv") == [("1", "150.0", "10.0")]


async def test_a_load_that_moves_while_it_is_recorded_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    slow = noisy(moves_after=150, counts_per_reading=1.7)  # 33 um in a second, after it has settled
    done = await on_beam("150 10\n\n", tmp_path, action=slow)
    assert done.returncode == 1
    assert "10 N at 150 mm not recorded: the load moved while it was recorded: s2, standard deviation" in done.stderr
    assert rows_of(tmp_path / "loads.csv") == []


async def test_a_load_that_rests_is_not_taken_for_one_that_moves(tmp_path: Path) -> None:
    done = await on_beam("150 10\n" * 4 + "\n", tmp_path, "--seconds", 0.5, action=noisy(0, 0.0))
    assert done.returncode == 0
    assert len(stated(tmp_path / "loads.csv")) == 4


async def test_the_last_load_can_be_taken_back(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    first = await on_beam("150 10\n250 5\nundo\n100 5\n\n", tmp_path, "--seconds", 0.2)
    assert first.returncode == 0
    assert "load 2, 5 N at 250 mm, is removed" in first.stderr
    assert stated(path) == [("1", "150.0", "10.0"), ("2", "100.0", "5.0")]
    second = await on_beam("70 5\nundo\nundo\n\n", tmp_path, "--seconds", 0.2, "--append")
    assert "there is no load to remove" in second.stderr
    assert stated(path) == [("1", "150.0", "10.0"), ("2", "100.0", "5.0")]
    given = await on_beam("\nundo\n\n\n", tmp_path, "--at", 80, 5, "--at", 90, 5, "--seconds", 0.2, "--append")
    assert given.returncode == 0
    assert [load[1] for load in stated(path)] == ["150.0", "100.0", "80.0", "90.0"]


DOWN, REST, UP = 21_000, 20_000, 19_000
"""Counts of the second channel under a load, without one, and lifted."""
THREE = ("--at", 100, 5, "--at", 200, 6, "--at", 300, 7)


async def test_undo_removes_the_load_that_was_recorded_last_and_not_a_refused_one(tmp_path: Path) -> None:
    turns = [(DOWN, ""), (REST, ""), (DOWN, "undo"), (DOWN, ""), (DOWN, ""), (DOWN, "")]
    code, said = await talk(tmp_path, turns, *THREE)
    assert "load 1, 5 N at 100 mm, is removed" in said
    assert stated(tmp_path / "loads.csv") == [("1", "100.0", "5.0"), ("2", "200.0", "6.0"), ("3", "300.0", "7.0")]
    assert code == 0


async def test_a_given_load_that_was_removed_and_not_recorded_again_is_named(tmp_path: Path) -> None:
    code, said = await talk(tmp_path, [(DOWN, ""), (DOWN, "undo")], *THREE)
    assert code == 1
    assert "bench: not recorded: 5 N at 100 mm; put them on again" in said


async def test_a_refused_load_is_asked_for_again_before_an_equal_one(tmp_path: Path) -> None:
    code, said = await talk(tmp_path, [(REST, ""), (DOWN, ""), (REST, "")], "--at", 100, 5, "--at", 100, 5)
    assert stated(tmp_path / "loads.csv") == [("1", "100.0", "5.0")]
    assert code == 1
    assert "bench: not recorded: 5 N at 100 mm; put them on again" in said


async def test_a_load_that_lifts_the_beam_is_refused_and_can_be_accepted(tmp_path: Path) -> None:
    code, said = await talk(tmp_path, [(UP, ""), (UP, "accept")], "--at", 100, 5, "--at", 200, 6)
    assert "the largest deflection is negative: -0.1 mm (s2), against the load" in said
    assert stated(tmp_path / "loads.csv") == [("1", "100.0", "5.0")]
    assert code == 0


async def test_the_shortest_recording_holds_two_samples(tmp_path: Path) -> None:
    done = await on_beam("150 10\n\n", tmp_path, "--seconds", 0.001)
    assert done.returncode == 0
    assert len(rows_of(tmp_path / "loads.csv")) >= 2


async def test_loads_that_are_given_wait_for_a_sign_and_are_appended(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"

    async with pymodbus_server([20_000, 21_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        given = ("--at", 100, 10, "--at", 200, 5, "--seconds", 0.2)
        first = await asyncio.to_thread(record, config, path, "\n\n", *given)
        refused = await asyncio.to_thread(record, config, path, "\n\n", *given)
        more = await asyncio.to_thread(record, config, path, "\n", *given, "--append")
    assert first.returncode == 0
    assert (refused.returncode, refused.stdout, refused.stderr.count("\n")) == (2, "", 1)
    assert "already exists; add --append" in refused.stderr
    assert more.returncode == 0
    assert [row["load"] for row in rows_of(path)] == sorted(row["load"] for row in rows_of(path))
    # One sign only: the second load was never put on.
    assert {row["load"] for row in rows_of(path)} == {"1", "2", "3"}


def test_a_source_that_fails_ends_the_recording_and_keeps_the_file(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    config = configs.write(tmp_path, configs.surface(source=configs.tcp(9)))  # nothing listens at discard
    done = record(config, path, "150 10\n")
    assert done.returncode == 1
    assert "0 loads are in" in done.stderr
    assert path.read_text().startswith("unix_time_s")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--seconds", 0), "--seconds"),
        (("--seconds", "nan"), "--seconds"),
        (("--at", "x", 1), "--at: give two numbers"),
        (("--surface", "press-7"), "--surface: there is no surface press-7; choose one of bench"),
    ],
)
async def test_wrong_input_is_one_line_and_writes_nothing(
    tmp_path: Path, options: tuple[object, ...], said: str
) -> None:
    path = tmp_path / "loads.csv"
    config = configs.write(tmp_path, configs.surface())
    done = await command("record", config, "-o", path, *map(str, options))
    assert done.code == 2
    assert said in done.complaint()
    assert not path.exists()


async def test_of_several_surfaces_one_must_be_chosen(tmp_path: Path) -> None:
    config = configs.write(tmp_path, configs.surface(), configs.surface("press-7"))
    done = await command("record", config, "-o", tmp_path / "loads.csv")
    assert (done.code, done.complaint()) == (2, "--surface: choose one of bench, press-7")


async def test_a_file_that_cannot_be_written_is_wrong_input(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "loads.csv"
    done = await command("record", configs.write(tmp_path, configs.surface()), "-o", path)
    assert (done.code, done.complaint()) == (2, f"{path.parent}: no such folder; create it first")


@pytest.mark.parametrize("rows", [b"1.5,1,150.0,10.0,20", b"\xff\xfe\n"], ids=["half a row", "no text"])
async def test_a_damaged_recording_is_not_appended_to(tmp_path: Path, rows: bytes) -> None:
    path = tmp_path / "loads.csv"
    content = ",".join(HEADER).encode() + b"\n" + rows
    path.write_bytes(content)
    done = await command("record", configs.write(tmp_path, configs.surface()), "-o", path, "--append")
    assert (done.code, done.complaint()) == (2, f"{path}: not a recording; write to another file")
    assert path.read_bytes() == content


async def test_a_given_load_is_answered_by_enter_or_a_word(tmp_path: Path) -> None:
    done = await on_beam("yes\n", tmp_path, "--at", 150, 10)
    assert done.returncode == 1
    assert "'yes': press Enter once the load is on, or type undo or accept" in done.stderr
    assert done.stderr.count("load 1: put 10 N at 150 mm on, then press Enter") == 2


async def test_a_refused_given_load_is_asked_for_again_at_a_terminal(tmp_path: Path) -> None:
    async with pymodbus_server([20_000, 20_000]) as port:
        config, path = configs.write(tmp_path, configs.surface(source=configs.tcp(port))), tmp_path / "loads.csv"
        given = "--seconds", 0.2, "--at", 150, 10, "--at", 250, 5
        done = await asyncio.to_thread(record_at_terminal, config, path, "\naccept\naccept\n", *given)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("load 1: put 10 N at 150 mm on, then press Enter") == 2
    assert stated(path) == [("1", "150.0", "10.0"), ("2", "250.0", "5.0")]


async def test_a_surface_that_does_not_settle_is_not_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_command, "GIVE_UP_S", 3.0)
    async with pymodbus_server([20_000, 20_000], noisy(0, 5.0)) as port:
        config = load_config(configs.write(tmp_path, configs.surface(source=configs.tcp(port))))
        with pytest.raises(LoadRefusedError, match="not settled within 3 s: s2"):
            await record_load(config.surfaces["bench"], {}, Load(150.0, 10.0), 0.2)


def test_another_surfaces_file_is_not_appended_to(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    path.write_text("unix_time_s,load\n1,1\n")
    done = record(configs.write(tmp_path, configs.surface()), path, "", "--append")
    assert done.returncode == 2
    assert "its columns are not those of this surface" in done.stderr
    assert path.read_text() == "unix_time_s,load\n1,1\n"


def test_a_comma_is_a_decimal_point() -> None:
    assert parse_load(["12,5", "9.81"], None, is_accepted=False).position_mm == 12.5
