"""`record`: known loads to a CSV file, from the command line, over a real socket."""

import asyncio
import csv
import subprocess
import sys
from pathlib import Path

import pytest

from beamtouch_daemon.record_dialogue import load_of

from . import configs
from .devices import pymodbus_server
from .process import command

HEADER = [
    "unix_time_s,load,position_mm,force_n",
    "s1_counts,s1_deflection_mm,s1_quality",
    "s2_counts,s2_deflection_mm,s2_quality",
]


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def record(config: Path, path: Path, typed: str, *options: object) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-m", "beamtouch_daemon", "record", str(config), "-o", str(path)]
    return subprocess.run(
        [*program, *map(str, options)], input=typed, capture_output=True, text=True, timeout=60, check=False
    )


def test_loads_that_are_typed_are_recorded(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"

    async def story() -> subprocess.CompletedProcess[str]:
        async with pymodbus_server([20_000, 21_000]) as port:
            config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
            typed = "150 10\nabc\n-3 5\n60 0\n250,5 5\n\n"
            return await asyncio.to_thread(record, config, path, typed, "--seconds", 0.3)

    done = asyncio.run(story())
    assert done.returncode == 0
    assert done.stdout == f"2 loads in {path}; next: design-sensors calibrate MODEL {path} -o MODEL\n"
    for said in ("give two numbers", "is not on the beam", "is no load", "load 2: 5 N at 250.5 mm"):
        assert said in done.stderr
    assert path.read_text().splitlines()[0] == ",".join(HEADER)
    rows = rows_of(path)
    assert {(row["load"], row["position_mm"], row["force_n"]) for row in rows} == {
        ("1", "150.0", "10.0"),
        ("2", "250.5", "5.0"),
    }
    assert len(rows) > 60  # 200 Hz, twice 0.3 s
    for row in rows:
        assert (row["s1_counts"], row["s2_counts"], row["s1_quality"]) == ("20000", "21000", "good")
        assert float(row["s1_deflection_mm"]) == pytest.approx(0, abs=1e-9)
        assert float(row["s2_deflection_mm"]) == pytest.approx(0.1)


def test_loads_that_are_given_wait_for_a_sign_and_are_appended(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"

    async def story() -> list[subprocess.CompletedProcess[str]]:
        async with pymodbus_server([20_000, 21_000]) as port:
            config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
            given = ("--at", 100, 10, "--at", 200, 5, "--seconds", 0.2)
            first = await asyncio.to_thread(record, config, path, "\n\n", *given)
            refused = await asyncio.to_thread(record, config, path, "\n\n", *given)
            more = await asyncio.to_thread(record, config, path, "\n", *given, "--append")
            return [first, refused, more]

    first, refused, more = asyncio.run(story())
    assert first.returncode == 0
    assert (refused.returncode, refused.stdout, refused.stderr.count("\n")) == (2, "", 1)
    assert "is there already; add --append" in refused.stderr
    assert more.returncode == 0
    assert [row["load"] for row in rows_of(path)] == sorted(row["load"] for row in rows_of(path))
    # One sign only: the second load was never put on.
    assert {row["load"] for row in rows_of(path)} == {"1", "2", "3"}


def test_a_source_that_fails_ends_it_and_what_was_recorded_stays(tmp_path: Path) -> None:
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
        (("--surface", "press-7"), "--surface: name one of bench"),
    ],
)
def test_wrong_input_is_one_line_and_writes_nothing(tmp_path: Path, options: tuple[object, ...], said: str) -> None:
    path = tmp_path / "loads.csv"
    config = configs.write(tmp_path, configs.surface())
    done = asyncio.run(command("record", config, "-o", path, *map(str, options)))
    assert done.code == 2
    assert said in done.complaint()
    assert not path.exists()


def test_another_surfaces_file_is_not_appended_to(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    path.write_text("unix_time_s,load\n1,1\n")
    done = record(configs.write(tmp_path, configs.surface()), path, "", "--append")
    assert done.returncode == 2
    assert "other columns" in done.stderr
    assert path.read_text() == "unix_time_s,load\n1,1\n"


def test_a_comma_is_a_decimal_point() -> None:
    assert load_of(["12,5", "9.81"]).position_mm == 12.5
