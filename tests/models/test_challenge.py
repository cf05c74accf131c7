"""`design-sensors challenge`: the command, and the cases that a model is put through."""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import pytest

from beamtouch_models import runtime
from beamtouch_models.design.sweeps import Progress, TaskMap
from beamtouch_models.lab.challenge import contacts, drift, ringing
from beamtouch_models.lab.challenge.challenge import Row, challenge, misses, rows_of
from beamtouch_models.lab.challenge.judge import Outcome, judge
from beamtouch_models.lab.challenge.play import Case, DrawnContacts, Make, SimulatedSurface
from beamtouch_models.runtime import ModelFile
from support.programs.in_process import Command, Refusal


def only(model: ModelFile, case: Case, draws: int = 150, seed: int = 1) -> list[Row]:
    return rows_of(model, SimulatedSurface.of(model.metadata), case, draws, np.random.default_rng(seed))


def test_the_model_of_the_bench_is_honest_at_rest_and_one_with_too_small_a_floor_is_not(bench: ModelFile) -> None:
    case = Case(True, contacts.rested)
    (row,) = only(bench, case)
    assert misses(row) == []
    assert row.plain > 140
    # Its gains are ten times as uncertain as it believes.
    text = bench.metadata.scene.replace("gain_error_percent = 0.3", "gain_error_percent = 3.0")
    believing = replace(bench, metadata=bench.metadata.model_copy(update={"scene": text}))
    (row,) = only(believing, case)
    assert row.held is not None
    assert row.held < 0.7
    assert row.misleading > 0.05
    assert any(goal.startswith("misleading") for goal in misses(row))
    assert any(goal.startswith("held") for goal in misses(row))


MAKES: dict[str, Make] = {
    "a touch": contacts.touched,
    "a sudden force": ringing.rings,
    "a weight": partial(ringing.rings, weighs=True),
    "a force that grows": partial(ringing.rings, lasting_s=ringing.RAMPS_S[0]),
    "a lift": ringing.lifts,
    "begins to move": partial(contacts.moves, speed_mm_per_s=30.0),
    "keeps moving": partial(contacts.moves, speed_mm_per_s=100.0, motion=contacts.KEEPS),
}


@pytest.mark.parametrize("draws", [30, pytest.param(100, marks=pytest.mark.soak)])
@pytest.mark.parametrize("name", MAKES)
def test_an_honest_contact_that_comes_goes_or_moves_keeps_to_the_goals(bench: ModelFile, name: str, draws: int) -> None:
    for row in only(bench, Case(True, MAKES[name]), draws):
        assert misses(row) == [], row


@pytest.mark.parametrize("together", [pytest.param(True, marks=pytest.mark.soak), False])
def test_zeros_that_drift_mislead_no_contact_and_leave_none_behind(bench: ModelFile, together: bool) -> None:
    contact, lifted = only(bench, Case(True, partial(drift.drifts, together=together)), 60)
    assert misses(contact) == misses(lifted) == []
    assert contact.plain > 57
    assert lifted.clear == 1.0


def test_under_drift_the_last_reading_of_a_contact_is_judged_and_the_last_one_after_its_lift(
    surface: SimulatedSurface,
) -> None:
    play = drift.drifts(DrawnContacts.of(surface, 4, np.random.default_rng(3)), together=True)
    (_, contact), (_, lifted) = play.rows
    is_touched = ~np.isnan(play.truth_mm[..., 0])
    assert is_touched[:, contact].all()
    assert not is_touched[:, contact + 1 :].any()
    assert lifted == play.truth_mm.shape[1] - 1


def test_a_gap_while_the_beam_rings_begins_so_long_after_the_touch(surface: SimulatedSurface) -> None:
    drawn = DrawnContacts.of(surface, 4, np.random.default_rng(3))
    play = contacts.interrupted(drawn, make=ringing.rings, when="while it rings", gap=5, since_s=contacts.RINGING_S)
    assert play.lost is not None
    begins, touched = play.lost[0].argmax(), (~np.isnan(play.truth_mm[0, :, 0])).argmax()
    assert begins - touched == round(contacts.RINGING_S * surface.metadata.sensor.rate_hz)
    assert play.lost[0, begins : begins + 5].all()


def test_a_touch_is_unsteady_first_and_an_untouched_beam_is_clear(bench: ModelFile, surface: SimulatedSurface) -> None:
    play = contacts.touched(DrawnContacts.of(surface, 40, np.random.default_rng(3)))
    heard = judge(surface, bench.run, surface.world.readings(play.deflection_mm, play.errors, np.random.default_rng(4)))
    before = play.rows[0][1]
    assert (heard.outcome[:, :before] == Outcome.CLEAR).all()
    assert (heard.outcome[:, -1] == Outcome.CONTACT).mean() > 0.95
    touched = heard.at([before + 1])
    assert (touched.unsteady | (touched.outcome == Outcome.CLEAR)).all()
    assert np.isnan(play.truth_mm[:, before - 1]).all()
    assert not np.isnan(play.truth_mm[:, before]).any()


