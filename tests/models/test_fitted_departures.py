"""Fits to loads and to unlabelled contacts on the paper's beam, beside dense linear algebra."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.choice import _combinations, averaged_fit, has_one_scale
from beamtouch_models.design.calibration.fit import Fit, _likely_errors, fit
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import UnlabelledContacts
from beamtouch_models.design.calibration.unlabelled import (
    _left_error,
    fit_contacts,
    locate,
    measure_remaining,
    single_contact,
    stated_mm,
)
from beamtouch_models.runtime.health.residuals import LoadErrors, Residuals
from models.nominal_beam import NOISE_MM, loads_on, nominal_of

REAL = np.array([0.4, -0.5, 0.3, 0.7, -0.2, 0.3, -0.6, 0.2, 0.5, -0.4, 0.6, 0.0, 0.2, -0.3, 0.1, 0.4])
STATED_FORCE, STATED_MM = 0.01, 1.0


@pytest.fixture(scope="module")
def nominal() -> NominalSurface:
    return nominal_of()


@pytest.fixture(scope="module")
def fitted(nominal: NominalSurface) -> Fit:
    loads = loads_on(nominal, REAL, 1, 9)
    return fit(nominal, loads, (*nominal.kinds, "drift"))


def dense(found: Fit, errors: LoadErrors, load: int) -> tuple[Floats, Floats, Floats]:
    """Return residuals, slopes and covariance of the channels of a load that were measured."""
    residuals = found.session.residuals(found.vector)
    there = residuals.is_measured[load]
    moved = residuals.moved_mm[:, load, there]
    covariance = np.diag(residuals.noise_mm[load, there] ** 2 + errors.residual_mm**2)
    covariance += errors.placing_mm**2 * np.outer(moved[0], moved[0]) + errors.force**2 * np.outer(moved[1], moved[1])
    slopes = found.session.slopes(found.vector, found.kinds)[load][there]
    return residuals.left_mm[load, there], slopes[:, found.session.places_of(found.kinds)], covariance


def precision_of(found: Fit, *left_out: int) -> tuple[Floats, Floats]:
    """Return the precision of the fitted entries and the pull of the loads on them, from zero."""
    free = found.session.places_of(found.kinds)
    precision, pull = np.eye(len(free)), np.zeros(len(free))
    for load in set(range(len(found.session.loads.number))) - set(left_out):
        left, slopes, covariance = dense(found, found.errors, load)
        weight = slopes.T @ np.linalg.inv(covariance)
        precision += weight @ slopes
        pull += weight @ (left + slopes @ found.vector[free])
    return precision, pull


def test_a_fit_is_the_likeliest_vector_by_its_loads_and_priors(fitted: Fit) -> None:
    free = fitted.session.places_of(fitted.kinds)
    precision, pull = precision_of(fitted)
    assert fitted.vector[free] == pytest.approx(np.linalg.solve(precision, pull), abs=0.02)
    assert np.delete(fitted.vector, free).tolist() == [0.0] * (fitted.session.size - len(free))
    assert fitted.covariance[np.ix_(free, free)] == pytest.approx(np.linalg.inv(precision), abs=1e-6)
    assert fitted.spread[free] == pytest.approx(np.sqrt(np.diag(np.linalg.inv(precision))), abs=1e-4)
    assert np.abs(np.delete(fitted.covariance, free, axis=0)).max() == 0
    # It finds what departs, as far as the loads tell.
    off = (fitted.vector[:16] - REAL) / fitted.spread[:16]
    assert np.sqrt((off**2).mean()) < 1.5
    assert fitted.spread[1:5].max() < 0.9


def test_what_is_stated_of_a_fit_follows_from_its_residuals(fitted: Fit) -> None:
    loads, stated, used, squares = fitted.session.loads, fitted.session.loads.errors, 0.0, 0.0
    assert (stated.placing_mm, stated.force) == (STATED_MM, STATED_FORCE)
    own, predicted = np.linalg.inv(precision_of(fitted)[0]), 0.0
    for load in range(len(loads.number)):
        left, slopes, covariance = dense(fitted, fitted.errors, load)
        used += np.trace(slopes.T @ np.linalg.inv(covariance) @ slopes @ own)
        predicted += np.trace(slopes @ own @ slopes.T)
        left, _, covariance = dense(fitted, stated, load)
        squares += float(left @ np.linalg.solve(covariance, left))
        # The same load by the others alone.
        precision, pull = precision_of(fitted, load)
        left, slopes, _ = dense(fitted, fitted.errors, load)
        free = fitted.session.places_of(fitted.kinds)
        expected = left + slopes @ (fitted.vector[free] - np.linalg.solve(precision, pull))
        found = fitted.left_out_mm[load][np.isfinite(loads.measured_mm[load])]
        assert found == pytest.approx(expected, rel=0.05, abs=1e-4)
    measured = np.isfinite(loads.measured_mm).sum()
    assert np.isnan(fitted.left_out_mm).tolist() == np.isnan(loads.measured_mm).tolist()
    assert fitted.freedom == pytest.approx(measured - used, rel=0.02)
    assert fitted.scatter == pytest.approx(np.sqrt(squares / fitted.freedom), rel=1e-6)
    assert fitted.prediction_mm == pytest.approx(np.sqrt(predicted / measured), rel=1e-3)
    assert fitted.error_mm == pytest.approx(np.sqrt(np.nanmean(fitted.left_out_mm**2)))


def test_a_degree_of_freedom_is_left_however_few_loads_there_are(nominal: NominalSurface) -> None:
    """Four deflections of one load: departures, place and force explain all of them."""
    assert fit(nominal, loads_on(nominal, REAL)[[4]], tuple(nominal.kinds)).freedom == 1.0


def test_the_evidence_is_the_probability_of_the_recording_under_all_departures(fitted: Fit) -> None:
    free, count = fitted.session.places_of(fitted.kinds), len(fitted.session.loads.number)
    parts = [dense(fitted, fitted.errors, load) for load in range(count)]
    slopes = np.concatenate([part[1] for part in parts])
    shown = np.concatenate([part[0] for part in parts]) + slopes @ fitted.vector[free]
    covariance, place = slopes @ slopes.T, 0
    for left, _, own in parts:
        covariance[place : place + len(left), place : place + len(left)] += own
        place += len(left)
    log = multivariate_normal(cov=covariance, allow_singular=True).logpdf(shown) + len(shown) / 2 * np.log(2 * np.pi)
    found = np.array([fitted.errors.placing_mm, fitted.errors.force]) ** 2
    stated = np.array([STATED_MM, STATED_FORCE]) ** 2
    of_errors = -0.25 / 2 * (stated / found + np.log(found)).sum()
    assert fitted.log_evidence == pytest.approx(log + of_errors, abs=0.05)


def test_sizes_narrow_the_priors_of_their_kinds(fitted: Fit) -> None:
    small = fit(fitted.nominal, fitted.session.loads, fitted.kinds, fitted.vector, sizes={"gain": 0.01})
    assert np.abs(small.vector[1:5]).max() < 0.01
    assert np.abs(fitted.vector[1:5]).max() > 0.1
    assert small.spread[1:5] == pytest.approx(0.01, rel=0.05)
    assert small.sizes == {"gain": 0.01}


def penalized(residuals: Residuals, about: LoadErrors, errors: LoadErrors) -> float:
    """Return the log likelihood of residuals, with the stated errors as a quarter of a load."""
    total = 0.0
    for left, covariance in zip(residuals.left_mm, residuals.covariance_mm2(errors), strict=True):
        total += multivariate_normal(cov=covariance).logpdf(left)
    for stated, found in ((about.placing_mm, errors.placing_mm), (about.force, errors.force)):
        total -= 0.25 / 2 * (stated**2 / found**2 + np.log(found**2))
    return total


@pytest.mark.parametrize("axes", [1, 2])
def test_the_errors_of_a_recording_are_the_likeliest(axes: int) -> None:
    rng, real = np.random.default_rng(2), LoadErrors(2.0, 0.03, 0.004)
    moved = rng.normal(size=(axes + 1, 60, 4)) * np.array([0.01] * axes + [1.0])[:, None, None]
    noise_mm = np.full((60, 4), 0.003)
    plain = Residuals(np.zeros((60, 4)), noise_mm, moved, np.ones((60, 4), dtype=np.bool_))
    left = np.stack([rng.multivariate_normal(np.zeros(4), one) for one in plain.covariance_mm2(real)])
    residuals, about = replace(plain, left_mm=left), LoadErrors(1.0, 0.01)
    found = about
    for _ in range(30):
        found = _likely_errors(residuals, about, found, 240.0)
    best = penalized(residuals, about, found)
    for name, factor in product(("placing_mm", "force", "residual_mm"), (0.97, 1.03)):
        assert penalized(residuals, about, replace(found, **{name: getattr(found, name) * factor})) < best, name
    assert (found.placing_mm, found.force, found.residual_mm) == pytest.approx((2.0, 0.03, 0.004), rel=0.25)
    # Departures that were fitted take degrees of freedom, so that the errors are larger than they seem.
    fewer = _likely_errors(residuals, about, found, 180.0)
    assert fewer.force > 1.05 * found.force
    assert fewer.placing_mm > 1.05 * found.placing_mm


def test_combinations_of_sizes_are_weighed_by_the_probability_of_the_recording(nominal: NominalSurface) -> None:
    kinds = ("gain", "rigidity", "position")
    full = fit(nominal, loads_on(nominal, REAL, 1, 9), kinds)
    sizes, means, covariances, weights = _combinations(full)
    assert sorted(map(tuple, sizes.tolist())) == sorted(product((0.3, 1.0), repeat=3))
    free = full.session.places_of(kinds)
    precision, pull = precision_of(full)
    information = precision - np.eye(len(free))
    logs = []
    for row, mean, covariance in zip(sizes, means, covariances, strict=True):
        about = full.session.about(dict(zip(kinds, row.tolist(), strict=True)))[free]
        own = np.linalg.inv(information + np.diag(about**-2))
        assert covariance[np.ix_(free, free)] == pytest.approx(own, abs=1e-6)
        assert np.abs(np.delete(covariance, free, axis=0)).max() == 0
        assert mean[free] == pytest.approx(own @ pull, abs=1e-4)
        logs.append((pull @ own @ pull + np.linalg.slogdet(own)[1]) / 2 - np.log(about).sum())
    expected = np.exp(np.array(logs) - max(logs))
    assert weights == pytest.approx(expected / expected.sum(), rel=1e-3)
    averaged = averaged_fit(full)
    mean_sizes = np.sqrt(weights @ sizes**2)
    assert [averaged.sizes[kind] for kind in kinds] == pytest.approx(mean_sizes)
    # Gains and rigidity scale alike: what gains have in common is in the rigidity.
    assert has_one_scale(full)
    assert np.median(averaged.vector[1:5]) == pytest.approx(0.0, abs=1e-9)
    mixed = weights @ means
    plain = fit(nominal, full.session.loads, kinds, full.vector, sizes=averaged.sizes)
    at = full.session.loads.place_mm, full.session.loads.force_n
    shown = [nominal.curve(one.vector[: nominal.size]).measured_mm(*at) for one in (plain, averaged)]
    assert shown[1] == pytest.approx(shown[0], rel=2e-3)
    apart = means - mixed
    every = np.einsum("k,kvw->vw", weights, covariances) + np.einsum("k,kv,kw->vw", weights, apart, apart)
    # What the loads leave open of a deflection is the same, whichever of the two holds the scale.
    slopes = full.session.slopes(averaged.vector, kinds)
    left = [np.einsum("lcv,vw,lcw->lc", slopes, one, slopes) for one in (every, averaged.covariance)]
    assert left[1] == pytest.approx(left[0], rel=0.02)


def test_on_a_foundation_the_rigidity_is_told_from_gains() -> None:
    soft = nominal_of(foundation_n_mm2=0.05)
    assert not has_one_scale(fit(soft, loads_on(soft, REAL), ("gain", "rigidity")))


@pytest.mark.parametrize("share", [0.01, 0.3])
def test_a_contact_is_single_by_the_odds_of_its_misfit(share: float) -> None:
    misfit, degrees = np.array([0.0, 2.0, 9.0, 30.0, 200.0, 3000.0, 1e7]), 3
    own = (1 - share) * np.exp(-misfit[:5] / 2)
    other = share / 4 * sum(np.exp(-misfit[:5] / 2 / scale**2) / scale**degrees for scale in (4, 16, 64, 256))
    found = single_contact(misfit, degrees, share)
    assert found[:5] == pytest.approx(own / (own + other))
    assert found[5:] == pytest.approx([0, 0], abs=1e-100)


def contacts_on(nominal: NominalSurface, vector: Floats, count: int = 80, error: float = 0.0) -> UnlabelledContacts:
    rng = np.random.default_rng(4)
    place_mm, force_n = rng.uniform(20, 380, (count, 1)), rng.uniform(3, 19, count)
    clean = nominal.curve(vector).measured_mm(place_mm, force_n)
    clean *= 1 + error * rng.normal(size=clean.shape)
    deviation = np.full(clean.shape, NOISE_MM)
    return UnlabelledContacts(clean + deviation * rng.normal(size=clean.shape), deviation)


def test_contacts_are_located_where_they_press_and_none_pulls() -> None:
    nominal, zero_mm = nominal_of(), np.zeros(4)
    place_mm, force_n = np.array([[60.0], [150.0], [333.0]]), np.array([5.0, 12.0, 19.0])
    measured = nominal.curve(REAL).measured_mm(place_mm, force_n)
    found = locate(nominal, REAL, UnlabelledContacts(measured, np.full((3, 4), NOISE_MM)), zero_mm)
    assert found.place_mm == pytest.approx(place_mm, abs=0.01)
    assert found.force_n == pytest.approx(force_n, rel=1e-3)
    assert np.abs(found.residuals.left_mm).max() < 1e-4
    assert found.residuals.noise_mm == pytest.approx(NOISE_MM)
    wide = locate(nominal, REAL, UnlabelledContacts(measured, np.full((3, 4), NOISE_MM)), np.full(4, 0.01), 0.1)
    assert wide.residuals.noise_mm == pytest.approx(np.sqrt(NOISE_MM**2 + 0.01**2 + (0.1 * measured) ** 2))
    # A contact of 100 times the largest force is one; beyond, and where it would have to pull, it is none.
    for times, expected in ((1990 / 5, 1990.0), (2010 / 5, 0.0), (-1.0, 0.0), (-0.1, 0.0)):
        plain = nominal.curve(np.zeros(16)).measured_mm(place_mm[:1], force_n[:1]) * times
        one = locate(nominal, np.zeros(16), UnlabelledContacts(plain, np.full((1, 4), NOISE_MM)), zero_mm)
        assert one.force_n == pytest.approx([expected], rel=1e-3)
    exact = nominal_of((9.0, 9.0))
    nine = exact.curve(np.zeros(16)).measured_mm(place_mm[:1], np.array([9.3]))
    assert locate(exact, np.zeros(16), UnlabelledContacts(nine, np.full((1, 4), 0.1)), zero_mm).force_n == [9.0]


@pytest.mark.parametrize(("degrees", "most"), [(1.9, 0.2), (1e-9, 1.0), (1e6, 0.0), (0.0, 0.0)])
def test_what_is_left_makes_the_misfit_as_large_as_it_should_be(degrees: float, most: float) -> None:
    nominal, zero_mm = nominal_of(), np.full(4, 1e-4)
    contacts = contacts_on(nominal, np.zeros(16), error=0.05)
    at = locate(nominal, np.zeros(16), contacts, zero_mm).residuals
    single = np.linspace(0.0, 1.0, len(contacts))
    found = _left_error(nominal, contacts, zero_mm, at, single, degrees)
    if most in {0.0, 1.0}:
        assert found == most
        return
    assert 0.02 < found < most
    misfit = replace(at, noise_mm=contacts.noise_mm(zero_mm, found)).misfit(nominal.contact_errors)
    assert single @ misfit / single.sum() == pytest.approx(degrees, rel=1e-2)
    assert _left_error(nominal, contacts, zero_mm, at, np.zeros(len(contacts)), degrees) == 0.0


def test_a_fit_to_contacts_finds_gains_but_for_their_scale_and_says_how_large_they_are(nominal: NominalSurface) -> None:
    real = np.zeros(16)
    real[1:5] = 0.9, -0.7, 0.3, -0.5
    contacts, zero_mm = contacts_on(nominal, real), np.full(4, 1e-4)
    found = fit_contacts(nominal, np.zeros(16), contacts, ("gain", "offset"), zero_mm)
    gains = found.vector[1:5] - found.vector[1:5].mean()
    assert gains == pytest.approx(real[1:5] - real[1:5].mean(), abs=0.05)
    assert np.abs(np.delete(found.vector, [*range(1, 5), *range(12, 16)])).max() == 0
    assert found.single.min() > 0.9
    assert found.misfit.mean() == pytest.approx(2.0, rel=0.3)
    assert found.left_error < 0.003
    squares = found.vector[1:5] ** 2 + found.spread[1:5] ** 2
    assert found.size == pytest.approx(np.sqrt(squares.mean()), rel=0.05)
    about = np.array([found.size] * 4 + [1e-4 / (3 * NOISE_MM)] * 4)
    free = nominal.free_of(("gain", "offset"))
    assert found.penalty == pytest.approx(((found.vector[free] / about) ** 2).sum(), rel=0.05)
    assert found.cost == pytest.approx(found.single @ found.misfit + found.penalty)
    # About another start, the same contacts need other departures.
    moved = fit_contacts(nominal, real, contacts, ("gain", "offset"), zero_mm, like=found)
    assert moved.size < 0.3 * found.size
    assert moved.start is real


@pytest.mark.parametrize("force_n", [(2.0, 20.0), (8.0, 10.0)])
@pytest.mark.parametrize("is_scale_open", [False, True])
def test_what_a_fit_leaves_open_moves_places_as_weighted_least_squares_do(
    force_n: tuple[float, float], is_scale_open: bool
) -> None:
    nominal = nominal_of(force_n)
    rng = np.random.default_rng(11)
    root = 0.15 * rng.normal(size=(16, 16))
    covariance, noise_mm = root @ root.T, np.array([0.003, 0.002, 0.004, 0.0025])
    start = REAL + 0.2 * rng.normal(size=16)
    found = measure_remaining(nominal, REAL, covariance, noise_mm, start=start, is_scale_open=is_scale_open)
    project = np.eye(16)
    if is_scale_open and nominal.prior.force_range.is_open:
        project[1:5, 1:5] -= 0.25
    assert found.relative == pytest.approx(project @ covariance @ project.T)
    curve, middle = nominal.curve(REAL), np.array([sum(force_n) / 2])
    places, read = np.linspace(1 + 19.9, 399 - 19.9, 61), nominal.prior.force_range.relative_error**-2
    spreads, cleans, moves_of, per_gain, forces = [], [], [], [], []
    for place in places[:, None, None]:
        slopes = nominal.slopes(REAL, place, middle, tuple(nominal.kinds))[0]
        clean, (along, by_force) = curve.measured_mm(place, middle)[0], curve.moved_mm(place, middle)[:, 0]
        spread = np.diag(slopes @ found.relative @ slopes.T)
        weight = 1 / (noise_mm**2 + spread)
        design = np.column_stack([along, by_force])
        normal = (design * weight[:, None]).T @ design + np.diag([0.0, read])
        gain_of_readings = np.linalg.solve(normal, (design * weight[:, None]).T)[0]
        spreads.append(spread)
        cleans.append(clean)
        moves_of.append(gain_of_readings @ slopes)
        per_gain.append(gain_of_readings * clean)
        forces.append(clean @ slopes / (clean @ clean))
    moves = np.array(moves_of)
    open_mm = np.sqrt(np.einsum("pv,vw,pw->p", moves, covariance, moves))
    assert found.position_mm == pytest.approx(open_mm, rel=1e-6)
    assert found.per_gain_mm[:, 0] == pytest.approx(np.array(per_gain), rel=1e-6, abs=1e-9)
    assert found.shift_mm == pytest.approx(np.sqrt(((moves @ (REAL - start)) ** 2).mean()), rel=1e-6)
    share = np.array(forces)
    assert found.force_error == pytest.approx(np.sqrt(np.einsum("pv,vw,pw->p", share, covariance, share).mean()))
    # The floor has the shape of the errors of the gains, and states three quarters of the places.
    gain_error = np.sqrt((np.array(spreads) / np.array(cleans) ** 2).mean(axis=0))
    assert found.floor / found.floor[0] == pytest.approx(gain_error / gain_error[0], rel=1e-6)
    stated = np.linalg.norm(np.array(per_gain) * found.floor, axis=1)
    assert stated_mm(found.per_gain_mm, found.floor) == pytest.approx(stated)
    assert np.quantile(open_mm / stated, 0.75) == pytest.approx(1.0)
    wider = measure_remaining(nominal, REAL, covariance, noise_mm, left_error=0.02, is_scale_open=is_scale_open)
    assert wider.floor == pytest.approx(np.hypot(found.floor, 0.02))
    assert wider.shift_mm == 0


def test_a_floor_of_a_gain_is_never_below_half_a_thousandth(nominal: NominalSurface) -> None:
    found = measure_remaining(nominal, REAL, 1e-12 * np.eye(16), np.full(4, NOISE_MM))
    assert found.floor == pytest.approx([5e-4] * 4)
