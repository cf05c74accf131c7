"""Calibration that doubts itself: a channel that does not fit, a forgotten weight, drift, and cables swapped since."""

import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import runtime
from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.design.calibration.calibrate import CheckedFit, calibrate, checked_fit
from beamtouch_models.design.calibration.doubts import common_in_words
from beamtouch_models.design.calibration.recordings import Loads, read_loads
from beamtouch_models.design.calibration.session import SHIFT
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.rows import RecordingError
from beamtouch_models.design.sweeps import silent
from beamtouch_models.lab.rig.surface import PERFECT, Imperfections
from beamtouch_models.places import on_axis
from beamtouch_models.runtime import ModelFile
from models.calibration_files import write_readings
from models.doubtful_recordings import bent_mm, doubtful
from support.programs.in_process import Command
from support.surfaces.deflections import deflections_of
from support.surfaces.example_scenes import ROUGH
from support.surfaces.real_surfaces import deflections_on, random_imperfections, recorded, true_prior

pytestmark = pytest.mark.long

PLACES_MM, FORCES_N = np.linspace(29.0, 191.0, 10), np.tile([2.25, 1.1], 5)
"""Of ten loads of two forces on the cantilever."""


@pytest.fixture
def cantilever(built_model: Callable[[str], Path]) -> ModelFile:
    return runtime.load(built_model("cantilever"))


def refusal(design_sensors_here: Command, folder: Path, model: Path, loads: Path) -> str:
    """Return the line with which `calibrate` refuses a recording."""
    done = design_sensors_here("calibrate", model, loads, "-o", folder / "out.onnx")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert not (folder / "out.onnx").exists()
    return done.stderr


@pytest.mark.promise(
    "docs/how-to/calibrate.md",
    "one channel bends as no other does: its table, its range, or a curved sensor that is described as straight",
)
def test_a_curved_sensor_that_is_described_as_straight_is_named_with_what_to_do(
    design_sensors_here: Command, built_model: Callable[[str], Path], cantilever: ModelFile, tmp_path: Path
) -> None:
    measured_mm = deflections_of(cantilever, PLACES_MM, FORCES_N)
    measured_mm[:, 2] = bent_mm(measured_mm[:, 2], 0.15)
    path = write_readings(tmp_path / "loads.csv", cantilever, measured_mm, PLACES_MM, FORCES_N)
    line = refusal(design_sensors_here, tmp_path, built_model("cantilever"), path)
    assert "s3 does not fit, as if its characteristic were another" in line
    assert "Check its table, or measure one with feeler gauges" in line
    assert line.count("does not fit") == 1
    figures = re.search(r"where it shows (\S+) mm, the loads say (\S+) mm", line)
    assert figures is not None
    shown, true = (float(number) for number in figures.groups())
    assert shown / true == pytest.approx(1.15, abs=0.04)


SOFT = Imperfections(rigidity=0.95, gain=(1.02, 1.0, 0.98))
"""A cantilever that deflects 5.26 % more per newton than its scene says."""
WEIGHTS_N = np.array([0.8, 1.6, 3.2])[[0, 1, 2, 2, 0, 1, 1, 2, 0, 1]]
"""Three weights in turn."""


def written_for(run: Command, model: Path, loads: Path) -> tuple[dict[str, str], str]:
    """Calibrate; returns the rows that are printed, and what is remarked."""
    done = run("calibrate", model, loads, "-o", loads.with_suffix(".onnx"))
    assert done.returncode == 0, done.stderr
    lines = done.stdout.replace("\n   ", " ").splitlines()  # of wrapped rows, too
    return dict(line.split(maxsplit=1) for line in lines), " ".join(done.stderr.split())


@pytest.mark.promise("docs/how-to/calibrate.md", "Every load presses harder than stated, by a hanger or a pan")
def test_a_hanger_that_nobody_weighed_is_named_with_its_weight_and_the_model_does_without_it(
    design_sensors_roughly: Command, built_model: Callable[[str], Path], cantilever: ModelFile, tmp_path: Path
) -> None:
    measured_mm = deflections_on(cantilever.metadata, SOFT, PLACES_MM, WEIGHTS_N + 0.3)
    path = write_readings(tmp_path / "loads.csv", cantilever, measured_mm, PLACES_MM, WEIGHTS_N)
    rows, _ = written_for(design_sensors_roughly, built_model("cantilever"), path)
    told = re.match(
        r"each load presses with (\S+) \+- (\S+) N more than stated, as with a hanger or a pan", rows["forces"]
    )
    assert told is not None
    assert float(told[1]) == pytest.approx(0.3, abs=3 * float(told[2]))
    assert float(told[2]) < 0.05
    assert "places" not in rows
    # The weight is not in the model.
    found = prior_of_model(runtime.load(path.with_suffix(".onnx")).metadata).influence_at(on_axis(PLACES_MM[2:]))
    assert found == pytest.approx(true_prior(cantilever.metadata, SOFT).influence_at(on_axis(PLACES_MM[2:])), rel=0.03)


