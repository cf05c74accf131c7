"""The arithmetic of calibration on the paper's beam: departures, slopes, steps and a recording's own kinds.

Slopes are compared with differences, steps with plain linear algebra, and units with the values that are stated.
"""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibration.choice import shares_of_scale
from beamtouch_models.design.calibration.fit import fit
from beamtouch_models.design.calibration.nominal_surface import NominalSurface, best_step
from beamtouch_models.design.calibration.session import COMMON, DRIFTING, SHIFT, WEIGHT, Session, bend_of
from beamtouch_models.design.physics.structure import influence_of
from beamtouch_models.runtime.departures import Departures
from beamtouch_models.runtime.error_model import Errors
from models.nominal_beam import LARGEST_MM, NOISE_MM, loads_on, nominal_of
from models.scene_limits import PLATE, made

SIZE = 1 + 4 + 4 + 1 + 2 + 4
"""Rigidity, gains, positions, curve, fixities and offsets."""


@pytest.fixture(scope="module")
def nominal() -> NominalSurface:
    return nominal_of()


def random_vector(seed: int, size: int = SIZE) -> Floats:
    vector = np.random.default_rng(seed).uniform(-0.9, 0.9, size)
    vector[10:12] = np.abs(vector[10:12]) + 0.1
    return vector


def test_an_entry_of_one_is_a_plausible_departure(nominal: NominalSurface) -> None:
    vector = random_vector(1)
    found = nominal.departures(vector)
    assert nominal.size == SIZE
    assert found.rigidity == pytest.approx(np.exp(0.1 * vector[0]))
    assert found.gain == pytest.approx(np.exp(0.04 * vector[1:5]))
    assert found.position_offset_mm == pytest.approx(1.5 * vector[5:9])
    assert found.curve_per_mm == pytest.approx(0.03 / LARGEST_MM * vector[9])
    assert found.fixity == pytest.approx(0.1 * vector[10:12])
    assert found.offset_mm == pytest.approx(3 * NOISE_MM * vector[12:])
    assert nominal.vector_of(found) == pytest.approx(vector)
    vector[10:12] = -1.0, 9.5
    assert nominal.departures(vector).fixity == pytest.approx((0.0, 0.9))
    steady = replace(nominal, mounting_mm=0.25)
    assert steady.departures(vector).position_offset_mm == pytest.approx(0.25 * vector[5:9])


def test_an_entry_of_one_is_a_plausible_departure_of_a_plate_with_springs() -> None:
    scene = made(PLATE)
    assert scene.plate is not None
    sensor_mm = np.array([[40.0, 70.0], [310.0, 50.0], [200.0, 255.0]])
    prior = Prior.of(influence_of(scene), sensor_mm, Errors(0.007))
    nominal = NominalSurface(scene.plate, 0.0, sensor_mm, prior, 1.3, 0.001, "mm", None)
    vector = np.random.default_rng(4).uniform(-0.9, 0.9, 1 + 3 + 3 + 3 + 1 + 4 + 3)
    found = nominal.departures(vector)
    assert nominal.size == len(vector)
    assert found.rigidity == pytest.approx(np.exp(0.1 * vector[0]))
    assert found.gain == pytest.approx(np.exp(0.04 * vector[1:4]))
    assert found.position_offset_mm == pytest.approx(1.5 * vector[4:7])
    assert found.across_offset_mm == pytest.approx(1.5 * vector[7:10])
    assert found.curve_per_mm == pytest.approx(0.03 / 1.3 * vector[10])
    assert found.spring_stiffness == pytest.approx(np.exp(0.1 * vector[11:15]))
    assert found.offset_mm == pytest.approx(3 * 0.007 * vector[15:])
    assert nominal.vector_of(found) == pytest.approx(vector)
    # The model of a plate that was never calibrated states neither.
    assert (Departures.none(3).across_offset_mm, Departures.none(3).spring_stiffness) == (None, None)
    assert not nominal.vector_of(Departures.none(3)).any()


