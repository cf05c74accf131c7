"""Graphs of a posterior on surfaces whose sensors show a known force by levers: normal densities, in closed form."""

import math

import numpy as np
import onnx
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.estimators.posterior.cells import cells_of, resolving_cells
from beamtouch_models.design.estimators.posterior.plane import plane_graph, table_of
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.design.estimators.posterior.window import table_of as path_of
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.session import runner

FORCE_N = 10.0
TURNED = np.array([[1.0, 0.2], [0.6, 0.8], [0.2, -0.5], [-0.9, 0.3], [0.1, 0.7]]) / 400
"""Slopes of five sensors along both axes, in mm/N per mm."""
EVEN = np.array([1.5, 0.7, 1.2, 1.9, 0.4])
"""What they show beside that."""
EXTENT = Extent(((10.0, 390.0), (20.0, 230.0)))


def plate(noise_mm: float, force_n: tuple[float, float] = (FORCE_N, FORCE_N)) -> Prior:
    return Prior(EXTENT, 470.0, force_n, Errors(noise_mm), 5, lambda place_mm: place_mm @ TURNED.T + EVEN)


def bar(noise_mm: float, slopes: Floats, even: Floats, force_n: tuple[float, float] = (FORCE_N, FORCE_N)) -> Prior:
    return Prior(
        Extent.of_beam((40.0, 540.0)), 640.0, force_n, Errors(noise_mm), len(even), lambda at_mm: at_mm * slopes + even
    )


def answers_of(graph: onnx.ModelProto, noise_mm: float, samples_mm: Floats) -> dict[str, Floats]:
    whitening = np.broadcast_to(np.eye(samples_mm.shape[1]) / noise_mm, (*samples_mm.shape, samples_mm.shape[1]))
    found = runner(to_bytes(graph))(samples_mm, whitening)
    return {name: values.astype(np.float64) for name, values in found.items()}


def normal_places(samples_mm: Floats, slopes: Floats, even: Floats, noise_mm: float) -> tuple[Floats, Floats, Floats]:
    """Return the likeliest places (samples, axes), their covariance, and the squares that they leave (samples,)."""
    levers = FORCE_N * slopes
    places, left, *_ = np.linalg.lstsq(levers, (samples_mm - FORCE_N * even).T)
    covariance_mm2: Floats = noise_mm**2 * np.asarray(np.linalg.inv(levers.T @ levers), np.float64)
    return places.T.astype(np.float64), covariance_mm2, left.astype(np.float64) / noise_mm**2


PLACES_MM = np.array([[210.0, 128.0], [163.0, 101.0], [243.0, 140.0], [190.0, 90.0]])


def plate_samples(noise_mm: float, spread: float = 1.0) -> Floats:
    noise = spread * noise_mm * np.random.default_rng(3).standard_normal((len(PLACES_MM), 5))
    return np.asarray(FORCE_N * (PLACES_MM @ TURNED.T + EVEN) + noise)


@pytest.mark.parametrize(("noise_mm", "wider"), [(0.6, 0.18), (0.1, 0.1), (0.02, 0.09), (0.001, 0.18)])
def test_a_plate_whose_sensors_show_a_force_by_levers_has_a_normal_posterior(noise_mm: float, wider: float) -> None:
    """Wide ones hold more of the tails of the force, narrow ones are wider by up to a cell."""
    prior = plate(noise_mm)
    samples_mm = plate_samples(noise_mm)
    answers = answers_of(plane_graph(prior, with_force=True, finest=prior), noise_mm, samples_mm)
    place_mm, covariance_mm2, left = normal_places(samples_mm, TURNED, EVEN, noise_mm)
    deviation_mm = np.sqrt(np.diag(covariance_mm2))
    for axis, name in enumerate("xy"):
        off = (answers[f"{name}_mm"] - place_mm[:, axis]) / deviation_mm[axis]
        assert off == pytest.approx(np.zeros(4), abs=0.06)
        for end, sign in (("low", -1), ("high", 1)):
            reach = sign * (answers[f"{name}_{end}_mm"] - answers[f"{name}_mm"]) / deviation_mm[axis]
            assert reach == pytest.approx(np.full(4, 1.96), rel=wider)
            assert reach.min() > 1.94  # cells widen a density, and never narrow it
    correlation = covariance_mm2[0, 1] / deviation_mm.prod()
    assert abs(correlation) > 0.1
    assert answers["place_correlation"] == pytest.approx(np.full(4, correlation), abs=0.02)
    assert answers["misfit"] == pytest.approx(left, rel=0.06, abs=0.1)
    assert answers["force_n"] == pytest.approx(np.full(4, FORCE_N), rel=1e-4)