@pytest.mark.soak
def test_forces_that_count_a_pan_which_was_tared_are_named_as_too_large(
    design_sensors_roughly: Command, built_model: Callable[[str], Path], cantilever: ModelFile, tmp_path: Path
) -> None:
    measured_mm = deflections_on(cantilever.metadata, SOFT, PLACES_MM, WEIGHTS_N)
    path = write_readings(tmp_path / "loads.csv", cantilever, measured_mm, PLACES_MM, WEIGHTS_N + 0.3)
    done = design_sensors_roughly("calibrate", built_model("cantilever"), path, "-o", tmp_path / "out.onnx", "--json")
    found = json.loads(done.stdout)
    added = found["added_force_n"]
    assert added["is_sure"]
    assert added["value"] == pytest.approx(-0.3, abs=3 * added["standard_error"])
    assert found["scale"]["value"] == pytest.approx(0.0526, abs=3 * found["scale"]["standard_error"])
    assert found["shift_mm"] is None
    checked = checked_fit(cantilever, loads_of(cantilever, measured_mm, WEIGHTS_N + 0.3), silent)
    assert re.match(r"each load presses with \S+ \+- \S+ N less than stated, as if the pan", told_of(checked)["forces"])


@pytest.mark.promise("docs/how-to/calibrate.md", "Positions that do not count from the left end of the beam")
def test_loads_that_all_stand_farther_right_than_stated_are_named_with_the_distance(cantilever: ModelFile) -> None:
    measured_mm = deflections_on(cantilever.metadata, SOFT, PLACES_MM, WEIGHTS_N)
    checked = checked_fit(cantilever, loads_of(cantilever, measured_mm, WEIGHTS_N, PLACES_MM - 4.0), silent)
    assert checked.sure == (SHIFT,)
    told = re.match(r"each load stands (\S+) \+- (\S+) mm farther right than stated", told_of(checked)["places"])
    assert told is not None
    assert float(told[1]) == pytest.approx(4.0, abs=3 * float(told[2]))
    assert checked.fit.errors.placing_mm < 0.5
    errors_mm = checked.fit.nominal.standard_errors(checked.fit.vector, checked.fit.spread)["position"]
    assert (np.abs(checked.fit.departures.position_offset_mm) < 3 * errors_mm).all()


@pytest.mark.promise("docs/how-to/calibrate.md", "A load that is wrong is still named beside it")
def test_a_mistyped_load_is_named_beside_a_hanger(cantilever: ModelFile) -> None:
    measured_mm = deflections_on(cantilever.metadata, SOFT, PLACES_MM, WEIGHTS_N + 0.9)
    is_sixth = np.arange(10) == 5
    for places_mm, forces_n in (
        (PLACES_MM + 40 * is_sixth, WEIGHTS_N),
        (PLACES_MM, WEIGHTS_N * (1 + is_sixth)),
    ):
        with pytest.raises(RecordingError, match=r"^load 6 \(lines 1002 to 1201\) says"):
            checked_fit(cantilever, loads_of(cantilever, measured_mm, forces_n, places_mm), silent)


@pytest.mark.promise(
    "docs/how-to/calibrate.md",
    "A beam that is softer by a percent and gains that are all larger by a percent look the same under known loads",
)
def test_what_scales_all_deflections_is_said_once_and_no_gain_holds_it(
    design_sensors_roughly: Command, built_model: Callable[[str], Path], cantilever: ModelFile, tmp_path: Path
) -> None:
    measured_mm = deflections_on(cantilever.metadata, SOFT, PLACES_MM, WEIGHTS_N)
    path = write_readings(tmp_path / "loads.csv", cantilever, measured_mm, PLACES_MM, WEIGHTS_N)
    rows, remark = written_for(design_sensors_roughly, built_model("cantilever"), path)
    told = re.match(
        r"deflects (\S+) \+- (\S+) % more per newton than the scene says: rigidity, gains or", rows["scale"]
    )
    assert told is not None
    assert float(told[1]) == pytest.approx(5.26, abs=3 * float(told[2]))
    assert float(told[2]) < 2.5
    assert "measure one beside a sensor with a dial gauge" in remark
    assert not {"rigidity", "forces", "places"} & set(rows)
    gains = np.array(re.findall(r"s\d (\S+) \+- (\S+?),? ", f"{rows['gain']} ")).astype(np.float64)
    # Beside the sensor whose gain is the median, whichever that is.
    middle, real = gains[:, 0].argsort()[1], np.array([2.0, 0.0, -2.0])
    assert (np.abs(gains[:, 0] - (real - real[middle])) < 3 * gains[:, 1] + 0.006).all()
    assert np.median(gains[:, 0]) == pytest.approx(0.0, abs=0.006)