def test_standard_errors_are_in_the_units_of_the_departures(nominal: NominalSurface) -> None:
    vector, spread = random_vector(2), np.random.default_rng(3).uniform(0.1, 0.9, SIZE)
    found = nominal.standard_errors(vector, spread)
    assert list(found) == ["rigidity", "gain", "position", "curve", "fixity", "offset"]
    assert found["rigidity"] == pytest.approx(0.1 * np.exp(0.1 * vector[:1]) * spread[:1], rel=1e-4)
    assert found["gain"] == pytest.approx(0.04 * np.exp(0.04 * vector[1:5]) * spread[1:5], rel=1e-4)
    assert found["position"] == pytest.approx(1.5 * spread[5:9])
    assert found["curve"] == pytest.approx(0.03 / LARGEST_MM * spread[9:10])
    assert found["fixity"] == pytest.approx(0.1 * spread[10:12])
    assert found["offset"] == pytest.approx(0.006 * spread[12:])


def test_what_a_fit_may_change_and_by_how_much(nominal: NominalSurface) -> None:
    free = nominal.free_of(("gain", "fixity"))
    assert free.tolist() == [1, 2, 3, 4, 10, 11]
    assert nominal.free_of(()).tolist() == []
    low, high = nominal.bounds_of(free)
    assert (low.tolist(), high.tolist()) == ([-8.0] * 4 + [0.0] * 2, [8.0] * 4 + [9.0] * 2)
    own = np.arange(36.0).reshape(6, 6)
    full = nominal.covariance_of(("gain", "fixity"), own)
    assert full[np.ix_(free, free)].tolist() == own.tolist()
    assert np.abs(full).sum() == own.sum()
    assert (nominal.degrees, nominal_of((9.0, 9.0)).degrees) == (2, 3)
    errors, exact = nominal.contact_errors, nominal_of((9.0, 9.0)).contact_errors
    assert (errors.placing_mm, errors.force, errors.residual_mm) == (398.0, 3.0, 0.0)
    assert exact.placing_mm == 398
    assert exact.force < 0.01
    narrow = nominal_of((8.0, 10.0))
    assert narrow.contact_errors.force == pytest.approx(narrow.prior.force_range.relative_error)


def test_the_influence_of_departures_is_that_of_the_beam_that_departs(nominal: NominalSurface) -> None:
    off = Departures.none(4).model_copy(
        update={"gain": [1.1, 0.95, 1.0, 1.02], "rigidity": 0.9, "position_offset_mm": [1.0, -2.0, 0.5, 0.0]}
    )
    curve = nominal.curve(nominal.vector_of(off))
    (ticks,) = curve.ticks
    assert (len(ticks), ticks[0], ticks[-1]) == (129, 1.0, 399.0)
    plain = nominal_of().prior_with(off.model_copy(update={"gain": [1.0] * 4, "rigidity": 1.0}))
    expected = plain.influence_at(ticks[:, None]) * np.array([1.1, 0.95, 1.0, 1.02]) / 0.9
    assert curve.influence == pytest.approx(expected, rel=1e-9)
    assert curve.influence == pytest.approx(nominal.prior_with(off).influence_at(ticks[:, None]), rel=1e-9)
    # It is computed once for all gains and rigidities, and kept for the newest departures of the beam.
    before = len(nominal._influences)
    nominal.curve(nominal.vector_of(off.model_copy(update={"gain": [1.0, 2.0, 1.0, 1.0], "rigidity": 1.2})))
    assert len(nominal._influences) == before