def test_the_log_odds_of_a_plate_are_those_of_the_whole_extent() -> None:
    prior = plate(0.6)
    samples_mm = plate_samples(0.6)
    answers = answers_of(plane_graph(prior, with_force=False, finest=prior), 0.6, samples_mm)
    # Without a prior of the force: a sum over many places, each with its best force.
    ticks = [np.linspace(low, high, 401)[1::2] for low, high in EXTENT.ranges_mm]
    shapes = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2) @ TURNED.T + EVEN
    sizes = (shapes**2).sum(axis=1)
    for sample_mm, odds in zip(samples_mm / 0.6, answers["contact_log_odds"], strict=True):
        explained = (shapes @ sample_mm) ** 2 / sizes / 2
        assert odds == pytest.approx(explained.max() + np.log(np.exp(explained - explained.max()).mean()), abs=2e-3)


def test_a_place_out_of_the_extent_of_a_plate_is_told_at_its_rim() -> None:
    """Along the other axis, it is where the normal density has most beside the rim."""
    noise_mm = 0.02
    prior, beyond_mm = plate(noise_mm), np.array([[9.0, 120.0], [391.0, 60.0], [200.0, 18.0], [100.0, 231.0]])
    samples_mm = FORCE_N * (beyond_mm @ TURNED.T + EVEN)
    answers = answers_of(plane_graph(prior, with_force=False, finest=prior), noise_mm, samples_mm)
    found_mm = np.stack([answers["x_mm"], answers["y_mm"]], axis=1)
    _, covariance_mm2, _ = normal_places(samples_mm, TURNED, EVEN, noise_mm)
    for row, (axis, rim_mm) in enumerate([(0, 10.0), (0, 390.0), (1, 20.0), (1, 230.0)]):
        deviation_mm = np.sqrt(np.diag(covariance_mm2))
        assert 0 < abs(found_mm[row, axis] - rim_mm) < deviation_mm[axis]
        end = "low" if rim_mm < 100 and (axis, rim_mm) != (1, 230.0) else "high"
        assert answers[f"{'xy'[axis]}_{end}_mm"][row] == pytest.approx(rim_mm, abs=1e-3)
        other, slope = 1 - axis, covariance_mm2[axis, 1 - axis] / covariance_mm2[axis, axis]
        expected_mm = beyond_mm[row, other] + slope * (found_mm[row, axis] - beyond_mm[row, axis])
        assert found_mm[row, other] == pytest.approx(expected_mm, abs=0.1 * deviation_mm[other])


def bent(share: float, channels: int) -> Prior:
    """Return a plate with curved shapes, whose straight lines between 65 nodes err by a share of what is allowed.

    Between two nodes, x^2 is a quarter of the square of their distance above a straight line, in the middle of a cell.
    """
    off = np.full(channels, share / math.sqrt(channels))
    size_mm = EXTENT.size_mm

    def curved(place_mm: Floats) -> Floats:
        along = (place_mm - [10.0, 20.0]) / size_mm
        bends = 4 * 64**2 / 2 * (along**2).sum(axis=1)
        return np.asarray(bends[:, None] * off * 0.1 * 0.01 / FORCE_N)

    return Prior(EXTENT, 470.0, (2.0, FORCE_N), Errors(0.01), channels, curved)


@pytest.mark.parametrize(
    ("share", "channels", "along"),
    [
        (0.97, 3, 65),
        (1.03, 3, 97),
        (2.2, 3, 97),
        (2.3, 3, 129),
        (15.0, 3, 257),
        (1e3, 3, 257),
        # A table has at most 700 000 numbers: of ten channels 257^2 rows, of eleven 193^2.
        (1e3, 10, 257),
        (1e3, 11, 193),
    ],
)
def test_a_table_has_nodes_enough_for_straight_lines_between_them(share: float, channels: int, along: int) -> None:
    prior = bent(share, channels)
    table = table_of(prior)
    assert table.shape == (along**2, channels)
    ends = np.array([[10.0, 20.0], [10.0, 230.0], [390.0, 20.0], [390.0, 230.0]])
    assert table[[0, along - 1, -along, -1]] == pytest.approx(prior.influence_at(ends), rel=1e-3, abs=1e-9)


