"""Placement, limits and estimators of structures that were measured and that no scene describes."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import beamtouch_models as models
from beamtouch_common.errors import InputError
from beamtouch_models import cli
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
    assert scores[tuple(found.place_mm[:, 0])] == pytest.approx(max(scores.values()), abs=1e-9)


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
        ("load_mm", np.array([25.0, 250.0, 475.01])),
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


def test_steps_of_loads_may_differ_by_a_millionth() -> None:
    assert InfluenceFunction(**GOOD | {"load_mm": np.array([25.0, 250.0, 475.0001])}).position_mm == (25, 475.0001)


def string_scene(**sensors: object) -> models.Scene:
    """A scene without a beam."""
    contact = {"force_n": [1.0, 2.0], "position_mm": [25.0, 475.0]}
    return models.make_scene(contact=contact, sensors={"rate_hz": 100.0, "range_mm": [1.0, 100.0], **sensors})


def string_of(scene: models.Scene, places: int) -> models.InfluenceFunction:
    """A table of the string at so many even places of sensors and loads."""
    places_mm = np.linspace(0.0, LENGTH_MM, places)
    return models.interpolate_influence(scene, places_mm, places_mm, sag_mm(places_mm, places_mm))


EXACT = InfluenceFunction(**GOOD)


def test_what_is_relative_to_the_deflection_is_relative_to_that_of_the_influence_in_use() -> None:
    """The string sags by 2 N * 250 mm / 2 / 50 N = 5 mm in its middle, and lifts nowhere."""
    surface = models.resolve(string_scene(noise_percent_of_max=1.0), influence=EXACT)
    assert surface.travel.largest_mm == pytest.approx(5.0)
    assert surface.noise.reading_mm == pytest.approx(0.05)
    assert surface.sensor.standoff_mm == pytest.approx((1 + 100) / 2 + 5 / 2)
    with pytest.raises(InputError, match=r"at 2 N the structure travels 5 mm and leaves sensors.range_mm = \[1, 4\]"):
        models.resolve(string_scene(noise_mm=0.05, range_mm=[1.0, 4.0]), influence=EXACT).layout([100.0, 300.0])
    for scale in (1e-11, 1e11):
        far = InfluenceFunction(**GOOD | {"at": lambda sensor, load, scale=scale: scale * sag_mm(sensor, load)})
        with pytest.raises(InputError, match=r"the largest deflection is .*, which no sensor measures"):
            models.resolve(string_scene(noise_mm=0.05, range_mm=[1.0, 100.0]), influence=far)


@pytest.mark.promise(
    "docs/reference/python.md",
    "Whoever brings an influence function states no beam: what is relative to a deflection is relative to its own.",
)
def test_a_string_needs_no_beam_and_a_beam_no_string() -> None:
    scene = string_scene(noise_mm=0.02)
    assert not scene.has_beam
    surface = models.resolve(scene, influence=EXACT)
    assert surface.place(2, effort=0.01).limit(draws=200).value < surface.layout([40.0, 460.0]).limit(draws=200).value
    assert surface.ringing is None
    assert surface.slowest_period_ms is None
    assert [effect.name for effect in surface.effects if effect.verdict == "floor"] == [
        "gain error", "zero drift", "drift in a minute",
    ]  # fmt: skip
    for asked in (
        lambda: models.resolve(scene),
        lambda: models.frequency_hz(scene),
        lambda: models.influence_matrix(scene, [100.0], [100.0]),
        lambda: surface.beam,
    ):
        with pytest.raises(InputError, match=r"^beam is missing; add it"):
            asked()


def test_a_command_needs_a_beam(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "string.toml"
    path.write_text(models.format_scene(string_scene(noise_mm=0.02)))
    assert models.read_scene(path) == string_scene(noise_mm=0.02)
    for command in (["place"], ["explain"], ["build", "-o", str(tmp_path / "string.onnx")]):
        assert cli.main([*command, str(path)]) == 2
        assert capsys.readouterr().err == f"design-sensors: {path}: beam is missing; add it\n"


def test_a_layout_keeps_its_rules_on_a_structure_that_is_no_beam() -> None:
    surface = models.resolve(string_scene(noise_mm=0.02), influence=EXACT)
    for places, said in (
        ([3.0, 100.0], "beyond the end at 0 mm"),
        ([498.0], "beyond the end at 500"),
        ([600.0], "to 500"),
    ):
        with pytest.raises(InputError, match=said):
            surface.layout(places)
    with pytest.raises(InputError, match=r"sensors\.fixed_mm: must be finite from 0 to 500"):
        models.resolve(string_scene(noise_mm=0.02, fixed_mm=[600.0]), influence=EXACT)


@pytest.mark.promise(
    "docs/reference/python.md",
    "What a table leaves open between its places is part of the errors: its splines promise no more than was measured.",
)
@pytest.mark.parametrize("positions_mm", [[130.0, 330.0], [60.0, 210.0, 310.0, 450.0]])
def test_a_table_promises_no_more_than_the_string_that_it_was_taken_from(positions_mm: list[float]) -> None:
    scene = string_scene(noise_mm=0.02)
    truth, coarse, fine = (
        models.resolve(scene, influence=own).layout(positions_mm).limit(draws=500)
        for own in (EXACT, string_of(scene, 26), string_of(scene, 201))
    )
    assert coarse.value > 0.97 * truth.value
    assert fine.value == pytest.approx(truth.value, rel=0.05)


def test_a_table_that_is_too_coarse_is_refused_with_the_distance_that_its_places_need() -> None:
    scene, needed_mm = string_scene(noise_mm=0.02), []
    for places in (6, 11, 13):
        with pytest.raises(InputError, match=r"mm apart are too coarse: .* give one at every [0-9.]+ mm") as refused:
            string_of(scene, places)
        needed_mm.append(float(str(refused.value).split()[-2]))
    assert max(needed_mm) < 3 * min(needed_mm)
    assert string_of(scene, round(LENGTH_MM / min(needed_mm)) + 2).interpolation is not None


def test_the_price_of_an_interpolation_says_how_close_places_must_be() -> None:
    scene = string_scene(noise_mm=0.02)
    first = models.resolve(scene, influence=string_of(scene, 51)).effects[0]
    assert first.name == "interpolation"
    assert first.price is not None
    assert first.price > 1
    assert "of a table of places 10 mm apart; with one at every" in first.reason
    # Of a smooth structure, the error falls with the fourth power of the distance; of one with kinks, hardly faster
    # than the distance.
    kinked = string_of(scene, 51).interpolation
    assert kinked is not None
    assert 1 <= kinked.order < 2
    places_mm = np.linspace(0.0, LENGTH_MM, 51)
    shapes = np.sin(np.pi * places_mm / LENGTH_MM)
    smooth = models.interpolate_influence(scene, places_mm, places_mm, np.outer(shapes, shapes)).interpolation
    assert smooth is not None
    assert 3 < smooth.order <= 4


def test_a_sensor_at_a_column_of_a_table_is_known_better_than_one_between_two() -> None:
    table = string_of(string_scene(noise_mm=0.02), 51).interpolation
    assert table is not None
    at_column, between, also = table.deviation_at(on_axis(np.array([200.0, 205.0, 210.0])), on_axis(np.array([100.0])))[
        0
    ]
    assert at_column < 0.9 * between
    assert at_column == pytest.approx(also, rel=0.05)


def test_splines_are_off_by_less_than_what_is_stated_of_them() -> None:
    loads, sensors = np.linspace(25, 475, 901), np.array([87.0, 140.0, 333.3, 420.0])
    for places in (26, 51, 101):
        own = string_of(string_scene(noise_mm=0.02), places)
        assert own.interpolation is not None
        off = own.at(sensors, loads) - sag_mm(sensors, loads)
        stated = own.interpolation.deviation_at(on_axis(sensors), on_axis(loads))
        relative = float(np.sqrt(np.mean((off / stated) ** 2)))
        assert 0.02 < relative < 0.5
