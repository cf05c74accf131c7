"""Places of two axes, from influence to layout: a rigid plate on springs and a simply supported one, in closed form."""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.stats import chi2

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.cell_posterior import summarize
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_deviation_mm
from beamtouch_models.design.accuracy.drawing import concentrate_on_errors, draw, spread_contacts
from beamtouch_models.design.accuracy.limit import accuracy_limit
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import directions, log_odds, shapes_at_rest, touch_threshold
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.layout_rules import LayoutRules, equal_layout
from beamtouch_models.design.placement.placing import place, place_by_position_error
from beamtouch_models.design.placement.position_error import Sampling
from beamtouch_models.names import SearchName
from beamtouch_models.places import grid_of
from beamtouch_models.runtime.curve import Curve
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.force_range import ANY_FORCE, ForceRange
from models.sprung_plate import SIZE_MM, SPRING_N_PER_MM, sunk_mm

CORNERS_MM = np.array([[10.0, 10.0], [10.0, 290.0], [390.0, 10.0], [390.0, 290.0]])
TICKS_MM = [np.linspace(10, 390, 39), np.linspace(10, 290, 29)]
FREE = np.array([], dtype=np.intp)


def bent_mm(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Navier's series of 3 mm of steel, simply supported (Timoshenko & Woinowsky-Krieger, 1959, art. 34)."""
    order, stiffness = np.arange(1, 40), 210e3 * 3**3 / (12 * (1 - 0.3**2))
    sines = [
        [np.sin(np.pi * np.outer(p[:, axis] / SIZE_MM[axis], order)) for axis in (0, 1)] for p in (sensor_mm, load_mm)
    ]
    wave = ((order[:, None] / SIZE_MM[0]) ** 2 + (order / SIZE_MM[1]) ** 2) ** 2
    unit = 4 / (np.pi**4 * stiffness * SIZE_MM.prod() * wave)
    both = [np.einsum("pm,pn->pmn", *pair) for pair in sines]
    matrix: Floats = np.einsum("smn,mn,lmn->ls", both[0], unit, both[1])
    return matrix


def influence_of(at: Callable[[Floats, Floats], Floats]) -> InfluenceFunction:
    return InfluenceFunction((400.0, 300.0), grid_of(TICKS_MM), (2.0, 20.0), at)


def prior_on_springs(noise_mm: float, **errors: float) -> Prior:
    return Prior.of(influence_of(sunk_mm), CORNERS_MM, Errors(noise_mm, **errors))


def test_places_that_are_no_even_grid_of_as_many_axes_as_the_length_are_refused() -> None:
    plate, scattered = influence_of(sunk_mm), np.random.default_rng(0).uniform(10, 290, (40, 2))
    assert (plate.diagonal_mm, plate.extent.ranges_mm) == (500.0, ((10.0, 390.0), (10.0, 290.0)))
    for load_mm in (scattered, grid_of(TICKS_MM)[::-1], np.linspace(10, 290, 20), grid_of([*TICKS_MM, TICKS_MM[0]])):
        with pytest.raises(ValueError, match=r"^load_mm of an influence function must"):
            replace(plate, load_mm=load_mm)
    with pytest.raises(ValueError, match=r"not nan for a sensor at 280, 210 and a load at 390, 290 mm$"):
        replace(plate, at=lambda sensor, load: np.where(load[:, :1] > 300, np.nan, sunk_mm(sensor, load)))


def test_the_mounting_adds_the_squares_of_both_axes() -> None:
    sensor_mm, load_mm = np.array([[200.0, 150.0], [400.0, 0.0]]), np.array([[300.0, 75.0], [200.0, 150.0]])
    tilt = (2 * load_mm / SIZE_MM - 1) * 2 / SIZE_MM / (4 * SPRING_N_PER_MM)  # by 1 mm of a sensor along each axis
    expected = np.tile((9 * tilt**2).sum(axis=1)[:, None], 2)
    # At a corner, a sensor can be off to one side only; the plate is as steep there.
    assert influence_of(sunk_mm).variance(sensor_mm, load_mm, 3.0) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("at", [sunk_mm, bent_mm])
def test_the_best_contact_is_where_the_load_was(at: Callable[[Floats, Floats], Floats]) -> None:
    sensor_mm, rng = np.array([[90.0, 80.0], [310.0, 70.0], [120.0, 215.0], [290.0, 240.0]]), np.random.default_rng(1)
    table = Curve(tuple(TICKS_MM), at(sensor_mm, grid_of(TICKS_MM)))
    place_mm, force_n = rng.uniform([80, 60], [320, 240], (200, 2)), rng.uniform(2, 20, 200)
    clean_mm, weight = force_n[:, None] * at(sensor_mm, place_mm), np.full((200, 4), 1e6)
    found_mm, found_n = table.best_contacts(clean_mm, weight)
    # On simply supported edges the place hides in a thousandth of the deflections: three steps may end beside it.
    assert np.quantile(np.abs(found_mm - place_mm).max(axis=1), 0.98) < 0.1
    assert np.quantile(np.abs(found_n / force_n - 1), 0.98) < 2e-3
    one_n = clean_mm / force_n[:, None]
    at_known_mm, _ = table.best_contacts(7 * one_n, weight, ForceRange(7.0, 7.0))
    assert np.quantile(np.abs(at_known_mm - place_mm).max(axis=1), 0.98) < 0.1
    assert table.unexplained(clean_mm, weight).max() < 1e-2


def test_the_bound_on_springs_is_that_of_four_load_cells() -> None:
    """From four corners, sink c and tilts c u, c v are means of four; u and v are ratios of them."""
    noise_mm, prior = 0.002, prior_on_springs(0.002)
    place_mm, force_n = np.array([[200.0, 150.0], [300.0, 250.0], [60.0, 20.0]]), np.array([2.0, 10.0, 20.0])
    reach = 2 * CORNERS_MM[-1] / SIZE_MM - 1
    sink_mm, share = force_n / (4 * SPRING_N_PER_MM), 2 * place_mm / SIZE_MM - 1
    deviation = noise_mm / 2 / sink_mm[:, None] * np.sqrt(1 / reach**2 + share**2) * SIZE_MM / 2
    assert cramer_rao_deviation_mm(prior, place_mm, force_n) == pytest.approx(deviation, rel=1e-6)
    known = replace(prior, force_n=(10.0, 10.0))
    at_known = cramer_rao_deviation_mm(known, place_mm[1:2], np.array([10.0]))
    assert np.all(at_known < deviation[1])


@pytest.mark.parametrize("mounting_mm", [0.0, 2.0])
def test_the_posterior_is_that_of_a_plain_sum_over_places_and_forces(mounting_mm: float) -> None:
    prior = prior_on_springs(0.03, gain=0.003, mounting_mm=mounting_mm)
    drawn = draw(prior, 6, 2)
    ticks = [np.linspace(low, high, 191) for low, high in prior.extent.ranges_mm]
    places, forces = grid_of(ticks), np.linspace(*prior.force_n, 241)
    shape, spread = sunk_mm(CORNERS_MM, places), influence_of(sunk_mm).variance(CORNERS_MM, places, mounting_mm)
    found = summarize(prior, drawn.deflection_mm)
    for sample, median, distance in zip(drawn.deflection_mm, found.median_mm, found.distance_mm, strict=True):
        mass = np.zeros(len(places))
        for force in forces:
            variance = 0.03**2 + (0.003 * sample) ** 2 + force**2 * spread
            mass += np.exp(-((sample - force * shape) ** 2 / variance + np.log(variance)).sum(axis=1) / 2 - 12)
        mass /= mass.sum()
        for axis, along in enumerate(ticks):
            below = np.cumsum(mass.reshape(191, 191).sum(axis=1 - axis))
            assert median[axis] == pytest.approx(np.interp(0.5, below, along), abs=2.0)
        assert distance == pytest.approx(mass @ np.linalg.norm(places - median, axis=1), rel=0.02)


def test_the_limit_of_little_noise_is_the_mean_distance_of_the_bound_s_normal_errors() -> None:
    prior, rng = prior_on_springs(0.0005), np.random.default_rng(3)
    place_mm, force_n = rng.uniform([10, 10], [390, 290], (4000, 2)), rng.uniform(2, 20, 4000)
    share, sink_mm = 2 * place_mm / SIZE_MM - 1, force_n / (4 * SPRING_N_PER_MM)
    reach = 2 * CORNERS_MM[-1] / SIZE_MM - 1
    tilts = rng.normal(size=(4000, 3)) * 0.0005 / 2 / sink_mm[:, None]
    off_mm = (tilts[:, 1:] / reach - share * tilts[:, :1]) * SIZE_MM / 2
    expected = np.linalg.norm(off_mm, axis=1).mean() / 500 * 100
    limit = accuracy_limit(prior, 256, 4)
    assert limit.value == pytest.approx(expected, rel=0.04)
    assert limit.standard_error < 0.02 * limit.value


def test_contacts_that_are_drawn_where_errors_are_large_weigh_as_much_less() -> None:
    prior = Prior.of(influence_of(bent_mm), np.array([[90.0, 80.0], [310.0, 70.0], [200.0, 215.0]]), Errors(0.002))
    even, _, _ = spread_contacts(prior, 4096, np.random.default_rng(5))
    moved, weight = concentrate_on_errors(prior, even)
    assert np.all((moved >= [10, 10]) & (moved <= [390, 290]))
    assert weight.mean() == pytest.approx(1, abs=0.02)
    rim = np.minimum(moved - [10, 10], [390, 290] - moved).min(axis=1) < 30
    assert rim.mean() > 1.15 * (weight * rim).mean() / weight.mean()
    assert (weight[:, None] * moved).mean(axis=0) / weight.mean() == pytest.approx([200, 150], rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("at", [sunk_mm, bent_mm])
@pytest.mark.parametrize("sensors", [4, 6])
def test_a_plate_at_rest_exceeds_the_threshold_of_touch_as_often_as_one_direction_does(
    at: Callable[[Floats, Floats], Floats], sensors: int
) -> None:
    """The rate is an integral over directions of the noise: along each, its length is chi-distributed."""
    x, y = (np.array([60.0, 340.0]), np.array([50.0, 250.0])) if sensors == 4 else ([60, 200, 340], [50, 250])
    prior = Prior.of(influence_of(at), grid_of([np.array(x, float), np.array(y, float)]), Errors(0.002))
    unit = directions(shapes_at_rest(prior))
    # Noise across all directions of contacts changes nothing: within their span, each is drawn as often.
    size, span = np.linalg.svd(unit, full_matrices=False)[1:]
    unit = unit @ span[size > 1e-6 * size[0]].T
    along = np.random.default_rng(6).normal(size=(30_000, unit.shape[1]))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    for rate in (1e-4, 1e-5):
        threshold = touch_threshold(unit, np.ones(unit.shape[1]), rate)
        low, high = np.zeros(len(along)), np.full(len(along), 12.0)
        for _ in range(16):
            middle = (low + high) / 2
            exceeds = log_odds(unit, middle[:, None] * along) > threshold
            low, high = np.where(exceeds, low, middle), np.where(exceeds, middle, high)
        found = chi2.sf(high**2, unit.shape[1]) / rate
        print(f"{at.__name__}, {sensors} sensors, {rate:g}: {found.mean():.3f} +- {found.std() / 30_000**0.5:.3f}")
        assert found.mean() == pytest.approx(1, abs=0.05 + 3 * found.std() / 30_000**0.5)


def test_rules_are_of_distances_and_moves_go_to_neighbours_on_the_grid() -> None:
    grid = grid_of([np.arange(0.0, 50.0, 10), np.arange(0.0, 40.0, 10)])
    candidates = grid[~((grid == [20, 20]).all(axis=1))]  # one place is kept free
    number = {tuple(place): index for index, place in enumerate(candidates.tolist())}
    rules = LayoutRules(candidates, np.array([number[0.0, 0.0]]), 15.0)
    pairs = np.array(list(combinations(range(len(candidates)), 2)), dtype=np.intp)
    apart = np.linalg.norm(candidates[pairs[:, 0]] - candidates[pairs[:, 1]], axis=1)
    assert np.array_equal(rules.allowed(pairs), (apart >= 15) & (pairs == 0).any(axis=1))
    layout = np.array([number[10.0, 20.0], number[40.0, 30.0]])
    steps = np.array([[[0, 0], [-1, 0]], [[1, 0], [0, 0]], [[0, -1], [0, -1]], [[0, 0], [0, 1]]])
    assert rules.moved(layout, steps).tolist() == [
        [layout[0], number[30.0, 30.0]],
        [-1, layout[1]],
        [number[10.0, 10.0], number[40.0, 20.0]],
        [layout[0], -1],
    ]
    assert rules.pushed(layout, steps)[[1, 3]].tolist() == [layout.tolist()] * 2
    fitted = rules.fitted(np.array([[41.0, 29.0], [22.0, 21.0], [1.0, 2.0]]))
    assert fitted is not None
    assert rules.allowed(fitted[None])[0]
    assert candidates[fitted].tolist() == [[0, 0], [20, 30], [40, 30]]  # (30, 20) is nearer, but too close to (40, 30)
    assert LayoutRules(candidates, rules.fixed, 100.0).fitted(np.array([[1.0, 2.0], [40.0, 30.0]])) is None


@pytest.mark.parametrize("search", ["exchange", "paper"])
def test_the_most_independent_sensors_of_a_plate_on_springs_stand_in_its_corners(search: SearchName) -> None:
    rules = LayoutRules(grid_of(TICKS_MM), FREE, 20.0)
    found = place(influence_of(sunk_mm), rules, 4, 0, leading=3, search=search)  # a rigid plate has three components
    assert found.place_mm.tolist() == CORNERS_MM.tolist()


def test_sensors_of_a_plate_are_placed_by_position_error() -> None:
    influence, rules = influence_of(sunk_mm), LayoutRules(grid_of([tick[::4] for tick in TICKS_MM]), FREE, 20.0)
    sampling = Sampling(Errors(0.02))
    found = place_by_position_error(influence, rules, 4, 0, sampling).place_mm
    equal = rules.place_mm[equal_layout(rules, SIZE_MM, 4)]
    least, most = (accuracy_limit(Prior.of(influence, layout, sampling.errors), 128, 1) for layout in (found, equal))
    assert least.value < 0.6 * most.value


def test_fewer_sensors_than_a_place_has_axes_explain_a_contact_somewhere() -> None:
    table = Curve(tuple(TICKS_MM), bent_mm(np.array([[120.0, 90.0]]), grid_of(TICKS_MM)))
    clean_mm = np.array([[0.1], [0.02]])
    for stated in (ANY_FORCE, ForceRange(10.0, 10.0), ForceRange(9.0, 11.0)):
        place_mm, force_n = table.best_contacts(clean_mm, np.full((2, 1), 1e6), stated)
        assert np.isfinite(place_mm).all()
        assert np.isfinite(force_n).all()
    layout = place_by_position_error(
        influence_of(bent_mm),
        LayoutRules(grid_of([tick[::8] for tick in TICKS_MM]), FREE, 20.0),
        2,
        0,
        Sampling(Errors(0.01)),
    )
    assert len(layout.place_mm) == 2
