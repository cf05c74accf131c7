"""`design-sensors challenge`: the world that a model is put through."""

from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.challenge import faults, honest, motion, sensor_cases
from beamtouch_models.challenge.challenge import misses, rows_of
from beamtouch_models.challenge.judge import Said, judge
from beamtouch_models.challenge.play import Case
from beamtouch_models.challenge.scoring import Naming, Row, naming
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.modelfile import ModelFile


def only(model: ModelFile, case: Case, draws: int = 150, seed: int = 1) -> list[Row]:
    return rows_of(model, SimulatedSurface.of(model.metadata), None, case, draws, np.random.default_rng(seed))


def test_the_model_of_the_bench_is_honest_at_rest_and_one_with_too_small_a_floor_is_not(bench: ModelFile) -> None:
    case = Case(True, honest.rested)
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


def test_a_touch_is_unsteady_first_and_an_untouched_beam_is_clear(bench: ModelFile, surface: SimulatedSurface) -> None:
    play = honest.touched(surface, 40, np.random.default_rng(3))
    heard = judge(surface, bench.run, surface.readings(play.deflection_mm, play.errors, np.random.default_rng(4)))
    before = play.rows[0][1]
    assert (heard.said[:, :before] == Said.CLEAR).all()
    assert (heard.said[:, -1] == Said.CONTACT).mean() > 0.95
    touched = heard.at([before + 1])
    assert (touched.unsteady | (touched.said == Said.CLEAR)).all()
    assert np.isnan(play.truth_mm[:, before - 1]).all()
    assert not np.isnan(play.truth_mm[:, before]).any()


def test_noise_is_honest_once_the_user_has_stated_what_was_measured(bench: ModelFile) -> None:
    for make in (sensor_cases.coloured, sensor_cases.coarse):
        (measured,) = only(bench, Case(True, partial(make, measured=True)), 100)
        assert misses(measured) == []
        assert measured.plain > 93
        (not_stated,) = only(bench, Case(False, partial(make, measured=False)), 100)
        assert measured.held is not None
        assert not_stated.held is not None
        assert not_stated.held < measured.held
        assert not_stated.noted > measured.noted + 0.05  # noise is taken for motion
        assert not_stated.name == f"{measured.name}, not stated"


def test_wedges_are_noticed_and_near_contacts_cannot_be(bench: ModelFile) -> None:
    (wedge,) = only(bench, Case(False, lambda *a: faults.wedged(*a, touched=False)), 60)
    assert wedge.power == pytest.approx(1.0)
    assert wedge.noticed is not None
    assert wedge.noticed > 0.95
    (near,) = only(bench, Case(False, lambda *a: faults.two_contacts(*a, apart=0.02, ratio=1.0)), 60)
    assert near.power is not None
    assert near.power < 1e-3
    assert near.noticed is not None
    assert near.noticed < 0.2


def test_the_wrong_channel_is_named_and_two_contacts_are_not_blamed_on_one(
    bench: ModelFile, surface: SimulatedSurface
) -> None:
    play = faults.wedged(surface, 5, np.random.default_rng(12), touched=True)
    assert play.wrong is not None
    told = naming(surface, bench.run, play, np.random.default_rng(13))
    assert told == (1.0, 0.0, 5)
    # Had another channel been wrong, the same answers would blame the wrong one.
    blamed = naming(surface, bench.run, replace(play, wrong=(play.wrong + 1) % 4), np.random.default_rng(13))
    assert blamed == (0.0, 1.0, 5)
    two = faults.two_at_the_quarters(surface, 5, np.random.default_rng(14))
    assert two.wrong is None
    assert naming(surface, bench.run, two, np.random.default_rng(15)) == (0.0, 0.0, 5)
    fault = Row("row", False, False, 400, None, None, 0, None, 0, None, 1.0, 0.0, 0.0, 0.0, 0.0, None, None)
    fault = replace(fault, noticed=1.0, power=1.0)
    assert misses(replace(fault, naming=Naming(0.9, 0.04, 25))) == []  # one of 25
    assert misses(replace(fault, naming=Naming(0.9, 0.2, 25))) == ["another channel named 20%"]


def test_the_same_seed_gives_the_same_rows(bench: ModelFile) -> None:
    case = Case(True, honest.rings)
    first, again, other = (only(bench, case, 10, seed) for seed in (1, 1, 2))
    assert [row.name for row in first] == [f"sudden force, {ms} ms" for ms in (20, 50, 100, 200, 500)]
    assert [asdict(row) for row in first] == [asdict(row) for row in again]
    assert [row.error_mm for row in first] != [row.error_mm for row in other]


@pytest.mark.parametrize("name", ["bench", "cantilever", "paper"])
def test_a_beam_that_rings_after_a_lift_is_not_touched(name: str, built_model: Callable[[str], Path]) -> None:
    """Readings beyond the range on the bench, replaced ones on the cantilever, single ones on the paper's beam."""
    *_, last = only(modelfile.load(built_model(name)), Case(True, honest.lifts), 60)
    assert last.ghosts is not None
    assert last.ghosts <= 1 / 60


def test_a_model_without_a_stated_mass_is_challenged_without_ringing(bench: ModelFile) -> None:
    text = bench.metadata.scene.replace("density_kg_m3 = 7850\n", "")
    bare = replace(bench, metadata=bench.metadata.model_copy(update={"scene": text}))
    surface = SimulatedSurface.of(bare.metadata)
    assert surface.modes is None
    assert surface.slowest_period == 0
    assert not any("rings" in str(case.make) for case in honest.honest_cases(surface))
    rows = only(bare, Case(True, lambda *a: motion.moves(*a, speed_mm_per_s=30.0)), 10)
    assert rows[0].samples == 50