@pytest.mark.parametrize("fixity", [0.4, 1.6, 9.0])
def test_slopes_are_those_of_differences(nominal: NominalSurface, fixity: float) -> None:
    vector, kinds = random_vector(4), ("rigidity", "gain", "curve", "fixity", "offset", "position")
    vector[10:12] = fixity
    place_mm, force_n = np.array([[50.0], [222.0], [340.0]]), np.array([3.0, 18.0, 9.0])
    found = nominal.slopes(vector, place_mm, force_n, kinds)
    for entry in range(SIZE):
        step = np.zeros(SIZE)
        step[entry] = 1e-3
        # 9 is the largest fixity; the other side of it is not possible.
        sides = (0, -2) if entry in {10, 11} else (1, -1)
        ends = [nominal.curve(vector + side * step).measured_mm(place_mm, force_n) for side in sides]
        assert found[:, :, entry] == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=3e-3, abs=1e-6), entry
    some = nominal.slopes(vector, place_mm, force_n, ("gain",))
    assert some[:, :, 1:5] == pytest.approx(found[:, :, 1:5])
    assert np.abs(some[:, :, [0, *range(5, SIZE)]]).max() == 0


@pytest.mark.parametrize("about", [0.7, np.array([0.5, 1.5, 0.8])])
def test_a_step_solves_the_normal_equations_with_the_priors_within_its_bounds(about: float | Floats) -> None:
    rng = np.random.default_rng(6)
    weighed, left, off = rng.normal(size=(5, 4, 3)), rng.normal(size=(5, 4)), np.array([0.2, -0.4, 0.1])
    free = np.full(3, -9.0), np.full(3, 9.0)
    step, covariance = best_step(weighed, left, off, about, free)
    # Priors are three more readings, of the departures themselves.
    rows = np.concatenate([weighed.reshape(20, 3), np.eye(3) / about])
    shown = np.concatenate([left.ravel(), -off / about])
    assert step == pytest.approx(np.linalg.lstsq(rows, shown)[0])
    assert covariance == pytest.approx(np.linalg.inv(rows.T @ rows))
    # The largest entry has to stop; the others are the best beside it.
    worst = int(np.argmax(np.abs(step)))
    bound = step[worst] / 2
    low, high = free[0].copy(), free[1].copy()
    (low if bound < 0 else high)[worst] = bound
    stopped, _ = best_step(weighed, left, off, about, (low, high))
    others = np.delete(np.arange(3), worst)
    beside = np.linalg.lstsq(rows[:, others], shown - rows[:, worst] * bound)[0]
    assert stopped[worst] == pytest.approx(bound)
    assert stopped[others] == pytest.approx(beside)
    # However far off, no step is longer than two plausible departures.
    far, _ = best_step(weighed, 100 * left, off, about, free)
    assert np.abs(far).max() == pytest.approx(2.0)
    # At a bound there is still a way, if a tiny one.
    shut, _ = best_step(weighed, left, off, about, (np.zeros(3), np.zeros(3)))
    assert 0 < np.abs(shut).max() <= 1.01e-9


def session_of(nominal: NominalSurface) -> Session:
    return Session(nominal, loads_on(nominal, random_vector(7)))


