"""Placement, limits and estimators of structures that were measured and that no scene describes."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline, RegularGridInterpolator

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.posterior.window import posterior_graph
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.placing import fewest_sensors, place, place_by_position_error, recommended_count
from example_scenes import paper_scene
from posterior_cases import answers_of
from stated_problems import problem_in

LENGTH_MM = 500.0
TENSION_N = 50.0
NOISE_MM = 0.02
RULES = Candidates(np.arange(20.0, 500.0, 20.0), np.array([], dtype=np.intp), 40.0)


def sag_mm(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Deflection of a taut string per newton: two straight lines that meet at the load; (loads, sensors)."""
    load = load_mm[:, None]
    left, right = np.minimum(load, sensor_mm), np.maximum(load, sensor_mm)
    found: Floats = left * (LENGTH_MM - right) / (LENGTH_MM * TENSION_N)
    return found


def measured_string() -> InfluenceFunction:
    """A taut string, known only from a table of its deflections every 5 mm."""
    measured_mm = np.linspace(0.0, LENGTH_MM, 101)
    table = RegularGridInterpolator((measured_mm, measured_mm), sag_mm(measured_mm, measured_mm))

    def at(sensor_mm: Floats, load_mm: Floats) -> Floats:
        found: Floats = table(tuple(np.meshgrid(load_mm, sensor_mm, indexing="ij")))
        return found

    return InfluenceFunction(LENGTH_MM, np.linspace(25.0, 475.0, 91), (1.0, 1.0), at)


@pytest.mark.parametrize("count", [2, 3])
def test_sensors_of_a_measured_string_stand_where_enumeration_puts_them(count: int) -> None:
    string = measured_string()
    exact = sag_mm(RULES.position_mm, string.load_mm)
    scores: dict[tuple[float, ...], float] = {}
    for chosen in combinations(range(len(RULES.position_mm)), count):
        positions = RULES.position_mm[list(chosen)]
        if np.diff(positions).min() >= 40:
            singular = np.linalg.svd(exact[:, chosen], compute_uv=False)
            scores[tuple(positions)] = float((2 * np.log(singular) - np.log(len(exact))).sum())
    found = place(string, RULES, count, 0)
    assert found.log_eigenvalue_product == pytest.approx(max(scores.values()), abs=1e-9)
    # A layout and its mirror image score the same.
    assert scores[found.positions_mm] == pytest.approx(max(scores.values()), abs=1e-9)


def test_a_measured_string_has_a_number_of_sensors_a_limit_and_an_estimator() -> None:
    string = measured_string()
    assert recommended_count(string, 1e6) == 2 < recommended_count(string, NOISE_MM) <= 8
    coarse = replace(RULES, position_mm=RULES.position_mm[1::3])
    found = place_by_position_error(string, coarse, 2, 0, SampleErrors(NOISE_MM))
    prior = Prior.of(string, np.array(found.positions_mm), NOISE_MM)
    reached = limit.accuracy_limit(prior, 1_000, 1).percent
    by_product = Prior.of(string, np.array(place(string, RULES, 2, 0).positions_mm), NOISE_MM)
    other = limit.accuracy_limit(by_product, 1_000, 1)
    assert reached <= other.percent + 3 * other.standard_error
    drawn = limit.draw(prior, 2_000, 2)
    answers = answers_of(posterior_graph(prior, with_force=False), prior, drawn.deflection_mm)
    assert np.abs(answers["position_mm"] - drawn.position_mm).mean() / LENGTH_MM * 100 < 1.1 * reached
    wanted_mm = 1.1 * reached / 100 * LENGTH_MM
    few = fewest_sensors(string, coarse, (2, 4), wanted_mm=wanted_mm, errors=SampleErrors(NOISE_MM), seed=0)
    assert 2 <= len(few.positions_mm) <= 3
    with pytest.raises(SceneError, match="not even 3 sensors reach"):
        fewest_sensors(string, coarse, (2, 3), wanted_mm=1e-6, errors=SampleErrors(NOISE_MM), seed=0)