def test_the_gain_of_a_single_sensor_that_is_off_stays_its_own(cantilever: ModelFile) -> None:
    single = Imperfections(gain=(1.0, 1.08, 1.0))
    measured_mm = deflections_on(cantilever.metadata, single, PLACES_MM, WEIGHTS_N)
    fit = checked_fit(cantilever, loads_of(cantilever, measured_mm, WEIGHTS_N), silent, mounting_mm=0.1).fit
    assert fit.departures.gain == pytest.approx(single.gain, abs=0.01)
    assert fit.departures.rigidity == pytest.approx(1.0, abs=0.01)


def test_gains_that_are_all_larger_alike_give_the_model_of_a_softer_beam(cantilever: ModelFile) -> None:
    alike = Imperfections(gain=tuple(np.array(SOFT.gain) / 0.95))
    fits = [
        checked_fit(cantilever, loads_of(cantilever, measured_mm, WEIGHTS_N), silent).fit
        for measured_mm in (deflections_on(cantilever.metadata, real, PLACES_MM, WEIGHTS_N) for real in (SOFT, alike))
    ]
    influences = [fit.nominal.prior_with(fit.departures).influence_at(on_axis(PLACES_MM)) for fit in fits]
    assert influences[0] == pytest.approx(influences[1], rel=1e-6)
    assert influences[0] == pytest.approx(
        true_prior(cantilever.metadata, alike).influence_at(on_axis(PLACES_MM)), rel=0.003
    )


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/calibrate.md", "with equal weights, a hanger that nobody weighed would pass for")
def test_equal_weights_are_remarked_where_a_hanger_may_hide_in_the_scale(
    design_sensors_roughly: Command, built_model: Callable[[str], Path], cantilever: ModelFile, tmp_path: Path
) -> None:
    equal_n = np.full(10, 2.25)
    for added_n, is_said in ((0.3, True), (0.0, False)):
        measured_mm = deflections_of(cantilever, PLACES_MM, equal_n + added_n)
        path = write_readings(tmp_path / f"{is_said}.csv", cantilever, measured_mm, PLACES_MM, equal_n)
        rows, remark = written_for(design_sensors_roughly, built_model("cantilever"), path)
        assert ("a weight that was forgotten would pass for a softer beam" in remark) == is_said
        assert "forces" not in rows


def loads_of(model: ModelFile, measured_mm: Floats, stated_n: Floats, stated_mm: Floats = PLACES_MM) -> Loads:
    """Return loads with deflections (loads, channels) as a recording has them."""
    rng = np.random.default_rng(5)
    plain = recorded(model.metadata, PERFECT, rng)
    noisy_mm = measured_mm + plain.deviation_mm * rng.normal(size=measured_mm.shape)
    return dataclasses.replace(plain, place_mm=on_axis(stated_mm), force_n=stated_n, measured_mm=noisy_mm)


def told_of(checked: CheckedFit) -> dict[str, str]:
    return common_in_words(checked.fit, checked.sure)


def found_in(model: ModelFile, wrong: str, seed: int) -> tuple[CheckedFit, Imperfections]:
    """Return the fit to a recording of a random surface, and that surface."""
    rng = np.random.default_rng([seed, 7])
    real = random_imperfections(model.metadata, rng)
    loads, _ = doubtful(model.metadata, real, wrong, rng)
    return checked_fit(model, loads, silent), real


@pytest.mark.promise("docs/how-to/calibrate.md", "and the stated errors hold what that leaves open")
@pytest.mark.parametrize(
    ("wrong", "seeds"), [("drift", 2), *(pytest.param(wrong, 4, marks=pytest.mark.soak) for wrong in ("none", "drift"))]
)
def test_stated_intervals_of_the_sensors_places_hold_the_truth(wrong: str, seeds: int, cantilever: ModelFile) -> None:
    held = list[bool]()
    for seed in range(seeds):
        found, real = found_in(cantilever, wrong, seed)
        errors_mm = found.fit.nominal.standard_errors(found.fit.vector, found.fit.spread)["position"]
        off_mm = np.array(found.fit.departures.position_offset_mm) - np.array(real.position_offset_mm)
        held += (np.abs(off_mm) < 2 * errors_mm).tolist()
    assert np.mean(held) > 0.9


