"""`design-sensors challenge`: the simulated world, the scores, the power, and the command."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2, norm

from beamtouch_models import modelfile
from beamtouch_models.building.model_prior import prior_of_model
from beamtouch_models.challenge import faults, honest, noises
from beamtouch_models.challenge.challenge import misses, rows_of, run_of
from beamtouch_models.challenge.judge import Judged, Said, Sample, judge
from beamtouch_models.challenge.naming import Naming, naming
from beamtouch_models.challenge.play import Case, drawn
from beamtouch_models.challenge.power import distances, power_of_noise, power_of_shift
from beamtouch_models.challenge.scoring import Row, ghosts, scored
from beamtouch_models.challenge.surface import Surface
from beamtouch_models.metadata import Calibration, Departures
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.whitening import whitening
from in_process import Command

COMMAND = str(Path(sys.executable).parent / "design-sensors")


@pytest.fixture(scope="module")
def surface(bench: ModelFile) -> Surface:
    return Surface.of(bench.metadata)


def only(model: ModelFile, case: Case, draws: int = 150, seed: int = 1) -> list[Row]:
    return rows_of(model, Surface.of(model.metadata), None, case, draws, np.random.default_rng(seed))


def said(*samples: Sample) -> Judged:
    columns = (np.array(column) for column in zip(*samples, strict=True))
    by_name = dict(zip(Sample._fields, columns, strict=True))
    return Judged(**by_name, mean_mm=np.zeros((len(samples), 4)), valid=np.ones((len(samples), 4), np.bool_))


def test_scores_of_samples_by_hand() -> None:
    contact = Said.CONTACT
    judged = said(
        Sample(contact, False, False, 100.0, 90.0, 120.0),  # 100 +20: holds 115
        Sample(contact, False, False, 100.0, 90.0, 120.0),  # 135 is beyond the interval, within twice the half of 20
        Sample(contact, False, False, 100.0, 90.0, 120.0),  # 141 is not
        Sample(contact, False, False, 100.0, 90.0, 120.0),  # 79: more than twice 10 below
        Sample(contact, True, False, 100.0, 90.0, 120.0),  # far off, and said to be unsteady
        Sample(contact, True, False, 100.0, 90.0, 120.0),
        Sample(contact, True, True, 100.0, 90.0, 120.0),
        Sample(Said.CLEAR),
        Sample(Said.UNEXPLAINED, unsteady=True),
        Sample(),
    )
    truth = np.array([115.0, 135.0, 141.0, 79.0, 300.0, 100.0, 100.0, 50.0, 50.0, 50.0])
    row = scored("by hand", judged, truth, honest=True, exact_mm=np.full(10, 20.0))
    assert row == Row(
        name="by hand", honest=True, quiet=False, samples=10, error_mm=(15 + 35 + 41 + 21 + 200) / 7,
        held=0.25, plain=4, held_unsteady=0.5, unsteady=2, held_noted=1.0, unexplained=0.1, noted=0.3, clear=0.1,
        silent=0.1, misleading=0.2, interval_mm=30.0, width=1.5,
    )  # fmt: skip
    nowhere = scored("a fault", judged, np.full(10, np.nan), honest=False)
    assert (nowhere.held, nowhere.error_mm, nowhere.misleading) == (None, None, 0.4)
    assert nowhere.noticed == pytest.approx(0.4)


def test_a_contact_that_begins_twice_is_a_ghost() -> None:
    nothing, clear, contact, unexplained = Said.NOTHING, Said.CLEAR, Said.CONTACT, Said.UNEXPLAINED
    once = [
        [nothing, clear, contact, contact, contact, clear, clear],
        [nothing, clear, contact, unexplained, contact, nothing, contact],
        [contact, contact, clear, clear, clear, clear, clear],
        [clear] * 7,
    ]
    assert ghosts(np.array(once)) == 0
    twice = [
        [nothing, clear, contact, clear, contact, contact, contact],
        [contact, clear, unexplained, unexplained, contact, clear, clear],
    ]
    assert ghosts(np.array(twice)) == 1
    assert ghosts(np.array(once + twice)) == pytest.approx(1 / 3)


def test_a_goal_is_missed_only_by_more_than_chance() -> None:
    good = Row("row", True, True, 400, 1.0, 0.95, 400, 0.95, 400, None, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    assert misses(good) == []
    assert misses(replace(good, held=0.92)) == []  # 32 of 400, where 28 are allowed
    assert misses(replace(good, held=0.88)) == ["held 88%"]
    assert misses(replace(good, held_unsteady=0.85)) == ["held 85% when unsteady"]
    assert misses(replace(good, misleading=0.02)) == ["misleading 2.0%"]
    assert misses(replace(good, noted=0.04)) == ["noted 4.0%"]
    assert misses(replace(good, ghosts=0.04)) == ["ghosts 4.0%"]
    assert misses(replace(good, quiet=False, noted=0.04)) == []
    assert misses(replace(good, width=1.2)) == ["interval 1.20 of the exact one"]
    fault = replace(good, honest=False, noticed=0.8, power=1.0)
    assert misses(fault) == ["noticed 80% of 100%"]
    assert misses(replace(fault, power=0.85)) == []
    assert misses(replace(fault, noticed=0.0, power=0.5)) == []


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


def test_a_touch_is_unsteady_first_and_an_untouched_beam_is_clear(bench: ModelFile, surface: Surface) -> None:
    play = honest.touched(surface, 40, np.random.default_rng(3))
    heard = judge(surface, run_of(bench), surface.readings(play.deflection_mm, play.errors, np.random.default_rng(4)))
    before = play.rows[0][1]
    assert (heard.said[:, :before] == Said.CLEAR).all()
    assert (heard.said[:, -1] == Said.CONTACT).mean() > 0.95
    touched = heard.at([before + 1])
    assert (touched.unsteady | (touched.said == Said.CLEAR)).all()
    assert np.isnan(play.truth_mm[:, before - 1]).all()
    assert not np.isnan(play.truth_mm[:, before]).any()


def test_what_sensors_measure(surface: Surface) -> None:
    draws, random = 400, np.random.default_rng(5)
    position, force = drawn(surface, draws, random)
    clean = np.repeat(surface.under(position, force)[:, None], 60, axis=1)
    exact = surface.perfect(draws)
    noise = surface.readings(clean, exact, random) - clean
    stated_mm = surface.metadata.noise.reading_mm
    assert noise.std() == pytest.approx(stated_mm, rel=0.01)
    assert abs(np.mean(noise[:, 1:] * noise[:, :-1])) < 0.02 * stated_mm**2
    coloured = surface.readings(clean, replace(exact, correlation=0.7), random) - clean
    assert coloured.std() == pytest.approx(stated_mm, rel=0.02)
    assert coloured[:, 0].std() == pytest.approx(stated_mm, rel=0.05)
    assert np.mean(coloured[:, 1:] * coloured[:, :-1]) == pytest.approx(0.7 * stated_mm**2, rel=0.05)
    coarse = surface.readings(clean, replace(exact, step_mm=0.05), random)
    assert len(np.unique(np.round(coarse, 9))) < 60
    assert np.abs(coarse - clean).max() < 0.025 + 7 * stated_mm
    gone = np.zeros((draws, 4), np.bool_)
    gone[:, 2] = True
    assert (np.isnan(surface.readings(clean, replace(exact, missing=gone), random)).all(axis=1) == gone).all()
    beyond = surface.readings(3 * clean, exact, random)
    gap = surface.metadata.sensor.standoff_mm - 3 * clean
    assert (np.isnan(beyond) == (gap < 1.0)).mean() > 0.99
    errors = surface.honest(draws, random)
    measured = surface.measured(clean, errors)[:, 0]
    apart = (measured - clean[:, 0]).std(axis=0)
    expected = np.sqrt((0.003 * clean[:, 0]) ** 2 + 0.001**2)
    np.testing.assert_allclose(apart, np.sqrt((expected**2).mean(axis=0)), rtol=0.15)


def test_noise_is_honest_once_the_user_has_stated_what_was_measured(bench: ModelFile) -> None:
    for make in (noises.coloured, noises.coarse):
        (measured,) = only(bench, Case(True, partial(make, measured=True)), 300)
        assert misses(measured) == []
        assert measured.plain > 280
        (not_stated,) = only(bench, Case(False, partial(make, measured=False)), 300)
        assert measured.held is not None
        assert not_stated.held is not None
        assert not_stated.held < measured.held
        assert not_stated.noted > measured.noted + 0.05  # noise is taken for motion
        assert not_stated.name == f"{measured.name}, not stated"


def test_the_noise_of_a_mean_of_alike_readings() -> None:
    # By hand: of four readings, three pairs are one apart, two are two apart and one is three apart.
    by_hand = (4 + 2 * (3 * 0.7 + 2 * 0.49 + 0.343)) / 4
    assert noises.coloured_times(0.7, 4) == pytest.approx(np.sqrt(by_hand))
    assert noises.coloured_times(0.7, 1) == 1
    # A mean of very many readings: the sum of all correlations, (1 + r) / (1 - r).
    assert noises.coloured_times(0.7, 100_000) == pytest.approx(np.sqrt(1.7 / 0.3), rel=1e-4)


def test_a_tare_takes_out_what_the_sensors_show_at_rest(surface: Surface) -> None:
    errors = surface.perfect(3)
    away_mm = np.array([0.1, 0.0, -0.2, 0.3]) * np.ones((3, 1))
    rest = replace(errors, zero_mm=away_mm, tare_mm=away_mm)
    clean = np.full((3, 50, 4), 0.4)
    plain, tared = (surface.readings(clean, one, np.random.default_rng(2)) for one in (errors, rest))
    np.testing.assert_allclose(plain, tared, atol=1e-4)  # a count is 0.06 um


def test_a_slow_load_is_where_it_is_at_rest_and_a_fast_one_swings_around_it(surface: Surface) -> None:
    def away_mm(speed_mm_per_s: float) -> float:
        play = honest.moves(surface, 20, np.random.default_rng(6), speed_mm_per_s=speed_mm_per_s)
        # The force is the same at all times, so the deflection of the first reading tells it.
        shape = surface.influence(play.truth_mm)
        force = np.linalg.norm(play.deflection_mm[:, :1], axis=2) / np.linalg.norm(shape[:, :1], axis=2)
        return float(np.abs(play.deflection_mm - shape * force[:, :, None]).max())

    assert away_mm(10.0) < 0.002
    assert 0.01 < away_mm(1000.0) < 0.1


def whitened(surface: Surface, fault_mm: np.ndarray) -> np.ndarray:
    covariance = np.eye(surface.channels) * surface.metadata.noise.sample_mm**2
    floor = surface.metadata.floor
    return whitening(fault_mm, covariance, floor.gain, floor.zero_mm)


CASES = (
    Case(False, lambda *a: faults.pulled(*a, times=0.25)),
    Case(False, lambda *a: faults.two_contacts(*a, apart=0.5, ratio=1.0)),
    Case(False, faults.stuck),
)


@pytest.mark.parametrize("case", CASES, ids=["pull", "two contacts", "stuck"])
def test_the_distance_of_a_fault_is_that_of_the_nearest_contact_or_of_rest(surface: Surface, case: Case) -> None:
    fault = case.make(surface, 12, np.random.default_rng(7)).fault_mm
    assert fault is not None
    found = distances(surface, fault, np.ones(fault.shape, np.bool_))
    for row, weights, distance in zip(fault, whitened(surface, fault), found, strict=True):

        def away(at: np.ndarray, row: np.ndarray = row, weights: np.ndarray = weights) -> float:
            place, force = float(np.clip(at[0], 1.0, 399.0)), max(float(at[1]), 0.0)
            return float(np.linalg.norm(weights @ (row - force * surface.influence(place))))

        starts = [np.array([place, force]) for place in np.linspace(1, 399, 30) for force in (0.5, 5.0, 15.0)]
        least = min(minimize(away, start, method="Nelder-Mead").fun for start in sorted(starts, key=away)[:3])
        assert distance == pytest.approx(min(least, away(np.zeros(2))), rel=2e-3, abs=2e-3)


def test_the_power_is_that_of_the_likelihood_ratio_and_no_misfit_does_better(surface: Surface) -> None:
    alpha, random = 1e-3, np.random.default_rng(8)
    fault = faults.two_contacts(surface, 60, random, apart=0.5, ratio=1.0).fault_mm
    assert fault is not None
    every = np.ones(fault.shape, np.bool_)
    distance = distances(surface, fault, every)
    power = power_of_shift(distance, alpha)
    assert 0.3 < power < 0.9
    weights = whitened(surface, fault)
    grid = np.linspace(1, 399, 2001)
    ratio, misfit = [], []
    for row, weight in zip(fault, weights, strict=True):
        shape = surface.influence(grid) @ weight.T
        unit = shape / np.linalg.norm(shape, axis=1, keepdims=True)
        moved = weight @ row
        along = unit @ moved
        nearest = np.argmax(along)
        between = moved - max(along[nearest], 0.0) * unit[nearest]
        sample = moved + random.normal(size=(400, 4))
        ratio.append((sample - (moved - between)) @ between / np.linalg.norm(between) > norm.isf(alpha))
        best = np.maximum(sample @ unit.T, 0.0).max(axis=1)
        misfit.append((sample**2).sum(axis=1) - best**2 > chi2.isf(alpha, 2))
    assert np.mean(ratio) == pytest.approx(power, abs=0.01)
    assert np.mean(misfit) < power + 0.01


def test_the_power_for_a_noisy_channel_is_that_of_its_direction(surface: Surface) -> None:
    alpha, random, draws = 1e-2, np.random.default_rng(9), 60
    position, force = drawn(surface, draws, random)
    clean = surface.under(position, force)
    noise = np.ones(clean.shape)
    noise[np.arange(draws), random.integers(4, size=draws)] = 10.0
    power = power_of_noise(surface, clean, noise, alpha)
    assert 0.2 < power < 0.9
    seen = []
    sample_mm, floor = surface.metadata.noise.sample_mm, surface.metadata.floor
    for at, row, loud, weight in zip(position, clean, noise, whitened(surface, clean), strict=True):
        deviation = np.sqrt((loud * sample_mm) ** 2 + (np.array(floor.gain) * row) ** 2 + np.square(floor.zero_mm))
        error = random.normal(size=(1000, 4)) * deviation @ weight.T
        tangent = np.stack([surface.influence(at), surface.influence(at, 1)], axis=1)
        basis = np.linalg.qr(weight @ tangent)[0]
        left = weight[:, np.argmax(loud)]
        left = left - basis @ (basis.T @ left)
        seen.append(np.abs(error @ left / np.linalg.norm(left)) > norm.isf(alpha / 2))
    assert np.mean(seen) == pytest.approx(power, abs=0.02)


def test_a_calibrated_surface_measures_what_its_model_expects(bench: ModelFile) -> None:
    departures = Departures(
        position_offset_mm=[1.0, -2.0, 0.5, 0.0], gain=[1.02, 0.97, 1.0, 1.01], offset_mm=[0.1, 0.0, -0.05, 0.02],
        curve_per_mm=0.02, rigidity=1.1,
    )  # fmt: skip
    calibration = Calibration(
        departures=departures, fitted=["gain"], loads=9, residual_mm=0.0, error_before_mm=9.0, error_after_mm=1.0
    )
    metadata = bench.metadata.model_copy(update={"calibration": calibration})
    calibrated = Surface.of(metadata)
    moved_mm = calibrated.sensor_mm - Surface.of(bench.metadata).sensor_mm
    np.testing.assert_allclose(moved_mm, [1.0, -2.0, 0.5, 0.0])
    prior = prior_of_model(metadata)
    position, force = drawn(calibrated, 20, np.random.default_rng(10))
    clean = calibrated.under(position, force)
    measured = calibrated.measured(clean[:, None], calibrated.perfect(20))[:, 0]
    np.testing.assert_allclose(measured, prior.stated(force[:, None] * prior.influence_at(position)), rtol=1e-5)
    assert distances(calibrated, measured, np.ones(measured.shape, np.bool_)).max() < 0.05
    assert distances(calibrated, clean, np.ones(measured.shape, np.bool_)).min() > 1


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


def test_the_wrong_channel_is_named_and_two_contacts_are_not_blamed_on_one(bench: ModelFile, surface: Surface) -> None:
    play = faults.wedged(surface, 5, np.random.default_rng(12), touched=True)
    assert play.wrong is not None
    told = naming(surface, run_of(bench), play, np.random.default_rng(13))
    assert told == (1.0, 0.0, 5)
    # Had another channel been wrong, the same answers would blame the wrong one.
    blamed = naming(surface, run_of(bench), replace(play, wrong=(play.wrong + 1) % 4), np.random.default_rng(13))
    assert blamed == (0.0, 1.0, 5)
    two = faults.two_at_the_quarters(surface, 5, np.random.default_rng(14))
    assert two.wrong is None
    assert naming(surface, run_of(bench), two, np.random.default_rng(15)) == (0.0, 0.0, 5)
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


def test_the_command_prints_both_groups_and_one_json_object(design_sensors_here: Command, bench_model: Path) -> None:
    done = design_sensors_here("challenge", bench_model, "--draws", 10, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["draws"], found["seed"]) == (10, 0)
    names = [row["name"] for row in found["rows"]]
    assert len(set(names)) == len(names) > 50
    assert [row["honest"] for row in found["rows"]] == sorted((row["honest"] for row in found["rows"]), reverse=True)
    assert all(row["power"] is not None for row in found["rows"] if not row["honest"])
    named = {row["name"]: row["naming"] for row in found["rows"] if row["naming"]}
    assert named["one channel wedged, no contact"] == {"named": 1.0, "misnamed": 0.0}
    assert named["two contacts at the quarters"] == {"named": 0.0, "misnamed": 0.0}
    gains = {row["name"]: row["honest"] for row in found["rows"] if row["name"].startswith("gains")}
    assert gains == {"gains 0.3 % off": True, "gains 1 % off": False, "gains 3 % off": False}
    table = design_sensors_here("challenge", bench_model, "--draws", 10)
    assert table.returncode == 0
    assert "one contact, honestly measured" in table.stdout
    assert "faults and other worlds" in table.stdout
    assert "Rows that miss the goals" in table.stdout


@pytest.mark.parametrize("name", ["bench", "cantilever", "paper"])
def test_a_beam_that_rings_after_a_lift_is_not_touched(name: str, built_model: Callable[[str], Path]) -> None:
    """Readings beyond the range on the bench, replaced ones on the cantilever, single ones on the paper's beam."""
    *_, last = only(modelfile.load(built_model(name)), Case(True, honest.lifts), 60)
    assert last.ghosts is not None
    assert last.ghosts <= 1 / 60


