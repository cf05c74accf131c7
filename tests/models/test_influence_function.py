"""Placement, limits and estimators of structures that were measured and that no scene describes."""

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.drawing import draw
from beamtouch_models.design.accuracy.limit import posterior_median_mm
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.placement.placing import place, place_by_position_error, recommended_count
from beamtouch_models.design.placement.position_error import Sampling
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors
from models.posterior_cases import answers_of

LENGTH_MM = 500.0
TENSION_N = 50.0
NOISE_MM = 0.02
RULES = LayoutRules(on_axis(np.arange(20.0, 500.0, 20.0)), np.array([], dtype=np.intp), 40.0)


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


def test_sensors_of_a_measured_string_stand_where_enumeration_puts_them() -> None:
    string, count = measured_string(), 3
    exact = sag_mm(RULES.place_mm[:, 0], string.load_mm)
    scores: dict[tuple[float, ...], float] = {}
    for chosen in combinations(range(len(RULES.place_mm)), count):
        positions = RULES.place_mm[list(chosen), 0]
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
    coarse = replace(RULES, place_mm=RULES.place_mm[1::3])
    found = place_by_position_error(string, coarse, 2, 0, Sampling(Errors(NOISE_MM)))
    prior = Prior.of(string, found.place_mm, Errors(NOISE_MM))
    drawn = draw(prior, 2_000, 2)
    best = np.abs(posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm).mean()
    answers = answers_of(posterior_graph(prior, with_force=False), prior, drawn.deflection_mm)
    assert np.abs(answers["position_mm"] - drawn.position_mm).mean() < 1.1 * best


LOADS_MM = np.linspace(25.0, 475.0, 91)
GOOD: dict[str, Any] = {
    "length_mm": LENGTH_MM,
    "load_mm": LOADS_MM,
    "force_n": (1.0, 2.0),
    "at": sag_mm,
    "unit_mm_per_n": 1.0,
}


def test_a_gap_in_the_measurements_is_refused_where_it_is_asked_for() -> None:
    def at(sensor_mm: Floats, load_mm: Floats) -> Floats:
        return np.where(np.abs(sensor_mm - 300) < 5, np.nan, sag_mm(sensor_mm, load_mm))

    string = InfluenceFunction(**{**GOOD, "at": at})
    with pytest.raises(ValueError, match=r"finite .*, not nan for a sensor at 300 and a load at 25 mm"):
        place(string, RULES, 3, 0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("length_mm", float("nan")),
        ("load_mm", np.array([])),
        ("load_mm", np.array([25.0, float("nan"), 475.0])),
        ("load_mm", LOADS_MM[::-1]),
        ("load_mm", np.concatenate([np.linspace(25.0, 50.0, 90), [475.0]])),
        ("load_mm", LOADS_MM + 100),
        ("force_n", (2.0, 1.0)),
        ("unit_mm_per_n", 0.0),
        ("at", lambda sensor_mm, load_mm: sag_mm(sensor_mm, load_mm).T),
        ("at", lambda sensor_mm, load_mm: sag_mm(sensor_mm, load_mm) * float("nan")),
    ],
)
def test_a_bad_field_is_refused_by_its_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"^{name} of an influence function must"):
        InfluenceFunction(**{**GOOD, name: value})