@pytest.mark.promise(
    "docs/how-to/calibrate.md",
    "Zeros that drift while you record are fitted with the times of the loads.",
)
@pytest.mark.promise(
    "docs/reference/loads.md",
    "if each row has it, the drift of the zeros during the recording is fitted",
)
def test_drift_during_the_session_is_fitted_with_the_times_of_the_loads(cantilever: ModelFile) -> None:
    metadata, rng = cantilever.metadata, np.random.default_rng(3)
    loads = recorded(metadata, random_imperfections(metadata, rng), rng)
    rates = np.array([4.0, 6.0, 3.0])
    drifted_mm = loads.measured_mm + 1e-3 * rates * loads.minutes[:, None]
    told = list[tuple[str, float]]()
    drifted = dataclasses.replace(loads, measured_mm=drifted_mm)
    found = checked_fit(cantilever, drifted, lambda words, share: told.append((words, share))).fit
    assert [words for words, _ in told] == [
        *["looking for loads that do not fit"] * 10, "fitting", *["leaving out one load at a time"] * 10,
    ]  # fmt: skip
    shares = [*np.arange(10) * 0.03, 0.4, *0.5 + np.arange(10) * 0.02]
    assert [share for _, share in told] == pytest.approx(shares)
    assert found.session.rates_um_per_min(found.vector) == pytest.approx(rates, abs=0.5)


def test_the_times_of_a_recording_are_those_of_its_loads(cantilever: ModelFile, tmp_path: Path) -> None:
    measured_mm = deflections_of(cantilever, PLACES_MM, FORCES_N)
    path = write_readings(tmp_path / "loads.csv", cantilever, measured_mm, PLACES_MM, FORCES_N)
    text = re.sub(r"(?m)^0\.0,(\d+),", lambda row: f"{1.7e9 + 30 * int(row[1])},{row[1]},", path.read_text())
    path.write_text(text)
    assert read_loads(path, cantilever.metadata).minutes == pytest.approx(np.arange(10) / 2)
    # Typed by hand, one has no time.
    path.write_text(text.replace("1700000060.0,2,", ",2,", 1))
    assert not read_loads(path, cantilever.metadata).minutes.any()


def swapped_since_the_tare(loads: Loads, rest_mm: float) -> Loads:
    """Return loads of three channels whose outer cables were swapped after the tare, with rest gaps that differ."""
    swapped_mm = loads.measured_mm[:, ::-1] + rest_mm * np.array([1.0, 0.0, -1.0])
    return dataclasses.replace(loads, measured_mm=swapped_mm)


@pytest.mark.promise("docs/how-to/calibrate.md", "two cables, also if they were swapped after the tare")
def test_cables_that_were_swapped_since_the_tare_are_named_where_rest_gaps_differ(cantilever: ModelFile) -> None:
    rng = np.random.default_rng(4)
    loads = recorded(cantilever.metadata, random_imperfections(cantilever.metadata, rng), rng)
    for rest_mm in (0.0, 0.3, -1.0):
        with pytest.raises(RecordingError, match="s1 and s3 seem to be swapped; check the wiring"):
            checked_fit(cantilever, swapped_since_the_tare(loads, rest_mm), silent)


@pytest.mark.promise("docs/how-to/calibrate.md", "a knock, or a load that lay on the beam at the tare")
def test_zeros_that_moved_far_since_the_tare_are_named(cantilever: ModelFile) -> None:
    rng = np.random.default_rng(4)
    loads = recorded(cantilever.metadata, random_imperfections(cantilever.metadata, rng), rng)
    moved = dataclasses.replace(loads, measured_mm=loads.measured_mm + np.array([0.0, 0.3, 0.0]))
    with pytest.raises(RecordingError, match=r"zeros have moved since the tare: s2 by 0\.3\d* mm; tare with nothing"):
        checked_fit(cantilever, moved, silent)


def test_what_zeros_drifted_while_loads_were_recorded_is_in_the_floor(cantilever: ModelFile) -> None:
    metadata, rng = cantilever.metadata, np.random.default_rng(3)
    loads = recorded(metadata, random_imperfections(metadata, rng), rng)
    drift_mm = 1e-3 * np.array([4.0, 6.0, 3.0]) * loads.minutes[:, None]
    moved = dataclasses.replace(loads, measured_mm=loads.measured_mm + drift_mm)
    floor = calibrate(cantilever, moved, silent, effort=Effort(ROUGH)).metadata.floor
    assert (np.array(floor.zero_mm) > 0.9 * drift_mm.max(axis=0)).all()
