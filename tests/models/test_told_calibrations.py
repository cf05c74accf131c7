"""What `design-sensors calibrate` says of fits whose figures are known."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.calibrate import Calibrated
from beamtouch_models.design.calibration.fit import Fit, fit
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.self_calibrate import SelfCalibrated, SelfFit
from beamtouch_models.design.calibration.unlabelled import ContactFit, RemainingUncertainty
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.departures import Calibration, Departures
from beamtouch_models.runtime.health.residuals import LoadErrors
from models.calibration_files import write_contacts, write_readings
from models.nominal_beam import loads_on, nominal_of
from support.programs.in_process import Command, Outcome
from support.surfaces.deflections import deflections_of

TRUE = Departures(
    position_offset_mm=[1.25, -0.5, 0.0, 3.0],
    gain=[1.03, 0.975, 1.0, 1.02],
    offset_mm=[0.0125, -0.003, 0.0, 0.00625],
    curve_per_mm=-0.0123,
    fixity=(0.125, 0.0),
    rigidity=0.8,
)
"""With 0.8 of its rigidity, a beam deflects a quarter more per newton."""
KINDS = ("rigidity", "gain", "position", "curve", "fixity", "offset")
PLACES_MM, FORCES_N = np.array([40.0, 130.0, 170.0, 210.0, 290.0, 370.0]), np.array([4.0, 8.0, 12.0, 4.0, 8.0, 12.0])


@pytest.fixture(scope="module")
def nominal() -> NominalSurface:
    return nominal_of()


@pytest.fixture(scope="module")
def plain(nominal: NominalSurface) -> Fit:
    """The fit of a recording, which lends the others its session."""
    return fit(nominal, loads_on(nominal, nominal.vector_of(TRUE)), KINDS, rounds=1)


def fitted(plain: Fit, *more: str, rigidity_error: float = 0.016) -> Fit:
    """Return the true departures as if they had been fitted, with what a recording may add beside them.

    A plausible weight is a tenth of 11 N, a plausible shift a fiftieth of 400 mm, and a plausible drift 1 um a minute.
    """
    kinds, nominal = plain.session.kinds, plain.nominal
    vector, spread = np.zeros(plain.session.size), np.zeros(plain.session.size)
    vector[: nominal.size] = nominal.vector_of(TRUE)
    of_one = nominal.standard_errors(vector, np.ones(plain.session.size))["rigidity"][0]
    spread[kinds["rigidity"]] = rigidity_error / of_one
    for kind, value, error in (("weight", 0.5, 0.2), ("shift", -0.25, 0.05), ("drift", [1.5, -0.5, 0.25, 2.0], 0.125)):
        vector[kinds[kind]], spread[kinds[kind]] = value, error
    errors = LoadErrors(placing_mm=1.234, force=0.0075)
    return replace(plain, kinds=(*KINDS, *more), vector=vector, covariance=np.diag(spread**2), errors=errors)


Told = Callable[..., Outcome]


@pytest.fixture
def told(
    design_sensors_here: Command, bench_model: Path, bench: ModelFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Told:
    """Runs the command on loads of these forces, with a fit as if it had been found."""

    def run(found: Fit, *options: object, force_n: Floats = FORCES_N) -> Outcome:
        errors_mm = np.array([2.5, 3.5, 6.5, 3.0]), np.array([0.25, 0.75, 1.5, 0.3])
        made = Calibrated(found, *errors_mm, ("shift",), bench_model.read_bytes(), bench.metadata, 0.4567)
        monkeypatch.setattr("beamtouch_models.commands.calibrate.calibrate", lambda *_: made)
        path = tmp_path / "loads.csv"
        write_readings(path, bench, deflections_of(bench, PLACES_MM, force_n), PLACES_MM, force_n)
        done = design_sensors_here("calibrate", bench_model, path, "-o", tmp_path / "new.onnx", *options)
        assert done.returncode == 0, done.stderr
        return done

    return run


def rows(done: Outcome) -> dict[str, str]:
    """Return the printed figures by the word before them."""
    return dict(line.split(maxsplit=1) for line in done.stdout.splitlines())


def test_the_loads_are_told_with_their_number_and_errors_before_and_after(told: Told, plain: Fit) -> None:
    said = rows(told(fitted(plain)))
    assert said["loads"] == "4, placed to about 1.2 mm and with forces known to about 0.75 %"
    assert said["before"] == "3.88 mm mean error of these loads, 6.5 mm worst"
    assert said["after"] == "0.7 mm mean, 1.5 mm worst, each by a fit without the load"
    assert said["limit"] == "0.457 mm mean error of single samples of these loads, at best"
    assert list(said) == ["model", "loads", "scale", *KINDS[1:4], "offset", "fixity", "before", "after", "limit"]


def test_fields_have_the_same_in_their_units(told: Told, plain: Fit, bench: ModelFile) -> None:
    done = told(fitted(plain, "weight", "shift"), "--json", "--leave-out", 4, "--leave-out", 2, "--leave-out", 4)
    found: dict[str, Any] = json.loads(done.stdout)
    assert found["error_before_mm"] == {"mean": 3.875, "worst": 6.5}
    assert found["error_after_mm"] == {"mean": 0.7, "worst": 1.5}
    assert (found["limit_mm"], found["placing_mm"], found["force_percent"]) == (0.4567, 1.234, 0.75)
    assert found["scale"] == {"value": pytest.approx(0.25), "standard_error": pytest.approx(0.025)}
    assert found["standard_errors"]["rigidity"] == pytest.approx([0.016])
    weight, shift = found["added_force_n"], found["shift_mm"]
    assert weight == {"value": pytest.approx(0.55), "standard_error": pytest.approx(0.22), "is_sure": False}
    assert shift == {"value": pytest.approx(-2.0), "standard_error": pytest.approx(0.4), "is_sure": True}
    assert found["drift_um_per_min"] == pytest.approx([1.5, -0.5, 0.25, 2.0])
    assert found["loads_left_out"] == [2, 4]
    assert found["accuracy"]["ratio"] == bench.metadata.accuracy.ratio
    bare = json.loads(told(fitted(plain), "--json").stdout)
    assert (bare["added_force_n"], bare["shift_mm"], bare["loads_left_out"]) == (None, None, [])


def test_what_a_recording_adds_is_told_where_it_was_fitted(told: Told, plain: Fit) -> None:
    said = rows(told(fitted(plain, "weight", "shift", "drift")))
    assert said["drift"] == "s1 +1.50 +- 0.12, s2 -0.50 +- 0.12, s3 +0.25 +- 0.12, s4 +2.00 +- 0.12 um a minute"
    assert said["forces"].startswith("perhaps each load presses with 0.55 +- 0.22 N more than stated, ")
    assert said["places"].startswith("each load stands 2 +- 0.4 mm farther left than stated, ")


GAUGE, SAME = "measure one beside a sensor with a dial gauge", "all loads have about the same force"


@pytest.mark.parametrize(("error", "is_scaled"), [(0.016, True), (0.079, True), (0.081, False)])
def test_a_scale_that_is_more_than_chance_is_told_with_what_tells_its_causes_apart(
    told: Told, plain: Fit, error: float, is_scaled: bool
) -> None:
    """A quarter is more than twice its standard error if that is less than an eighth: 0.08 of the rigidity."""
    done = told(fitted(plain, rigidity_error=error))
    assert rows(done)["scale"].startswith("deflects 25 +- ")
    assert (GAUGE in done.noted) is is_scaled
    assert SAME not in done.noted


@pytest.mark.parametrize(
    ("force_n", "error", "is_told"),
    [
        ([10.0, 10.0, 10.0, 10.0, 10.0, 10.0], 0.016, True),
        ([9.1, 10.0, 10.0, 10.0, 10.0, 10.9], 0.016, True),  # a range of 1.8 N, and 20 % of the mean are 2 N
        ([8.9, 10.0, 10.0, 10.0, 10.0, 11.1], 0.016, False),
        ([10.0, 10.0, 10.0, 10.0, 10.0, 10.0], 0.2, False),
    ],
)
def test_loads_of_one_force_would_hide_a_weight_that_shows_as_a_scale(
    told: Told, plain: Fit, force_n: list[float], error: float, is_told: bool
) -> None:
    done = told(fitted(plain, rigidity_error=error), force_n=np.array(force_n))
    assert (SAME in done.noted) is is_told


def test_where_loads_tell_the_rigidity_from_gains_there_is_no_scale_and_one_force_is_always_told(
    told: Told, plain: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("beamtouch_models.commands.calibrate.has_one_scale", lambda _: False)
    done = told(fitted(plain), force_n=np.full(6, 10.0))
    said = rows(done)
    assert "scale" not in said
    assert said["rigidity"] == "-20.00 +- 1.60 %"
    assert SAME in done.noted
    assert GAUGE not in done.noted
    assert json.loads(told(fitted(plain), "--json").stdout)["scale"] is None


@pytest.mark.parametrize(
    ("option", "value", "refused"),
    [
        ("placing-mm", "0.00099", "0.00099"), ("placing-mm", "50.1", "50.1"), ("force-percent", "0", "0"),
        ("mounting-mm", "nan", "nan"), ("mounting-mm", "51", "51"),
    ],
)  # fmt: skip
def test_nobody_places_or_weighs_loads_so_well_or_so_badly(
    design_sensors_here: Command, bench_model: Path, tmp_path: Path, option: str, value: str, refused: str
) -> None:
    done = design_sensors_here(
        "calibrate", bench_model, tmp_path / "no.csv", "-o", tmp_path / "new.onnx", f"--{option}", value
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.endswith(f"--{option} {refused} is not from 0.001 to 50\n")


def test_a_fit_to_contacts_is_told_with_what_it_leaves_open(
    design_sensors_here: Command,
    bench_model: Path,
    bench: ModelFile,
    nominal: NominalSurface,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    vector, spread = nominal.vector_of(TRUE), np.zeros(nominal.size)
    spread[nominal.kinds["gain"]] = 0.5  # of 4 %
    found = ContactFit(
        nominal, ("gain", "offset"), vector, np.zeros((16, 16)), np.zeros(16), size=0.5, left_error=0.001,
        position_mm=np.linspace(1.0, 399.0, 20), single=np.array([1.0] * 16 + [0.35] * 4), misfit=np.full(20, 2.0),
        penalty=3.0,
    )  # fmt: skip
    remaining = RemainingUncertainty(
        np.array([0.3, 0.4, 0.0, 0.5]), 1.234, np.zeros((4, 1, 4)), np.diag(spread**2), np.zeros(4), 0.0
    )
    calibration = Calibration(departures=TRUE, fitted=["gain"], loads=0, residual_mm=0.0, force_error=0.0314)
    floor = bench.metadata.floor.model_copy(update={"gain": [0.004, 0.0025, 0.003, 0.003]})
    fresh = bench.metadata.model_copy(update={"calibration": calibration, "floor": floor})
    made = SelfCalibrated(bench_model.read_bytes(), fresh, SelfFit(found, remaining, 7.654, 2.345))
    monkeypatch.setattr("beamtouch_models.commands.calibrate.self_calibrate", lambda *_: made)
    measured_mm = deflections_of(bench, np.linspace(20.0, 380.0, 20), np.full(20, 9.0))
    path = write_contacts(tmp_path / "contacts.csv", bench, measured_mm, np.full((20, 4), 0.002))
    given = "calibrate", bench_model, "--events", path, "-o", tmp_path / "new.onnx"
    said = rows(design_sensors_here(*given))
    assert said["contacts"] == "20, of which about 3 are not single contacts"
    # The median of chi squared with two degrees of freedom, 2 ln 2: of four channels, less place and force.
    assert said["misfit"] == "7.65 before, 2.35 after (medians; 1.39 from noise alone)"
    assert said["position"].endswith("changes by 1.23 mm (root mean square), 0.354 mm left open")
    assert said["force"] == "its scale stays open by 3.1 %"
    assert said["floor"] == "gains +- 0.3 % before, +- 0.25..0.4 % now"
    assert said["gain"] == "s1 +3.00 +- 2.06, s2 -2.50 +- 1.95, s3 +0.00 +- 2.00, s4 +2.00 +- 2.04 %"
    fields = json.loads(design_sensors_here(*given, "--json").stdout)
    assert fields["misfit"] == {"before": 7.654, "after": 2.345, "expected": pytest.approx(2 * np.log(2))}
    assert fields["open_mm"] == pytest.approx((0.5 / 4) ** 0.5)
    assert (fields["changed_mm"], fields["contacts_left_out"]) == (1.234, 0)
    assert fields["single_contacts"] == pytest.approx(17.4)
    assert set(fields["standard_errors"]) == {"gain", "position", "curve", "offset"}
    known = fresh.model_copy(update={"calibration": calibration.model_copy(update={"force_error": 0.0})})
    made = replace(made, metadata=known)
    assert "force" not in rows(design_sensors_here(*given))