def test_a_lost_reading_has_no_statement_and_its_place_in_time_counts(
    bench: ModelFile, surface: SimulatedSurface
) -> None:
    drawn = DrawnContacts.of(surface, 4, np.random.default_rng(3))
    play = contacts.interrupted(drawn, make=contacts.touched, when="at a touch", gap=5, since_s=0.0)
    assert play.lost is not None
    readings = surface.world.readings(play.deflection_mm, play.errors, np.random.default_rng(4))
    heard = judge(surface, bench.run, readings, lost=play.lost)
    assert (heard.outcome[play.lost] == Outcome.NOTHING).all()
    # What a lost reading would have held is of no account.
    other = judge(surface, bench.run, np.where(play.lost[:, :, None], 0.5, readings), lost=play.lost)
    np.testing.assert_array_equal(heard.place_mm, other.place_mm)
    # The load came in the gap, and nobody knows when. Had there been none, its second reading would be known well.
    second = play.rows[1][1]
    shorter = judge(surface, bench.run, readings[~play.lost].reshape(4, -1, surface.channels))
    length_mm, known_mm = heard.high_mm - heard.low_mm, shorter.high_mm - shorter.low_mm
    assert np.median(length_mm[:, second] / known_mm[:, second - 5]) > 3


def test_the_same_seed_gives_the_same_rows(bench: ModelFile) -> None:
    case = Case(True, ringing.rings)
    first, again, other = (only(bench, case, 10, seed) for seed in (1, 1, 2))
    assert [row.name for row in first] == [f"sudden force, {ms} ms" for ms in (20, 50, 100, 200, 500)]
    assert [asdict(row) for row in first] == [asdict(row) for row in again]
    assert [row.error_mm for row in first] != [row.error_mm for row in other]


@pytest.mark.parametrize("name", ["bench", "cantilever", pytest.param("paper", marks=pytest.mark.soak)])
def test_a_beam_that_rings_after_a_lift_is_not_touched(name: str, built_model: Callable[[str], Path]) -> None:
    """Readings beyond the range on the bench, replaced ones on the cantilever, single ones on the paper's beam."""
    *_, last = only(runtime.load(built_model(name)), Case(True, ringing.lifts), 30)
    assert last.ghosts is not None
    assert last.ghosts <= 1 / 30


def test_a_model_without_a_stated_mass_is_challenged_without_ringing(bench: ModelFile) -> None:
    text = bench.metadata.scene.replace("density_kg_m3", "# ")
    bare = replace(bench, metadata=bench.metadata.model_copy(update={"scene": text}))
    surface = SimulatedSurface.of(bare.metadata)
    assert surface.world.modes is None
    assert surface.slowest_period == 0
    assert not any("rings" in str(case.make) for case in contacts.honest_cases(surface))
    rows = only(bare, Case(True, lambda *a: contacts.moves(*a, speed_mm_per_s=30.0)), 10)
    assert rows[0].samples == 50


def test_the_command_prints_both_groups_and_one_json_object(
    design_sensors_here: Command, quick_model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept: list[list[Row]] = []

    def once(content: bytes, *, draws: int, seed: int, progress: Progress, spread: TaskMap) -> list[Row]:
        kept.extend([] if kept else [challenge(content, draws=draws, seed=seed, progress=progress, spread=spread)])
        return kept[0]

    monkeypatch.setattr("beamtouch_models.commands.challenge.challenge", once)
    done = design_sensors_here("challenge", quick_model, "--draws", 10, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["draws"], found["seed"]) == (10, 0)
    names = [row["name"] for row in found["rows"]]
    assert len(set(names)) == len(names) > 40
    assert [row["honest"] for row in found["rows"]] == sorted((row["honest"] for row in found["rows"]), reverse=True)
    assert all(row["power"] is not None and row["noticed"] is not None for row in found["rows"] if not row["honest"])
    gains = {row["name"]: row["honest"] for row in found["rows"] if row["name"].startswith("gains")}
    assert gains == {"gains 0.3 % off": True, "gains 1 % off": False, "gains 3 % off": False}
    # The same rows once more, for people.
    table = design_sensors_here("challenge", quick_model, "--draws", 10)
    assert table.returncode == 0
    assert "one contact, honestly measured" in table.stdout
    assert "faults and other worlds" in table.stdout
    assert "Rows that miss the goals" in table.stdout
    assert "…" not in table.stdout  # neither a heading nor a number is cut


def test_a_model_that_states_no_log_odds_is_refused(refused: Refusal, bench_model: Path, tmp_path: Path) -> None:
    graph = onnx.load(bench_model)
    for output in [one for one in graph.graph.output if one.name == "contact_log_odds"]:
        graph.graph.output.remove(output)
    path = tmp_path / "silent.onnx"
    onnx.save(graph, path)
    assert "contact_log_odds" in refused("challenge", path)