SLOPES, BESIDE = np.array([1.0, -0.6, 0.3]) / 500, np.array([0.3, 1.1, 0.7])


@pytest.mark.parametrize(
    ("noise_mm", "wider", "cells"), [(0.1, 0.1, 192), (0.03, 0.1, 384), (0.004, 0.01, None), (0.0005, 0.01, None)]
)
def test_a_bar_whose_sensors_show_a_force_by_levers_has_a_normal_posterior(
    noise_mm: float, wider: float, cells: int | None
) -> None:
    prior, at_mm = bar(noise_mm, SLOPES, BESIDE), np.array([[310.0], [222.0], [401.0], [287.0]])
    assert resolving_cells(prior) == cells
    noise = noise_mm * np.random.default_rng(5).standard_normal((4, 3))
    samples_mm = FORCE_N * (at_mm * SLOPES + BESIDE) + noise
    answers = answers_of(posterior_graph(prior, with_force=True), noise_mm, samples_mm)
    place_mm, covariance_mm2, left = normal_places(samples_mm, SLOPES[:, None], BESIDE, noise_mm)
    deviation_mm = math.sqrt(covariance_mm2[0, 0])
    assert (answers["position_mm"] - place_mm[:, 0]) / deviation_mm == pytest.approx(np.zeros(4), abs=0.02)
    for end, sign in (("low", -1), ("high", 1)):
        reach = sign * (answers[f"position_{end}_mm"] - answers["position_mm"]) / deviation_mm
        assert reach == pytest.approx(np.full(4, 1.96), rel=wider)
    assert answers["misfit"] == pytest.approx(left, rel=3e-3)
    assert answers["force_n"] == pytest.approx(np.full(4, FORCE_N), rel=1e-4)
    # The log odds, without a prior of the force, are a mean over places, each with its best force.
    shapes = np.linspace(40.0, 540.0, 100_001)[1::2, None] * SLOPES + BESIDE
    sizes = (shapes**2).sum(axis=1)
    for sample_mm, odds in zip(samples_mm / noise_mm, answers["contact_log_odds"], strict=True):
        explained = (shapes @ sample_mm) ** 2 / sizes / 2
        expected = explained.max() + np.log(np.exp(explained - explained.max()).mean())
        assert odds == pytest.approx(expected, rel=1e-5, abs=0.02)


@pytest.mark.parametrize(
    ("deviations", "loudness", "cells"),
    [
        # No cell is larger than 1.2 deviations; their number is a multiple of 64.
        (50.0, 59.0, 128),
        (50.0, 61.0, 192),
        (225.0, 590.0, 192),
        (232.0, 590.0, 256),
        (100.0, 610.0, 256),
        (300.0, 610.0, 256),
        (309.0, 610.0, 320),
        (590.0, 900.0, 512),
        (620.0, 900.0, None),
    ],
)
def test_a_known_force_needs_a_cell_for_each_of_so_many_deviations(
    deviations: float, loudness: float, cells: int | None
) -> None:
    """`loudness` is the size of the loudest sample; a lever moves it by so many `deviations` from end to end."""
    slope = deviations / 500 / FORCE_N
    ends = np.array([40.0, 540.0]) * slope * FORCE_N
    beside = math.sqrt(loudness**2 - ends[1] ** 2) / FORCE_N
    assert resolving_cells(bar(1.0, np.array([slope, 0.0]), np.array([0.0, beside]))) == cells


@pytest.mark.parametrize(
    ("turn_rad", "loudness", "cells"),
    [(2.9, 110.0, 192), (4.3, 110.0, 192), (4.4, 110.0, 256), (1.93, 640.0, 512), (2.02, 640.0, None)],
)
def test_an_open_force_needs_a_cell_for_each_of_two_and_a_half_deviations_that_the_direction_turns(
    turn_rad: float, loudness: float, cells: int | None
) -> None:
    def turning(at_mm: Floats) -> Floats:
        angle = turn_rad * (at_mm[:, 0] - 40) / 500
        return loudness / FORCE_N * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    prior = Prior(Extent.of_beam((40.0, 540.0)), 640.0, (2.0, FORCE_N), Errors(1.0), 2, turning)
    assert resolving_cells(prior) == cells


