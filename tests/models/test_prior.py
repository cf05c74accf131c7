"""The prior of a surface: its forces, the samples of its contacts, and what is left of it without some channels."""

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import MAX_FORCE_RATIO, TAIL, Piece, Prior, forces_of, interval_forces
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from models.bar_on_scales import LENGTH_MM, three_scales

LOADINGS = np.array([[0.8, 0.3], [0.5, -0.4], [-0.6, 0.7]])
PLACE_MM, FORCE_N = np.array([[26.0], [91.0]]), np.array([3.0, 16.0])
CLEAN_MM = np.array([[2.4, 0.6, 0.6], [4.8, 11.2, 4.8]])
MOVED_MM2 = np.array([[0.09, 0.18, 0.27], [2.56, 5.12, 7.68]])


def variance(place_mm: Floats) -> Floats:
    return np.tile([0.01, 0.02, 0.03], (len(place_mm), 1))


def prior(**fields: object) -> Prior:
    errors = Errors(0.05, gain=np.array([0.01, 0.02, 0.03]), zero_mm=0.12)
    made = Prior(Extent.of_beam((13.0, 117.0)), LENGTH_MM, (2.0, 20.0), errors, 3, three_scales)
    return dataclasses.replace(made, **fields)  # type: ignore[arg-type]


def test_forces_are_those_of_the_range_and_a_tail_as_large_on_either_side() -> None:
    assert forces_of((2.0, 20.0), 0.0) == (Piece(2.0, 20.0, 1.0),)
    below, core, above = forces_of((2.0, 20.0), 0.03)
    assert (below.low_n, below.high_n, core.low_n, core.high_n, above.low_n, above.high_n) == (0, 2, 2, 20, 20, 200)
    assert (below.share, core.share, above.share) == pytest.approx((0.015, 0.97, 0.015))
    assert forces_of((2.0, 20.0)) == forces_of((2.0, 20.0), TAIL)


@pytest.mark.parametrize("force_n", [(2.0, 20.0), (8.0, 12.0), (9.9, 10.1)])
def test_forces_of_intervals_are_side_by_side_from_nothing_to_ten_times_the_largest(
    force_n: tuple[float, float],
) -> None:
    pieces = interval_forces(force_n)
    assert sum(piece.share for piece in pieces) == pytest.approx(1)
    assert (pieces[0].low_n, pieces[-1].high_n) == (0.0, MAX_FORCE_RATIO * force_n[1])
    assert all(one.high_n == after.low_n < after.high_n for one, after in pairwise(pieces))
    assert pieces[0].high_n == pytest.approx(force_n[0] / 3)
    assert pieces[-1].low_n == pytest.approx(3 * force_n[1])


def test_an_open_range_ends_where_it_is_stated_and_a_force_outside_is_about_as_likely() -> None:
    """A density of about one over the force below it, and over its square above."""
    lowest, below, core, above, highest = interval_forces((2.0, 20.0))
    assert (core.low_n, core.high_n) == (2.0, 20.0)
    least, less, within, more, most = (
        piece.share / (piece.high_n - piece.low_n) for piece in (lowest, below, core, above, highest)
    )
    assert least / less == pytest.approx((4 / 3) / (1 / 3) / 1.7, rel=0.1)
    assert 1.5 < less / within < 2
    assert more / within == pytest.approx(0.5, rel=0.01)
    assert most / more == pytest.approx(0.2, rel=0.01)


def test_a_nearly_exact_range_is_a_fifth_wider_between_tails_as_thin_as_those_of_the_range() -> None:
    low, high = 10 * (1 - 1e-6), 10 * (1 + 1e-6)
    *below, core, above, highest = interval_forces((low, high), 0.04)
    assert (core.low_n - 10, core.high_n - 10) == pytest.approx((-1.2e-5, 1.2e-5), rel=1e-6)
    assert core.share == pytest.approx(0.96)
    assert sum(piece.share for piece in below) == pytest.approx(0.02)
    assert above.share + highest.share == pytest.approx(0.02)
    assert below[0].share / below[1].share == pytest.approx(0.5, rel=1e-4)  # evenly: a third of the force, and the rest
    assert above.share / highest.share == pytest.approx(2 / 7, rel=1e-4)
    assert interval_forces((10.0, 10.0), 0.04) == forces_of((10.0, 10.0), 0.04)


def test_a_sample_has_the_errors_of_noise_zeros_gains_and_mounting() -> None:
    clean, deviation = prior().sampled(PLACE_MM, FORCE_N)
    assert clean == pytest.approx(CLEAN_MM)
    own = 0.05**2 + 0.12**2 + (np.array([0.01, 0.02, 0.03]) * CLEAN_MM) ** 2
    assert deviation == pytest.approx(own**0.5)
    moved = prior(variance_at=variance)
    assert moved.sampled(PLACE_MM, FORCE_N)[1] == pytest.approx((own + MOVED_MM2) ** 0.5)
    assert moved.tabled_deviation_mm(PLACE_MM, FORCE_N[:, None]) == pytest.approx((own + MOVED_MM2) ** 0.5, rel=1e-6)
    assert prior().tabled_deviation_mm(PLACE_MM, FORCE_N[:, None]) == pytest.approx(own**0.5, rel=1e-6)
    assert prior().rest_mm == pytest.approx(np.full(3, 0.13))


