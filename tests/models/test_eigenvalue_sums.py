"""The eigenvalue product and the bound on it beside numpy's own eigenvalues, and the counts that follow from them."""

from itertools import combinations

import numpy as np
import pytest

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.placement.eigenvalue_bound import bound_layouts, gap_of, largest_gap, rounding_margin
from beamtouch_models.design.placement.eigenvalue_product import (
    EigenvalueProduct,
    discernible,
    eigenvalue_product_of,
    log_eigenvalue_product,
    principal_components,
)
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.placement.placing import Aim, Placement, _checked, place, recommended_count, score_layout
from beamtouch_models.errors import NotGoodEnoughError, SceneError
from beamtouch_models.places import on_axis
from models.loaded_string import STRING, string_mm

GRID_MM = np.array([30.0, 80.0, 130.0, 200.0, 240.0, 310.0, 360.0])
NONE = np.array([], dtype=np.intp)
RULES = LayoutRules(on_axis(GRID_MM), NONE, 0.0)


def moments(matrix: Floats) -> Floats:
    """Return the eigenvalues of the second moments, the largest first."""
    values: Floats = np.linalg.eigvalsh(matrix.T @ matrix / len(matrix)).astype(np.float64)[::-1]
    return values


def columns(*places: int) -> Floats:
    return string_mm(on_axis(GRID_MM[list(places)]), STRING.place_mm)


@pytest.mark.parametrize("scale", [1.0, 3e-5, 700.0])
def test_components_are_the_eigenvectors_of_second_moments(scale: float) -> None:
    matrix = scale * columns(0, 2, 3, 5)
    found = principal_components(matrix)
    assert found.eigenvalues == pytest.approx(moments(matrix))
    for value, vector in zip(found.eigenvalues, found.vectors.T, strict=True):
        assert matrix.T @ matrix / len(matrix) @ vector == pytest.approx(value * vector, abs=1e-9 * scale**2)
        assert np.linalg.norm(vector) == pytest.approx(1)
        assert vector[np.abs(vector).argmax()] > 0
    assert found.transformed == pytest.approx(matrix @ found.vectors, abs=1e-9 * scale)


def test_what_is_beyond_the_range_of_floats_is_refused_and_nothing_has_no_size() -> None:
    for scale in (1e160, 1e-170):
        with pytest.raises(ValueError, match=r"entries up to .*e[+-]\d+ leave the range of float64; scale it"):
            principal_components(scale * columns(0, 2))
    with pytest.raises(ValueError, match="an influence matrix must be finite"):
        principal_components(np.full((4, 2), np.nan))
    assert principal_components(np.zeros((4, 2))).eigenvalues.tolist() == [0.0, 0.0]
    assert log_eigenvalue_product(np.zeros((4, 2))) == -np.inf


@pytest.mark.parametrize("leading", [1, 2, 3, 4])
def test_the_log_product_is_that_of_the_largest_eigenvalues(leading: int) -> None:
    matrix = 1e-3 * columns(0, 2, 3, 5)
    expected = np.log(moments(matrix)[:leading]).sum()
    assert log_eigenvalue_product(matrix, leading) == pytest.approx(expected)
    assert log_eigenvalue_product(matrix, 5) == -np.inf
    twice = np.column_stack([matrix, matrix[:, :1]])
    assert log_eigenvalue_product(twice, 5) == log_eigenvalue_product(twice) == -np.inf
    assert log_eigenvalue_product(twice, 4) == pytest.approx(np.log(moments(twice)[:4]).sum())
    # Sensors that hardly move count as much as others: only their scale is less.
    assert log_eigenvalue_product(matrix * [1, 1e-9, 1, 1]) == pytest.approx(
        log_eigenvalue_product(matrix) - 2 * 9 * np.log(10)
    )
    both_hardly = np.column_stack([matrix, 1e-9 * matrix[:, :1] * [1.0, 0.3]])
    assert log_eigenvalue_product(both_hardly[:, 1:]) == -np.inf
    assert score_layout(STRING, on_axis(GRID_MM[[0, 2, 3, 5]]), leading) == pytest.approx(
        np.log(moments(columns(0, 2, 3, 5))[:leading]).sum()
    )