@pytest.mark.parametrize(
    # An arc of 2.5 in n parts has a sagitta of L (2.5 / n)^2 / 8, which is to be a hundredth of a deviation.
    ("loudness", "steps"),
    [(100.0, 128), (209.0, 128), (211.0, 129), (1e4, 884), (8.4e5, 8101), (1e6, 8192)],
)
def test_a_path_has_nodes_enough_for_straight_lines_between_them(loudness: float, steps: int) -> None:
    slope = 0.001 * loudness / 540.0
    beside = math.sqrt(loudness**2 - (540.0 * slope) ** 2)
    prior = bar(1.0, np.array([slope, 0.0]) / FORCE_N, np.array([0.0, beside]) / FORCE_N)
    table = path_of(prior)
    assert table.steps == steps
    assert table.position_mm[[0, -1]] == pytest.approx([40.0, 540.0])
    assert table.influence == pytest.approx(prior.influence_at(table.position_mm[:, None]), rel=1e-4, abs=1e-6)
    assert table.stretches.tolist() == [0.0, steps]
    assert table.variance is None


@pytest.mark.parametrize(("least", "is_held"), [(0.0, True), (0.045, True), (0.055, False)])
def test_a_place_that_hardly_moves_the_sensors_parts_a_path_in_two(least: float, is_held: bool) -> None:
    """Beside a support, at 200 mm here, two places look alike."""

    def folded(at_mm: Floats) -> Floats:
        away = (at_mm[:, 0] - 200) / 340
        return 100 * np.stack([np.abs(away) * math.sqrt(1 - least**2), np.full(len(away), least)], axis=1)

    prior = Prior(Extent.of_beam((40.0, 540.0)), 640.0, (2.0, FORCE_N), Errors(1.0), 2, folded)
    table = path_of(prior)
    assert len(table.stretches) == (3 if is_held else 2)
    if is_held:
        assert np.interp(table.stretches[1], np.arange(table.steps + 1), table.position_mm) == pytest.approx(
            200, abs=0.2
        )


@pytest.mark.parametrize(
    ("force_n", "share"),
    # In a metric of the change of a sample, 1 and 3, and of the place, as the mean change or half of it.
    [((2.0, FORCE_N), 5**0.5 / (5**0.5 + 13**0.5)), ((FORCE_N, FORCE_N), 2**0.5 / (2**0.5 + 10**0.5))],
)
def test_cells_are_narrow_where_samples_change_much(force_n: tuple[float, float], share: float) -> None:
    def turning(at_mm: Floats) -> Floats:
        along = (at_mm[:, 0] - 40) / 500
        angle = along + 2 * np.maximum(along - 0.5, 0.0)
        return 20 * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    prior = Prior(Extent.of_beam((40.0, 540.0)), 640.0, force_n, Errors(1.0), 2, turning)
    cells = cells_of(prior, 200)
    assert cells.edges_mm[[0, -1]] == pytest.approx([40.0, 540.0])
    assert np.searchsorted(cells.edges_mm, 290.0) == pytest.approx(200 * share, abs=1.5)
    assert len(cells.influence) == 200
    halfway = (cells.edges_mm[1:] + cells.edges_mm[:-1]) / 2
    assert cells.influence == pytest.approx(prior.influence_at(halfway[:, None]), abs=0.01)


def test_cells_of_an_open_force_are_even_in_the_logarithm_of_a_size_that_alone_changes() -> None:
    def growing(at_mm: Floats) -> Floats:
        return np.asarray((1 + 3 * (at_mm - 40) / 500) * [0.6, 0.8])

    prior = Prior(Extent.of_beam((40.0, 540.0)), 640.0, (2.0, FORCE_N), Errors(1.0), 2, growing)
    assert cells_of(prior, 2).edges_mm == pytest.approx([40.0, 40 + 500 / 3, 540.0], abs=0.5)