def test_a_model_without_a_stated_mass_is_challenged_without_ringing(bench: ModelFile) -> None:
    text = bench.metadata.scene.replace("density_kg_m3 = 7850\n", "")
    bare = replace(bench, metadata=bench.metadata.model_copy(update={"scene": text}))
    surface = Surface.of(bare.metadata)
    assert surface.modes is None
    assert surface.slowest_period == 0
    assert not any("rings" in str(case.make) for case in honest.honest_cases(surface))
    rows = only(bare, Case(True, lambda *a: honest.moves(*a, speed_mm_per_s=30.0)), 10)
    assert rows[0].samples == 50


def test_a_model_that_states_no_log_odds_is_refused(
    design_sensors_here: Command, bench_model: Path, tmp_path: Path
) -> None:
    graph = onnx.load(bench_model)
    for output in [one for one in graph.graph.output if one.name == "contact_log_odds"]:
        graph.graph.output.remove(output)
    path = tmp_path / "silent.onnx"
    onnx.save(graph, path)
    done = design_sensors_here("challenge", path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "contact_log_odds" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "said_so"),
    [
        (("--help",), 0, "--draws"),
        (("no.onnx",), 2, "No such file"),
        (("no.onnx", "--draws", "9"), 2, "from 10 to 10000"),
        ((), 2, "required: MODEL"),
    ],
)
def test_help_and_bad_requests(
    design_sensors_here: Command, arguments: tuple[str, ...], code: int, said_so: str
) -> None:
    done = design_sensors_here("challenge", *arguments)
    assert done.returncode == code
    assert said_so in (done.stdout if code == 0 else done.stderr)
    assert done.stderr.count("\n") == (1 if code else 0)


def test_ctrl_c_is_130(bench_model: Path) -> None:
    with subprocess.Popen(
        [COMMAND, "challenge", str(bench_model), "--draws", "10000"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            # The command loads the runtime only once it is at work.
            while "onnxruntime" not in Path(f"/proc/{process.pid}/maps").read_text():
                assert process.poll() is None
                time.sleep(0.05)
            process.send_signal(signal.SIGINT)
            told = process.communicate(timeout=60)
        finally:
            process.kill()
    assert (process.returncode, told) == (130, ("", "design-sensors: interrupted\n"))