@pytest.mark.parametrize(("noise", "count"), [(3.9, 0), (2.9, 1), (1.9, 2), (0.9, 3), (0.4, 4), (0.0, 4)])
def test_components_count_whose_root_mean_square_exceeds_the_noise(noise: float, count: int) -> None:
    values = np.array([3.5, 2.5, 1.5, 0.5, 1e-17]) ** 2
    assert discernible(values, noise) == count
    assert discernible(values, 3.5) == 0


@pytest.mark.parametrize("number", [3, 4, 6])
def test_the_paper_s_number_of_sensors_counts_components_of_eight_beyond_the_noise(number: int) -> None:
    """Forces from 2 to 20 N have the mean square 148 N^2."""
    matrix = string_mm(on_axis(400 * np.arange(1, 9) / 9), STRING.place_mm)
    shown_mm = np.sqrt(148 * moments(matrix))
    assert recommended_count(STRING, 1.001 * float(shown_mm[number])) == number
    assert recommended_count(STRING, 0.999 * float(shown_mm[number])) == number + 1
    assert recommended_count(STRING, 2 * float(shown_mm[0])) == 2


def product_of(count: int, leading: int | None = None, *, rules: LayoutRules = RULES) -> EigenvalueProduct:
    return eigenvalue_product_of(STRING, rules, count, leading)


def every(count: int) -> Indices:
    return np.array(list(combinations(range(len(GRID_MM)), count)), dtype=np.intp)


@pytest.mark.parametrize("leading", [1, 2, 3])
def test_scores_of_layouts_are_their_log_products(leading: int) -> None:
    product, layouts = product_of(3, leading), every(3)
    expected = [np.log(moments(columns(*layout))[:leading]).sum() for layout in layouts.tolist()]
    assert product.scores(layouts) == pytest.approx(np.array(expected), abs=1e-6)
    assert [product.exact_score(layout) for layout in layouts] == pytest.approx(expected)
    assert product.scores(np.array([[2, 2, 4]])).tolist() == [-np.inf]
    # What the coordinates leave out is in the tail.
    lengths = (product.matrix**2).sum(axis=0)
    assert (product.features**2).sum(axis=0) + product.tail == pytest.approx(lengths)
    assert product.tail.max() < 1e-6 * lengths.max()
    gram = product.matrix.T @ product.matrix
    assert product.features.T @ product.features == pytest.approx(gram, abs=1e-6 * lengths.max())
    squares = (product.features**2).sum(axis=1)
    assert squares[0] == squares.max()


def test_a_search_starts_at_equal_pitch_at_the_most_independent_columns_and_at_places_at_random() -> None:
    product = product_of(3)
    starts = product.starts(5)
    assert len(starts) == 6
    assert starts[0].tolist() == product.equal.tolist() == [1, 3, 5]
    assert starts[1].tolist() == sorted(product.pivots[:3].tolist())
    assert all(product.rules.allowed(start[None])[0] for start in starts)
    assert [start.tolist() for start in product.starts(5)] == [start.tolist() for start in starts]
    assert len({tuple(start) for seed in range(20) for start in product.starts(seed)[2:]}) > 15
    fixed = product_of(3, rules=LayoutRules(on_axis(GRID_MM), np.array([4]), 0.0))
    assert all(4 in start for start in fixed.starts(5))


@pytest.mark.parametrize(("count", "leading"), [(2, 2), (3, 3), (3, 2), (3, 1)])
def test_the_bound_holds_for_each_layout_through_each_place_whatever_the_weights(count: int, leading: int) -> None:
    product, layouts = product_of(count, leading), every(count)
    scores = [product.exact_score(layout) for layout in layouts]
    rng = np.random.default_rng(7)
    for power in (0.2, 1.0, 4.0):
        mask = np.ones((count, len(GRID_MM)), dtype=np.bool_)
        weights = rng.uniform(size=mask.shape) ** power
        weights /= weights.sum(axis=1, keepdims=True)
        through, price = bound_layouts(product, weights, mask)
        for layout, score in zip(layouts.tolist(), scores, strict=True):
            for sensor, at in enumerate(layout):
                assert through[sensor, at] >= score - 1e-7
        assert price.min() > 0
        mask[0, 1] = False
        left, _ = bound_layouts(product, weights, mask)
        assert left[0, 1] == -np.inf
        assert np.all(left <= through + 1e-12)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_of_a_single_layout_the_bound_is_its_score(count: int) -> None:
    only = LayoutRules(on_axis(GRID_MM[:count]), NONE, 0.0)
    product = product_of(count, rules=only)
    mask = np.eye(count, dtype=np.bool_)
    through, price = bound_layouts(product, mask.astype(np.float64), mask)
    score = product.exact_score(np.arange(count))
    assert np.diag(through) == pytest.approx(np.full(count, score), abs=1e-6)
    assert price == pytest.approx(np.ones(count), abs=1e-6)
    assert gap_of(product, np.arange(count)) == 0.0


