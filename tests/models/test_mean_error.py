"""The mean error of a layout, and of narrow posteriors, beside plain sums over places, forces and angles."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.cramer_rao import cramer_rao_error_mm
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.mean_error import (
    MeanError,
    cell_sizes,
    mean_distances,
    mean_error_of,
    medians_on_line,
    middles_of,
)
from beamtouch_models.design.placement.narrow_posterior import NarrowPosteriors
from beamtouch_models.places import grid_of, on_axis
from beamtouch_models.runtime.error_model import Errors
from models.loaded_string import STRING, string_mm
from models.sprung_plate import SIZE_MM, SPRING_N_PER_MM, sunk_mm

EDGES_MM = np.array([10.0, 13.0, 20.0, 22.0, 37.0, 45.0])
ACROSS_MM = np.array([-4.0, 1.0, 3.0, 12.0])


def densities(rows: int, cells: int, seed: int = 0) -> Floats:
    return np.random.default_rng(seed).gamma(0.7, size=(rows, cells))


def finely(edges_mm: Floats, density: Floats, parts: int = 2000) -> tuple[Floats, Floats]:
    """Return places over all cells, and the probability of each."""
    widths = np.diff(edges_mm)
    places = np.concatenate(
        [low + width * (np.arange(parts) + 0.5) / parts for low, width in zip(edges_mm, widths, strict=False)]
    )
    mass = np.repeat(density * widths / parts, parts)
    return places, mass / mass.sum()


def test_medians_and_mean_distances_on_a_line_are_those_of_fine_sums() -> None:
    likely = densities(9, 5)
    likely[6] = [0, 0, 3, 0, 0]  # in one cell, half the way through
    likely[7] = [9, 0, 0, 0, 0.1]
    medians, distances = medians_on_line(EDGES_MM, likely), mean_distances([EDGES_MM], likely.copy())
    for row, median, distance in zip(likely, medians, distances, strict=True):
        places, mass = finely(EDGES_MM, row)
        assert median == pytest.approx(places[np.searchsorted(mass.cumsum(), 0.5)], abs=0.02)
        assert distance == pytest.approx(mass @ np.abs(places - median), rel=1e-3)
    assert medians[6] == pytest.approx(21.0)
    assert distances[6] == pytest.approx(0.5)


def of_cells(edges_mm: list[Floats], mass: Floats) -> tuple[Floats, float]:
    """Return the medians along both axes of masses in cells, and the mean distance of their middles from there."""
    mass, middles = mass / mass.sum(), [(edges[1:] + edges[:-1]) / 2 for edges in edges_mm]
    table = mass.reshape([len(ticks) for ticks in middles])
    median = np.array([middles[axis][(table.sum(axis=1 - axis).cumsum() < 0.5).sum()] for axis in (0, 1)])
    return median, float(mass @ np.linalg.norm(grid_of(middles) - median, axis=1))


def test_on_two_axes_distances_are_those_of_the_middles_of_cells_from_the_medians_along_both() -> None:
    edges = [EDGES_MM, ACROSS_MM]
    assert cell_sizes([EDGES_MM]) == pytest.approx([3, 7, 2, 15, 8])
    assert cell_sizes(edges)[:4] == pytest.approx([15, 6, 27, 35])
    assert middles_of(edges)[[0, 4]] == pytest.approx(np.array([[11.5, -1.5], [16.5, 2.0]]))
    likely = densities(7, 15, 3)
    found = mean_distances(edges, likely.copy())
    for row, distance in zip(likely, found, strict=True):
        assert distance == pytest.approx(of_cells(edges, row * cell_sizes(edges))[1])


def mean_error(
    edges_mm: list[Floats],
    force_n: tuple[float, float],
    *,
    noisy: bool = False,
    contacts: int = 70,
    faint: bool = False,
) -> MeanError:
    """Return that of contacts at random on a structure whose influence is as random, with three of four candidates.

    If it is faint, it falls to next to nothing at the right end, as at a support.
    """
    rng = np.random.default_rng(4)
    middles = middles_of(edges_mm)
    wave = rng.uniform(0.05, 0.15, (middles.shape[1], 4))
    phase = rng.uniform(0, 3, 4)

    def influence(place_mm: Floats) -> Floats:
        shape: Floats = 0.02 + 0.01 * np.sin(place_mm @ wave + phase)
        return shape * np.clip((42 - place_mm[:, :1]) / 30, 0, 1) ** 3 if faint else shape

    low, high = (np.array([edges[end] for edges in edges_mm]) for end in (0, -1))
    places = rng.uniform(low, high, (contacts, len(edges_mm)))
    weight = rng.uniform(0.5, 1.5, contacts)
    return MeanError(
        force_n=force_n,
        edges_mm=edges_mm,
        shapes=influence(middles),
        sample_mm=influence(places) * rng.uniform(*force_n, contacts)[:, None],
        precision=rng.uniform(0.5, 2.0, (contacts, 4)) / 0.03**2,
        place_mm=places,
        weight=weight / weight.mean(),
        noise=rng.normal(size=(contacts, 3)) if noisy else None,
    )


def plainly(given: MeanError, layout: Sequence[int], kept: Sequence[int]) -> Floats:
    """Return the probabilities (contacts, cells) by a sum over many forces, of the sensors kept in a layout."""
    low, high = given.force_n
    forces = low + (high - low) * (np.arange(300) + 0.5) / 300 if high > low else np.array([low])
    columns = np.array(layout)[list(kept)]
    masses = np.empty((len(given.weight), len(given.shapes)))
    for row, (clean, precision) in enumerate(zip(given.sample_mm, given.precision, strict=True)):
        sample = clean[columns]
        if given.noise is not None:
            sample = sample + given.noise[row, list(kept)] / np.sqrt(precision[columns])
        left = sample - forces[:, None, None] * given.shapes[:, columns]
        log = -(left**2 * precision[columns]).sum(axis=2) / 2
        masses[row] = np.exp(log - log.max()).sum(axis=0)
    masses *= cell_sizes(given.edges_mm)
    normal: Floats = masses / masses.sum(axis=1, keepdims=True)
    return normal


LAYOUT = np.array([0, 2, 3])


@pytest.mark.parametrize("force_n", [(3.0, 3.0), (2.0, 7.0)])
@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("without", [None, 1])
def test_the_mean_error_is_that_of_posteriors_by_a_plain_sum(
    force_n: tuple[float, float], noisy: bool, without: int | None
) -> None:
    given = mean_error([EDGES_MM], force_n, noisy=noisy)
    masses = plainly(given, LAYOUT.tolist(), [0, 1, 2] if without is None else [0, 2])
    distances = np.empty(len(masses))
    along = np.zeros(5)
    for row, mass in enumerate(masses):
        places, fine = finely(EDGES_MM, mass / np.diff(EDGES_MM), 100)
        median = places[np.searchsorted(fine.cumsum(), 0.5)]
        distances[row] = fine @ np.abs(places - median)
        along += given.weight[row] * mass * np.abs((EDGES_MM[1:] + EDGES_MM[:-1]) / 2 - median)
    # What is less likely than the best by e^-10 is left out.
    assert given.of_each(LAYOUT, without) == pytest.approx(distances, abs=0.05)
    assert given.of(LAYOUT, without) == pytest.approx(np.average(distances, weights=given.weight), rel=2e-3)
    expected = along / len(masses) / (np.diff(EDGES_MM) / 35)
    assert given.along_mm(LAYOUT, without) == pytest.approx(expected, rel=0.01, abs=0.01)


def test_a_range_of_forces_that_is_next_to_none_is_one_force() -> None:
    known, nearly = (mean_error([EDGES_MM], (3.0, end)) for end in (3.0, 3.0 + 1e-9))
    given = replace(nearly, sample_mm=known.sample_mm)
    assert given.of_each(LAYOUT) == pytest.approx(known.of_each(LAYOUT), rel=1e-5)


def test_beside_a_support_a_posterior_is_as_wide_as_a_plain_sum_says() -> None:
    given = mean_error([EDGES_MM], (2.0, 7.0), faint=True)
    assert np.abs(given.shapes[-1]).max() < 1e-3 * np.abs(given.shapes).max()
    masses = plainly(given, LAYOUT.tolist(), [0, 1, 2])
    expected = mean_distances([EDGES_MM], masses / np.diff(EDGES_MM))
    assert given.of_each(LAYOUT) == pytest.approx(expected, abs=0.05)


def test_on_two_axes_the_mean_error_is_that_of_the_cells() -> None:
    edges = [EDGES_MM, ACROSS_MM]
    given = mean_error(edges, (2.0, 7.0))
    masses = plainly(given, LAYOUT.tolist(), [0, 1, 2])
    found, sizes = [of_cells(edges, mass) for mass in masses], cell_sizes(edges)
    assert given.of_each(LAYOUT) == pytest.approx(np.array([distance for _, distance in found]), abs=0.05)
    along = sum(
        weight * mass * np.linalg.norm(middles_of(edges) - median, axis=1)
        for weight, mass, (median, _) in zip(given.weight, masses, found, strict=True)
    )
    expected = along / len(masses) / (sizes / sizes.sum())
    assert given.along_mm(LAYOUT) == pytest.approx(expected, rel=0.01, abs=0.01)


def narrow_with(contacts: int, change: float, force_precision: float, seed: int = 8) -> NarrowPosteriors:
    rng = np.random.default_rng(seed)
    return NarrowPosteriors(
        change * rng.normal(size=(contacts, 4, 2)), 0.02 + 0.005 * rng.normal(size=(contacts, 4)), force_precision
    )


@pytest.mark.parametrize("force_precision", [0.0, 0.3, np.inf])
def test_a_narrow_posterior_is_as_wide_as_the_inverse_of_its_information(force_precision: float) -> None:
    narrow = narrow_with(6, 1e-3, force_precision)
    precision = np.random.default_rng(9).uniform(1e4, 4e4, (6, 3))
    found = narrow.distances_mm(slice(1, 5), LAYOUT, precision[1:5])
    angle = 2 * np.pi * (np.arange(4000) + 0.5) / 4000
    around = np.stack([np.cos(angle), np.sin(angle)])
    for row, distance in zip(range(1, 5), found, strict=True):
        moved = np.column_stack([narrow.change[row, LAYOUT], narrow.shape[row, LAYOUT]])
        information = moved.T @ (precision[row][:, None] * moved)
        information[2, 2] += force_precision if np.isfinite(force_precision) else 1e12
        covariance = np.linalg.inv(information)[:2, :2]
        # A radius has the mean sqrt(pi / 2), and stretches along each angle.
        stretched = np.linalg.norm(np.linalg.cholesky(covariance) @ around, axis=0)
        assert distance == pytest.approx(np.sqrt(np.pi / 2) * stretched.mean(), rel=1e-6)


def test_a_place_of_which_readings_tell_nothing_is_infinitely_wide() -> None:
    nothing = NarrowPosteriors(np.zeros((1, 4, 2)), np.ones((1, 4)), np.inf)
    assert np.isinf(nothing.distances_mm(slice(None), LAYOUT, np.ones((1, 3)))).all()


@pytest.mark.parametrize(("force_n", "told"), [((2.0, 20.0), 0.0), ((7.0, 7.0), np.inf)])
def test_on_springs_readings_change_with_the_place_as_the_plate_tilts(
    force_n: tuple[float, float], told: float
) -> None:
    plate = InfluenceFunction(
        (400.0, 300.0), grid_of([np.linspace(10, 390, 20), np.linspace(20, 280, 14)]), force_n, sunk_mm
    )
    sensor_mm, place_mm = (
        np.array([[30.0, 40.0], [350.0, 90.0], [200.0, 250.0]]),
        np.array([[0.0, 300.0], [150.0, 70.0]]),
    )
    found = NarrowPosteriors.of(plate, sensor_mm, place_mm, np.array([3.0, 11.0]))
    tilt = (2 * sensor_mm / SIZE_MM - 1) * 2 / SIZE_MM / (4 * SPRING_N_PER_MM)
    assert found.change == pytest.approx(np.array([3.0, 11.0])[:, None, None] * tilt, rel=1e-9)
    assert found.shape == pytest.approx(sunk_mm(sensor_mm, place_mm))
    assert found.force_precision == pytest.approx(told)


@pytest.mark.parametrize("change", [3e-3, 4e-4, 1e-5])
def test_where_a_posterior_is_narrower_than_its_cell_its_own_width_counts(change: float) -> None:
    edges = [EDGES_MM, ACROSS_MM]
    plain = mean_error(edges, (2.0, 7.0))
    narrow = narrow_with(70, change, 0.0)
    given = replace(plain, narrow=narrow)
    own, coarse = narrow.distances_mm(slice(None), LAYOUT, plain.precision[:, LAYOUT]), plain.of_each(LAYOUT)
    cells = [[int((edge < x).sum()) - 1 for x in places] for edge, places in zip(edges, plain.place_mm.T, strict=True)]
    smaller = np.minimum(np.diff(EDGES_MM)[cells[0]], np.diff(ACROSS_MM)[cells[1]])
    is_own = own < smaller
    assert given.of_each(LAYOUT) == pytest.approx(np.where(is_own, own, coarse))
    masses = plainly(plain, LAYOUT.tolist(), [0, 1, 2])
    sums, sizes = np.zeros(15), cell_sizes(edges)
    for row, mass in enumerate(masses):
        if is_own[row]:
            sums[cells[0][row] * 3 + cells[1][row]] += plain.weight[row] * own[row]
        else:
            median, _ = of_cells(edges, mass)
            sums += plain.weight[row] * mass * np.linalg.norm(middles_of(edges) - median, axis=1)
    expected = sums / len(masses) / (sizes / sizes.sum())
    assert given.along_mm(LAYOUT) == pytest.approx(expected, rel=0.01, abs=0.01)
    kept = LAYOUT[[0, 2]]
    own, coarse = narrow.distances_mm(slice(None), kept, plain.precision[:, kept]), plain.of_each(LAYOUT, 1)
    assert given.of_each(LAYOUT, 1) == pytest.approx(np.where(own < smaller, own, coarse))


def test_contacts_are_drawn_with_errors_for_their_samples_and_the_weight_of_how_seldom_they_are_drawn() -> None:
    """Cells are as many as the range has mean errors, within their least and largest number."""
    candidate_mm, errors = on_axis(np.array([60.0, 130.0, 220.0, 350.0])), Errors(0.03, 0.02, 0.01)
    clean, noisy = (
        mean_error_of(
            STRING, candidate_mm, LAYOUT, errors, np.random.default_rng(2), contacts=64, cells=cells, noisy=one
        )
        for one, cells in ((False, (4, 400)), (True, (200, 240)))
    )
    wanted = 380 / cramer_rao_error_mm(Prior.of(STRING, candidate_mm[LAYOUT], errors))
    assert 8 < wanted < 100
    assert (len(clean.edges_mm[0]), len(noisy.edges_mm[0])) == (int(wanted) + 1, 201)
    for given, spread in ((clean, 2.0), (noisy, 1.0)):
        forces = given.sample_mm / string_mm(candidate_mm, given.place_mm)
        assert forces == pytest.approx(np.tile(forces[:, :1], 4))
        assert forces.min() >= 2
        assert forces.max() <= 20
        variance = 0.03**2 + (0.02 * given.sample_mm) ** 2 + 0.01**2
        assert given.precision == pytest.approx(1 / (spread * variance))
        assert given.weight.mean() == pytest.approx(1 / np.sqrt(spread))
        assert given.shapes == pytest.approx(string_mm(candidate_mm, middles_of(given.edges_mm)))
        assert given.edges_mm[0][[0, -1]] == pytest.approx([10, 390])
        assert given.narrow is None
    assert clean.noise is None
    assert noisy.noise is not None
    assert noisy.noise.shape == (64, 3)


def test_the_mounting_of_sensors_counts_as_their_change_along_the_string() -> None:
    candidate_mm = on_axis(np.array([60.0, 130.0, 220.0, 350.0]))
    plain, mounted = (
        mean_error_of(
            STRING,
            candidate_mm,
            LAYOUT,
            Errors(0.03, mounting_mm=mounting_mm),
            np.random.default_rng(2),
            contacts=16,
            cells=(24, 40),
        )
        for mounting_mm in (0.0, 0.5)
    )
    added = 1 / mounted.precision / 2 - 0.03**2
    force = mounted.sample_mm / string_mm(candidate_mm, mounted.place_mm)
    slope = np.where(mounted.place_mm > candidate_mm.T, 400 - mounted.place_mm, -mounted.place_mm) / (400 * 100)
    beside = np.abs(candidate_mm.T - mounted.place_mm) > 3  # under the load, the string has a kink
    assert added[beside] == pytest.approx(((0.5 * slope * force) ** 2)[beside], rel=1e-6)
    assert plain.precision == pytest.approx(1 / (2 * 0.03**2))