def test_a_recording_adds_drift_a_weight_a_shift_and_bends_in_plausible_units(nominal: NominalSurface) -> None:
    session = session_of(nominal)
    assert session.size == SIZE + 4 + 1 + 1 + 2 * 4
    assert session.places_of((DRIFTING, WEIGHT, SHIFT, bend_of(2))).tolist() == [16, 17, 18, 19, 20, 21, 26, 27]
    assert session.places_of(()).tolist() == []
    assert session.usual_kinds == (*nominal.kinds, "drift")
    still = replace(session.loads, minutes=np.zeros(7))
    assert Session(nominal, still).usual_kinds == tuple(nominal.kinds)
    vector = random_vector(8, session.size)
    # A drift of the stated 1 um/min is plausible, and one of three noises in ten minutes.
    assert session.rates_um_per_min(vector) == pytest.approx(1.0 * vector[16:20])
    assert session.drift_mm(vector) == pytest.approx(0.001 * session.loads.minutes[:, None] * vector[16:20])
    slow = Session(nominal_of(drift_mm_per_min=1e-5), session.loads)
    assert slow.rates_um_per_min(vector) == pytest.approx(1e3 * 3 * NOISE_MM / 10 * vector[16:20])
    assert session.weight_n(vector) == pytest.approx(0.1 * 11 * vector[20])
    assert session.shift_mm(vector) == pytest.approx([0.02 * 400 * vector[21]])
    # A bend of 20 % of what the sensor shows at most, by the square and the cube of its part of that.
    places = np.linspace(1, 399, 129)[:, None]
    full_mm = 20 * np.abs(nominal.prior.influence_at(places)).max(axis=0)
    share, bends = session.loads.measured_mm / full_mm, vector[22:].reshape(4, 2)
    expected = 0.2 * full_mm * (share**2 * bends[:, 0] + share**3 * bends[:, 1])
    assert session.bends_mm(vector) == pytest.approx(expected, nan_ok=True)
    bare = session.as_of_surface(vector)
    measured = session.loads.measured_mm - session.drift_mm(vector) - expected
    assert bare.measured_mm == pytest.approx(measured, nan_ok=True)
    assert bare.force_n == pytest.approx(session.loads.force_n + 1.1 * vector[20])
    assert bare.place_mm == pytest.approx(session.loads.place_mm + 8 * vector[21])
    about = session.about({"gain": 0.3, WEIGHT: 2.0})
    assert about.tolist() == [1.0] + [0.3] * 4 + [1.0] * 15 + [2.0] + [1.0] * 9
    low, high = session.bounds_of(np.array([0, 10, 17, 20, 29]))
    assert (low.tolist(), high.tolist()) == ([-8, 0, -8, -8, -8], [8, 9, 8, 8, 8])


def test_slopes_of_a_recording_are_what_moves_its_residuals(nominal: NominalSurface) -> None:
    session = session_of(nominal)
    vector, kinds = random_vector(9, session.size) / 3, (*session.usual_kinds, *COMMON, *map(bend_of, range(4)))
    found = session.slopes(vector, kinds)
    for entry in range(session.size):
        step = np.zeros(session.size)
        step[entry] = 1e-3
        ends = [session.residuals(vector + side * step).left_mm for side in (1, -1)]
        assert found[:, :, entry] == pytest.approx((ends[1] - ends[0]) / 2e-3, rel=2e-3, abs=2e-6), entry
    assert np.abs(found[2, 1]).max() == 0  # it was not measured
    for kind in (DRIFTING, WEIGHT, SHIFT, bend_of(1)):
        places, some = session.places_of((kind,)), session.slopes(vector, (kind,))
        assert some[..., places] == pytest.approx(found[..., places])
        assert np.abs(np.delete(some, places, axis=2)).max() == 0


@pytest.mark.parametrize(
    ("gain", "shares"),
    [
        ([1.3, 0.9, 1.1], [0, 0, 1]),
        ([1.3, 0.9, 1.1, 1.2], [0, 0, 0.5, 0.5]),
        ([0.7], [1]),
        ([3.0, 9.0, 1.0, 7.0, 5.0], [0, 0, 0, 0, 1]),
    ],
)
def test_the_scale_is_the_median_of_the_gains(gain: list[float], shares: list[float]) -> None:
    found = shares_of_scale(np.array(gain))
    assert found.tolist() == shares
    assert found @ gain == pytest.approx(np.median(gain))


def test_only_hinged_ends_have_a_fixity_to_be_found(nominal: NominalSurface) -> None:
    assert nominal.hinged == (True, True)
    assert not nominal.sprung.any()
    # An end that is clamped has no fixity to be found, nor has one that is free.
    clamped = nominal_of(supports="cantilever")
    assert clamped.hinged == (False, False)
    assert list(clamped.kinds) == ["rigidity", "gain", "position", "curve", "offset"]


def test_a_channel_may_bend_of_which_a_deflection_was_not_measured(nominal: NominalSurface) -> None:
    loads = loads_on(nominal, np.zeros(SIZE))
    assert np.isnan(loads.measured_mm[2, 1])
    found = fit(nominal, loads, ("offset", bend_of(1)), rounds=1)
    assert np.abs(found.vector[24:26]).max() < 1
    assert np.isfinite(found.log_evidence)