@pytest.mark.parametrize(("count", "leading"), [(2, 2), (3, 3), (3, 2)])
def test_the_gap_holds_the_best_layout_and_is_small_where_all_sensors_count(count: int, leading: int) -> None:
    product, layouts = product_of(count, leading), every(count)
    scores = np.array([product.exact_score(layout) for layout in layouts])
    best = layouts[int(scores.argmax())]
    for layout, score in ((best, scores.max()), (layouts[4], scores[4])):
        gap = gap_of(product, layout)
        assert gap >= scores.max() - score - 1e-6
        assert gap < scores.max() - score + (0.1 if leading == count else 2.0)
    assert largest_gap(STRING, RULES, GRID_MM[best], leading) == gap_of(product, best)


def test_rounding_grows_with_how_alike_the_readings_are() -> None:
    product = product_of(3)
    assert rounding_margin(product, np.array([0, 3, 6])) == 1e-8
    near = LayoutRules(on_axis(np.array([100.0, 100.00001, 300.0])), NONE, 0.0)
    alike = product_of(3, rules=near)
    singular = np.linalg.svd(alike.matrix, compute_uv=False)
    expected = 100 * 3 * 2.220446e-16 * singular[0] / singular[2]
    assert expected > 2e-8
    assert rounding_margin(alike, np.arange(3)) == pytest.approx(expected, rel=1e-3)


def test_a_structure_that_does_not_move_and_a_search_that_breaks_a_rule_are_refused() -> None:
    with pytest.raises(SceneError, match="the largest deflection per newton is 0 mm; check the dimensions"):
        place(STRING, LayoutRules(on_axis(np.array([0.0, 400.0])), NONE, 0.0), 2, 0)
    with pytest.raises(NotGoodEnoughError, match="the search ended at 30 mm, 30 mm, 200 mm, against the rules of sens"):
        _checked(RULES, np.array([0, 0, 3]), 1.0, 5)
    kept = _checked(RULES, np.array([0, 3]), 1.5, 5)
    assert (kept.positions_mm, kept.places, kept.log_eigenvalue_product, kept.evaluations) == (
        (30.0, 200.0),
        [30.0, 200.0],
        1.5,
        5,
    )
    assert Placement(np.array([[30.0, 7.0], [200.0, 11.0]]), 1.5, 5).places == [(30.0, 7.0), (200.0, 11.0)]


@pytest.mark.parametrize(
    ("failed_percent", "leading", "fewest"),
    [(None, None, 1), (0.0, None, 1), (99.9, None, 1), (100.0, None, 2), (None, 3, 3)],
)
def test_a_layout_for_failed_sensors_has_two_at_least_and_one_of_components_as_many(
    failed_percent: float | None, leading: int | None, fewest: int
) -> None:
    assert Aim("position-error", failed_percent, leading).fewest == fewest


@pytest.mark.parametrize(
    ("failed_percent", "said"),
    [(-0.1, "failed_percent = -0.1: give a share of the time, from 0 to 100"), (100.1, "failed_percent = 100.1: give")],
)
def test_a_share_of_the_time_is_from_0_to_100(failed_percent: float, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        Aim("position-error", failed_percent)
    with pytest.raises(SceneError, match="failed_percent = 7: it weighs position errors, and goes with no other"):
        Aim("eigenvalue-product", 7.0)
    with pytest.raises(SceneError, match="criterion = 'best' must be one of position-error, eigenvalue-product"):
        Aim("best")  # type: ignore[arg-type]