@pytest.mark.parametrize("shared", [None, LOADINGS])
def test_samples_scatter_by_their_covariance(shared: Floats | None) -> None:
    """By what each unit of independent errors does: the columns of a factor of the covariance."""
    surface = prior(variance_at=variance, shared=shared)
    correlation = np.eye(3) if shared is None else shared @ shared.T
    correlation[np.diag_indices(3)] = 1.0
    own = 0.05**2 + 0.12**2 + (np.array([0.01, 0.02, 0.03]) * CLEAN_MM) ** 2
    units = np.repeat(np.eye(3), 2, axis=0)
    places, forces = np.tile(PLACE_MM, (3, 1)), np.tile(FORCE_N, 3)
    for method, more in ((surface.with_errors, own), (surface.moved, np.zeros((2, 3)))):
        at_rest = method(places, forces, np.zeros((6, 3)))
        factor = (method(places, forces, units) - at_rest).reshape(3, 2, 3)
        found = np.einsum("kcs,kct->cst", factor, factor)
        root = MOVED_MM2**0.5
        expected = root[:, :, None] * correlation * root[:, None, :] + more[:, :, None] * np.eye(3)
        assert found == pytest.approx(expected)
    assert surface.with_errors(places[:2], forces[:2], np.zeros((2, 3))) == pytest.approx(CLEAN_MM)


def test_exact_places_move_nothing_and_draws_are_those_of_their_generator() -> None:
    assert prior().moved(PLACE_MM, FORCE_N, np.ones((2, 3))).tolist() == np.zeros((2, 3)).tolist()
    normal = np.random.default_rng(4).normal(size=(2, 3))
    drawn = prior(variance_at=variance).draw(PLACE_MM, FORCE_N, np.random.default_rng(4))
    assert drawn == pytest.approx(prior(variance_at=variance).with_errors(PLACE_MM, FORCE_N, normal))


def test_other_noises_and_floors_leave_the_rest() -> None:
    surface = prior(variance_at=variance, shared=LOADINGS)
    quieter, none = surface.at_noise(0.02), surface.at_noise(0.0)
    assert (quieter.errors.noise_mm, quieter.errors.zero_mm, quieter.shared is LOADINGS) == (0.02, 0.12, True)
    assert (none.errors.noise_mm, none.errors.gain, none.errors.zero_mm, none.variance_at, none.shared) == (
        0,
        0,
        0,
        None,
        None,
    )
    floor = surface.with_floor(0.5, np.array([1.0, 2.0, 3.0]))
    assert (floor.errors.gain, floor.errors.noise_mm, floor.variance_at is variance) == (0.5, 0.05, True)
    alone = surface.with_noise_alone(0.3)
    assert (alone.errors.noise_mm, alone.errors.zero_mm, alone.variance_at, alone.shared) == (0.3, 0.0, None, None)


def test_without_some_channels_the_others_keep_their_influence_and_errors() -> None:
    whole, place = prior(variance_at=variance, shared=LOADINGS), PLACE_MM
    left = whole.without(1)
    assert left.channels == 2
    assert left.influence_at(place) == pytest.approx(whole.influence_at(place)[:, [0, 2]])
    assert left.variance_at is not None
    assert left.variance_at(place) == pytest.approx(variance(place)[:, [0, 2]])
    assert left.shared is not None
    assert left.shared.tolist() == LOADINGS[[0, 2]].tolist()
    assert (np.asarray(left.errors.gain).tolist(), np.asarray(left.errors.zero_mm).tolist()) == (
        [0.01, 0.03],
        [0.12] * 2,
    )
    bare = prior().without(0, 1)
    assert (bare.channels, bare.variance_at, bare.shared) == (1, None, None)


def test_influence_comes_from_a_table_where_the_noise_hides_what_that_is_off_by() -> None:
    """The largest deflection here is 20 N times 0.9 mm/N."""
    kink_mm = np.array([[LENGTH_MM / 2 + 1e-3]])
    assert prior().largest_mm == pytest.approx(18.0)
    exact, tabled = three_scales(kink_mm), prior().influence_table(kink_mm)
    assert exact[0, 2] != pytest.approx(tabled[0, 2], rel=1e-6)
    fine, coarse = prior().at_noise(2.9e-4 * 18), prior().at_noise(3.1e-4 * 18)
    assert fine.influence_within_noise(kink_mm).tolist() == exact.tolist()
    assert coarse.influence_within_noise(kink_mm).tolist() == tabled.tolist()
    assert (prior().axes, prior().force_range.low_n, prior().force_range.high_n) == (("position",), 2.0, 20.0)


@pytest.mark.parametrize("noise", [2.9e-4, 3.1e-4])
@pytest.mark.parametrize("with_variance", [True, False])
def test_influence_on_grids_of_two_axes_comes_from_the_same_table(noise: float, *, with_variance: bool) -> None:
    def tent(place_mm: Floats) -> Floats:
        share = place_mm / [80.0, 50.0]
        return np.stack([np.minimum(share, 1 - share).sum(axis=1), share[:, 0], share[:, 1]], axis=1)

    extent = Extent(((0.0, 80.0), (0.0, 50.0)))
    surface = prior(extent=extent, influence_at=tent, variance_at=variance if with_variance else None)
    surface = surface.at_noise(noise * 20 * 1.0)
    ticks = [np.array([[20.0, 40.001, 44.0], [65.0, 66.0, 70.0]]), np.array([[20.0, 25.001], [5.0, 35.0]])]
    on_grids, spread = surface.influence_in(ticks)
    expected_at = tent if noise < 3e-4 else surface.influence_table
    places = [np.array([[x, y] for x in xs for y in ys]) for xs, ys in zip(*ticks, strict=True)]
    assert on_grids == pytest.approx(np.stack([expected_at(each) for each in places]), rel=1e-9)
    assert (spread is not None) == with_variance
    assert spread is None or spread == pytest.approx(np.tile([0.01, 0.02, 0.03], (2, 6, 1)))