def test_a_measured_beam_gets_the_sensors_of_its_scene() -> None:
    stated, rules = problem_in(paper_scene())
    at_mm = np.linspace(0.0, 400.0, 161)
    noiseless = RectBivariateSpline(at_mm, at_mm, stated.at(at_mm, at_mm))

    def at(sensor_mm: Floats, load_mm: Floats) -> NDArray[np.float64]:
        # A table answers only within the length; the loads of an accuracy limit come in no order.
        assert min(sensor_mm.min(), load_mm.min()) >= 0
        assert max(sensor_mm.max(), load_mm.max()) <= 400
        found: Floats = noiseless(load_mm[:, None], sensor_mm[None, :], grid=False)
        return found

    measured = InfluenceFunction(400.0, stated.load_mm, (10.0, 10.0), at, stated.unit_mm_per_n)
    theirs, ours = place(stated, rules, 4, 0), place(measured, rules, 4, 0)
    assert ours.positions_mm == theirs.positions_mm
    assert ours.log_eigenvalue_product == pytest.approx(theirs.log_eigenvalue_product, abs=1e-4)
    sensor_mm, errors = np.array([122.0, 278.0]), SampleErrors(NOISE_MM, 0.003, 0.004, 0.5)
    theirs_percent, ours_percent = (
        limit.accuracy_limit(Prior.real(influence, sensor_mm, errors), 500, 0).percent
        for influence in (stated, measured)
    )
    assert ours_percent == pytest.approx(theirs_percent, rel=1e-3)
    assert recommended_count(measured, NOISE_MM) == recommended_count(stated, NOISE_MM)
    coarse = replace(rules, position_mm=np.arange(40.0, 400.0, 40.0))
    theirs, ours = (
        place_by_position_error(influence, coarse, 2, 0, SampleErrors(NOISE_MM)) for influence in (stated, measured)
    )
    assert ours.positions_mm == theirs.positions_mm


def test_the_influence_function_of_a_scene_holds_its_ranges_and_its_unit() -> None:
    influence = influence_of(paper_scene())
    assert influence.length_mm == 400
    assert influence.position_mm == (1, 399)
    assert influence.force_n == (10, 10)
    # W l^3/(48 EI) in the middle.
    middle = float(influence.at(np.array([200.0]), np.array([200.0]))[0, 0])
    assert middle == pytest.approx(influence.unit_mm_per_n / 48)
    assert influence.matrix(np.array([122.0, 278.0])).shape == (399, 2)


LOADS_MM = np.linspace(25.0, 475.0, 91)
GOOD: dict[str, Any] = {
    "length_mm": LENGTH_MM,
    "load_mm": LOADS_MM,
    "force_n": (1.0, 2.0),
    "at": sag_mm,
    "unit_mm_per_n": 1.0,
}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("length_mm", float("nan")),
        ("length_mm", 0.0),
        ("load_mm", np.array([])),
        ("load_mm", LOADS_MM[:1]),
        ("load_mm", LOADS_MM[:, None]),
        ("load_mm", np.array([25.0, float("nan"), 475.0])),
        ("load_mm", LOADS_MM[::-1]),
        ("load_mm", np.concatenate([np.linspace(25.0, 50.0, 90), [475.0]])),
        ("load_mm", LOADS_MM + 100),
        ("load_mm", LOADS_MM - 100),
        ("force_n", (0.0, 1.0)),
        ("force_n", (2.0, 1.0)),
        ("force_n", (1.0, float("nan"))),
        ("unit_mm_per_n", 0.0),
        ("unit_mm_per_n", float("inf")),
        ("at", lambda sensor_mm, load_mm: sag_mm(sensor_mm, load_mm).T),
        ("at", lambda load_mm, sensor_mm: sag_mm(sensor_mm, load_mm)),
        ("at", lambda sensor_mm, load_mm: sag_mm(sensor_mm, load_mm) * float("nan")),
    ],
)
def test_a_bad_field_is_refused_by_its_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{name} of an influence function must"):
        InfluenceFunction(**{**GOOD, name: value})


def test_what_was_made_does_not_follow_the_arrays_of_its_caller() -> None:
    loads_mm, sensor_mm = LOADS_MM.copy(), np.array([122.0, 278.0])
    string = InfluenceFunction(**{**GOOD, "load_mm": loads_mm})
    prior = Prior.real(string, sensor_mm, SampleErrors(NOISE_MM, mounting_mm=1.0))
    assert prior.uncertain_at is not None
    at_mm = np.array([100.0])
    before = string.position_mm, prior.influence_at(at_mm).tolist(), prior.uncertain_at(at_mm).tolist()
    loads_mm[:], sensor_mm[:] = 30.0, 200.0
    assert (string.position_mm, prior.influence_at(at_mm).tolist(), prior.uncertain_at(at_mm).tolist()) == before
