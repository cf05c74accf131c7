"""What `design-sensors challenge` says of rows whose figures are known."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from beamtouch_models.lab.challenge.challenge import Row
from beamtouch_models.runtime import ModelFile
from support.programs.in_process import Command

HONEST = Row(
    name="touch", honest=True, quiet=False, samples=400, error_mm=1.2345, held=0.9512, plain=380, held_unsteady=0.925,
    unsteady=20, held_noted=None, unexplained=0.0125, noted=0.05, clear=0.0, silent=5e-5, misleading=0.003,
    interval_mm=6.789, ghosts=0.0002, plays=100,
)  # fmt: skip
MISLED = replace(HONEST, name="lift", misleading=0.2, held=0.5, ghosts=None, silent=1e-4)
FAULT = replace(HONEST, name="stuck", honest=False, noticed=0.987, power=0.991, error_mm=None, held=None, samples=1234)
UNSEEN = replace(FAULT, name="pull", noticed=0.25, power=1.0)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the command asked for of these rows."""
    asked = dict[str, Any]()

    def rows(content: bytes, *, draws: int, seed: int, progress: object, spread: object) -> list[Row]:  # noqa: ARG001
        asked.update(content=content, draws=draws, seed=seed)
        return [HONEST, MISLED, FAULT, UNSEEN]

    monkeypatch.setattr("beamtouch_models.commands.challenge.challenge", rows)
    return asked


def test_tables_have_shares_in_percent_and_lengths_in_mm(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, asked: dict[str, Any]
) -> None:
    done = design_sensors_here("challenge", bench_model, "--draws", 25, "--seed", 3)
    assert asked == {"content": bench_model.read_bytes(), "draws": 25, "seed": 3}
    lines = done.stdout.splitlines()
    assert lines[0] == f"{bench.identity}, 25 simulations of each case"
    said = [" ".join(line.split()) for line in lines]
    first = {line for line in said if line.startswith("touch ")}
    assert first == {"touch 400 1.23 6.79 95.1 92.5 -", "touch 1.25 5 0 <0.01 0.3 0.02"}
    # A ten-thousandth is the least that is told.
    assert {line for line in said if line.startswith("lift ")} == {
        "lift 400 1.23 6.79 50 92.5 -", "lift 1.25 5 0 0.01 20 -"}  # fmt: skip
    assert {line for line in said if line.startswith("stuck ")} == {
        "stuck 98.7 99.1 0.3 - -", "stuck 1234 1.25 5 0 <0.01"}  # fmt: skip
    group = "one contact, honestly measured", "faults and other worlds"
    titles = [line.strip() for line in lines if line.strip().startswith(group)]
    parts = ("errors and intervals", "what was answered, %"), ("what was noticed, %", "what was answered, %")
    assert titles == [f"{name}: {part}" for name, own in zip(group, parts, strict=True) for part in own]
    heads = [line.removeprefix("case ") for line in said if line.startswith("case ")]
    assert heads == [
        "samples error, mm interval, mm held, % unsteady, % other, %",
        "unexplained noted clear silent misleading ghosts",
        "noticed power misleading held error, mm",
        "samples unexplained noted clear silent",
    ]
    text = " ".join(said)
    assert "Rows that miss the goals: lift (misleading 20.0%, held 50%); pull (noticed 25% of 100%)." in text


def test_fields_have_each_row_with_the_goals_that_it_misses(
    design_sensors_here: Command, bench_model: Path, asked: dict[str, Any]
) -> None:
    found = json.loads(design_sensors_here("challenge", bench_model, "--json").stdout)
    assert (asked["draws"], asked["seed"]) == (found["draws"], found["seed"]) == (400, 0)
    assert [(row["name"], row["misses"]) for row in found["rows"]] == [
        ("touch", []), ("lift", ["misleading 20.0%", "held 50%"]), ("stuck", []), ("pull", ["noticed 25% of 100%"]),
    ]  # fmt: skip
    assert found["rows"][0]["silent"] == 5e-5


def test_where_all_goals_are_met_none_is_named(
    design_sensors_here: Command, bench_model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("beamtouch_models.commands.challenge.challenge", lambda *_, **__: [HONEST, FAULT])
    said = " ".join(design_sensors_here("challenge", bench_model).stdout.split())
    assert said.endswith("Rows that miss the goals: none.")
